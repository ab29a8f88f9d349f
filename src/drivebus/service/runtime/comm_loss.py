"""Behaviour of one drive at communication loss: its last read, its last test, and the waiver that permits starts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from drivebus.drives.operations.status import CommLossReport
from drivebus.profiles.model import CommLossParameters
from drivebus.service.control.comm_loss_record import CommLossRecord, CommLossResult
from drivebus.service.control.waivers import CommLossWaiver
from drivebus.service.live.views import CommLossTestObject, CommLossView
from drivebus.types import Json
from drivebus.values import Reading, Text, bilingual_text

COMM_LOSS_NOT_READ = bilingual_text("plant.comm_loss_not_read")
_UNKNOWN = CommLossView(kind="unknown", after_s=None, text=COMM_LOSS_NOT_READ)


class CommLossState:
    """Behaviour of one drive at communication loss, as read, tested and waived so far."""

    def __init__(self) -> None:
        self.last_read = _UNKNOWN
        self.read_at: float | None = None
        """Monotonic time of the last read."""
        self.requested_at: float | None = None
        """Monotonic time at which a read was requested last."""
        self.is_stale = False
        """A parameter was written since the last read."""
        self.write_count = 0
        """Number of parameter writes, to detect one during a read."""
        self.values: Mapping[str, int] = {}
        """Raw values of the parameters by notation, of the last read."""
        self.record: CommLossRecord | None = None
        """Result of the last test."""
        self.test: CommLossTestObject | None = None
        """Test that is under way."""
        self.no_result: Json | None = None
        """Why the last test ended without a result."""
        self.waiver: str | None = None
        """Reason and author of the waiver."""
        self.waiver_of_another: CommLossWaiver | None = None
        """Waiver that was recorded under this name for another drive: it allows nothing."""

    @property
    def view(self) -> CommLossView:
        """The behaviour with its waiver. A test that holds counts more than a read."""
        view = _UNKNOWN if self.is_stale else self.last_read
        record = self.record
        holds = record is not None and record.holds_for(self.present_values)
        if record is not None and holds:
            kind = "runs_on" if record.result is CommLossResult.RUNS_ON else "trips"
            text = bilingual_text(record.message_key, **record.message_params)
            view = CommLossView(kind=kind, after_s=float(record.after_s), text=text)
        tested = None if record is None else {**record.as_json(), "holds": holds}
        return replace(view, waiver=self.waiver, tested=tested, test=self.test, no_result=self.no_result)

    @property
    def present_values(self) -> Mapping[str, int] | None:
        """Raw values of the parameters by notation; None: not known now."""
        return None if self.read_at is None or self.is_stale else self.values

    def invalidate(self) -> None:
        """Record a parameter write: the behaviour is unknown until it is read again."""
        self.is_stale = True
        self.write_count += 1

    def set_read(self, report: CommLossReport, rule: CommLossParameters, now: float, writes_before: int) -> None:
        """Record a read. It is stale where ``writes_before``, the number of writes before it, has changed."""
        self.is_stale = writes_before != self.write_count
        kind = {True: "trips", False: "runs_on", None: "unknown"}[report.stops_on_comm_loss]
        text = Text(report.text("en"), report.text("zh"))
        self.last_read = CommLossView(kind=kind, after_s=_seconds_of(report.time), text=text)
        readings = ((rule.time_notation, report.time), (rule.action_notation, report.action))
        self.values = {
            notation: reading.raw
            for notation, reading in readings
            if notation is not None and reading is not None and reading.raw is not None
        }
        self.read_at = now


def _seconds_of(reading: Reading | None) -> float | None:
    if reading is None or reading.unit != "s" or not isinstance(reading.value, int | float):
        return None
    return float(reading.value)
