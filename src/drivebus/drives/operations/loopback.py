"""Loop-back test: requests that the drive returns unchanged, which shows the quality of the bus. Changes nothing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.steps import DriveOperation
from drivebus.errors import CapabilityError, DrivebusError
from drivebus.values import Text, bilingual_text


@dataclass(frozen=True, slots=True)
class LoopbackReport:
    """Result of a loop-back test: requests sent, round trips in seconds of those returned, repetitions, last error."""

    requests: int
    round_trips_s: tuple[float, ...]
    repetitions: int
    error: DrivebusError | None = None

    @property
    def round_trips_ms(self) -> list[float]:
        """Round trips in milliseconds, with one decimal."""
        return [round(1000 * round_trip_s, 1) for round_trip_s in self.round_trips_s]

    @property
    def round_trip_range_ms(self) -> tuple[float, float, float] | None:
        """Shortest, mean and longest round trip in milliseconds; None where no request was returned."""
        times_ms = self.round_trips_ms
        return (min(times_ms), round(sum(times_ms) / len(times_ms), 1), max(times_ms)) if times_ms else None

    @property
    def text(self) -> Text:
        texts = [bilingual_text("loopback.returned", returned=len(self.round_trips_s), requests=self.requests)]
        if self.round_trip_range_ms is not None:
            low, mean, high = self.round_trip_range_ms
            texts.append(bilingual_text("loopback.times", low=low, mean=mean, high=high))
        if self.repetitions:
            texts.append(bilingual_text("loopback.repeated", count=self.repetitions))
        if self.error is not None:
            texts.append(bilingual_text("loopback.error", why=Text.per_language(self.error.text)))
        return Text.join(texts, "sentences")


def loopback_test(
    op: OperationContext, count: int, is_cancelled: Callable[[], bool] | None = None
) -> DriveOperation[LoopbackReport]:
    """Send ``count`` loop-back requests, each with another number; none once ``is_cancelled`` returns True.

    Raises CapabilityError where the model has no loop-back, and the error of the bus where the drive does not answer.
    """
    modbus = op.dialect.profile.modbus
    if modbus is None or not modbus.loopback:
        raise CapabilityError("drives.cannot", model=op.dialect.profile.model, what="loopback")
    error = yield from op.sync()  # also shows whether the port returns an echo, which would look like the reply
    if error is not None:
        raise error
    round_trips: list[float] = []
    repetitions = 0
    requests = 0
    while requests < count and (is_cancelled is None or not is_cancelled()):
        requests += 1
        result = yield from op.transact(op.dialect.sync_request())
        repetitions += max(0, result.attempts - 1)
        if isinstance(result.error, DrivebusError):
            error = result.error
        elif result.sent_at is not None and result.received_at is not None:
            round_trips.append(result.received_at - result.sent_at)
    return LoopbackReport(requests, tuple(round_trips), repetitions, error)
