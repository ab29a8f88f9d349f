"""Monitor of one drive: polls keep its readings current, and readings that are too old are marked bad.

While the port is not open, every reading is bad and the state unknown, until they are read again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from types import TracebackType
from typing import Any

from drivebus.bus import Bus, Poll, PollSubscription
from drivebus.bus.messages import BusResult
from drivebus.bus.station import Presence
from drivebus.drives.dialects.base import UNNAMED_FAULT_CODE, Dialect, reported_fault
from drivebus.drives.operations.status import complete_status
from drivebus.drives.readings import ReadingPairs, Readings
from drivebus.drives.state import STATE_NOT_READ, DerivedState, DriveState, DriveStatus
from drivebus.values import Quality, Reading

FAULT_POLL_PERIOD_S = 1.0
MIN_READING_VALIDITY_S = 1.0
WORD_PREFIXES = ("state", "fault")  # the names of status and fault words begin so
_REASONS_WITHOUT_REPLY = ("drives.not_read", "drives.stale")  # an unusable reply is the better reason
READING_VALIDITY_PERIODS = 3.0  # a reading is valid for max(3 periods, 1 s) and one timeout


def status_polls(dialect: Dialect, names: tuple[str, ...], min_period_s: float) -> list[Poll]:
    """Return polls of these signals, of the state and of the fault, none more often than every ``min_period_s``."""
    polls = dialect.polls(names)
    known = {request for request, _ in polls}
    faults = tuple((request, FAULT_POLL_PERIOD_S) for request in dialect.fault_reads() if request not in known)
    return [Poll(request, max(period, min_period_s)) for request, period in (*polls, *faults)]


class Monitor:
    """Newest status of one drive; ``close`` or the end of the block ends its polls."""

    def __init__(
        self,
        bus: Bus,
        dialect: Dialect,
        signals: Iterable[str] | None = None,
        on_change: Callable[[DriveStatus], None] | None = None,
        *,
        period_s: float = 0.0,
        read_listeners: list[Callable[[BusResult], None]] | None = None,
    ) -> None:
        """``read_listeners``: listeners of the drive's own reads; the monitor is one of them until closed."""
        self._bus, self._dialect = bus, dialect
        self._names = tuple(dialect.profile.signals if signals is None else signals)
        self._reading_pairs = ReadingPairs()
        self._derived: DerivedState = STATE_NOT_READ
        self._derived_at: float | None = None
        self._on_change = on_change
        self.last_error: Exception | None = None
        self._validity_s: dict[str, float] = {}
        self._requests: dict[str, Any] = {}
        """Poll that each reading comes from."""
        self._failed: set[Any] = set()
        """Polls that had no usable reply."""
        self._repeated: set[Any] = set()
        """Polls that were repeated at once because a word had changed."""
        polls = status_polls(dialect, self._names, period_s)
        self._poll_validity_s: dict[Any, float] = {poll.request: self._validity_of(poll) for poll in polls}
        self._state_validity_s = min(self._poll_validity_s.values(), default=MIN_READING_VALIDITY_S)
        self._subscription: PollSubscription | None = bus.start_polling(dialect.address, polls, self._on_poll_result)
        self._read_listeners = [] if read_listeners is None else read_listeners
        self._read_listeners.append(self._on_command_read)

    def _validity_of(self, poll: Poll) -> float:
        timing, codec = self._dialect.station_config.timing, self._dialect.codec
        timeout = timing.timeout_s(self._bus.settings, codec.largest_reply(poll.request))
        return max(READING_VALIDITY_PERIODS * poll.period_s, MIN_READING_VALIDITY_S) + timeout

    def _on_poll_result(self, result: BusResult) -> None:
        self.last_error = result.error
        if result.error is None and result.reply is not None:
            self._apply_poll(result)
        else:
            self._failed.add(result.bus_request.request)
        self._notify()

    def _notify(self) -> None:
        if self._on_change is not None:
            self._on_change(self.status())

    def _on_command_read(self, result: BusResult) -> None:
        """Take a read of a command as a newer poll, so that its outcome and the status agree."""
        if self._subscription is not None:
            readings = self._dialect.decode_readings(result.bus_request.request, result.reply, result.received_at)
            self._apply({name: reading for name, reading in readings.items() if self._is_newer(name, reading)})
            self._notify()

    def _is_newer(self, name: str, reading: Reading) -> bool:
        known = self._reading_pairs.latest.get(name)
        return known is not None and known.source_time is not None and (reading.source_time or 0.0) > known.source_time

    def _apply_poll(self, result: BusResult) -> None:
        request = result.bus_request.request
        self._dialect.follow_contact_losses(self._bus.contact_losses(self._dialect.address))
        readings = self._dialect.decode_readings(request, result.reply, result.received_at)
        limit = self._poll_validity_s.get(request, MIN_READING_VALIDITY_S)
        self._validity_s |= {name: limit for name in readings if name in self._names or name not in self._validity_s}
        self._requests |= dict.fromkeys(readings, request)
        self._apply(readings)
        self._repeat_changed_words(request, readings)

    def _repeat_changed_words(self, request: Any, readings: Readings) -> None:
        """Repeat a poll at once, and once, where a status or fault word has changed: two equal reads count.

        On a slow bus its next turn is many seconds later.
        """
        words = [name for name in readings if name.startswith(WORD_PREFIXES)]
        pairs = [self._reading_pairs.raw_pair(name) for name in words]
        has_changed = any(pair is not None and pair[0] != pair[1] for pair in pairs)
        if self._subscription is None or not has_changed or request in self._repeated:
            self._repeated.discard(request)
            return
        self._repeated.add(request)
        self._subscription.make_due({request})

    def _apply(self, readings: Readings) -> None:
        self._reading_pairs.add(readings)
        derived = self._dialect.derive_state(self._reading_pairs)
        if derived is not None:
            before, self._derived = self._derived, derived
            if before.state is DriveState.FAULT and derived.state is not DriveState.FAULT:
                self._read_hidden_values()
            if derived.fault_code == UNNAMED_FAULT_CODE != before.fault_code and self._subscription is not None:
                # Its code was not read yet, or it was reset since the state was read.
                self._subscription.make_due({*self._dialect.fault_reads(), *self._state_polls()})
            self._derived_at = self._reading_pairs.oldest_time(*self._dialect.state_names)

    def _state_polls(self) -> set[Any]:
        return {self._requests[name] for name in self._dialect.state_names if name in self._requests}

    def poll_state(self) -> None:
        """Poll the state at once: on a bus with many drives its next turn is seconds later."""
        if self._subscription is not None:
            self._subscription.make_due(self._state_polls())

    def _read_hidden_values(self) -> None:
        """Read at once what could not be read or not be verified during the fault: some polls have a period of 60 s."""
        hidden = [name for name, reading in self._reading_pairs.latest.items() if reading.quality is not Quality.GOOD]
        if self._subscription is not None:
            self._subscription.make_due({self._requests[name] for name in hidden if name in self._requests})

    def status(self) -> DriveStatus:
        """Return the newest readings; what is too old is marked bad, and an old state is UNKNOWN."""
        now = self._bus.now()
        unusable_reply = self._bus.unusable_reply(self._dialect.address)
        derived = self._current_state(now)
        if unusable_reply is not None and derived.reason in _REASONS_WITHOUT_REPLY:
            derived = DerivedState(DriveState.UNKNOWN, reason="drives.no_answer")
        aged = self._reading_pairs.with_staleness(now, self._validity_s, self._bus.port_opened_at)
        readings = {name: reading for name, reading in aged.items() if name in self._dialect.profile.signals}
        fault = reported_fault(self._dialect.profile, derived)
        current = DriveStatus(
            state=derived.state,
            direction=derived.direction,
            fault=fault,
            readings=readings,
            reason=derived.reason,
            at=self._derived_at,
            unusable_reply=unusable_reply,
        )
        # A slow poll has its first turn up to a minute after the start: until then its signals are not read yet.
        is_offline = self._bus.presence(self._dialect.address) is Presence.OFFLINE
        lacks_reply = is_offline or any(request not in self._requests.values() for request in self._failed)
        return complete_status(self._dialect, current, self._names if lacks_reply else ())

    def _current_state(self, now: float) -> DerivedState:
        if not self._dialect.reports_run_state:
            return DerivedState(DriveState.UNKNOWN, reason="drives.no_run_status")
        bad_reason = self._reading_pairs.bad_reason(*self._dialect.state_names)
        if self._derived_at is None:
            return STATE_NOT_READ if bad_reason is None else DerivedState(DriveState.UNKNOWN, reason=bad_reason)
        opened_at = self._bus.port_opened_at
        if opened_at is None or self._derived_at < opened_at:
            return DerivedState(DriveState.UNKNOWN, reason="drives.port_lost")
        if now - self._derived_at > self._state_validity_s:
            return DerivedState(DriveState.UNKNOWN, reason=bad_reason or "drives.stale")
        return self._derived

    def close(self) -> None:
        """End the polls. Idempotent."""
        if self._subscription is not None:
            self._subscription.cancel()
            self._subscription = None
            self._read_listeners.remove(self._on_command_read)

    def __enter__(self) -> Monitor:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
