"""Stop, coast and quick stop: sent before anything else and resent until the drive reports standstill.

docs/explanation/bus-stop.md has the rules by which a stop is repeated, confirmed, and reported as unconfirmed. A stop
needs no permit. It is withheld in one case only: the station has never answered as this model, whose stop may start
another one (``DriveProfile.needs_model_check``).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import replace
from math import inf, isfinite
from typing import Any

from drivebus.bus.messages import BusResult, RequestPriority
from drivebus.drives.dialects.base import Dialect, StopMode
from drivebus.drives.operations.context import VERIFICATION_ROUNDS, OperationContext, with_note
from drivebus.drives.operations.steps import OWN_FRAME, DriveOperation, get_bus_conditions, wait
from drivebus.drives.outcome import Outcome, OutcomeStatus
from drivebus.drives.state import STATE_NOT_READ, DriveState
from drivebus.errors import DrivebusError, PortLost
from drivebus.values import Text, bilingual_text

STOP_PROGRESS_TIMEOUT_S = 2.0  # without a sign of deceleration for this long a stop is reported as unconfirmed
MIN_TIMEOUT_TRANSACTIONS = 16  # for each drive; most models verify two states with fewer, so that some may fail
OTHER_TURNS = 1.5  # beside stops of several drives, polls and other reads have up to a third of the turns
MAX_FIRST_FRAMES = 64  # of one drive's stops that prolong a deadline: further ones must not put off a report for ever
MAX_DECELERATION_S = 120.0  # a motor whose frequency only falls must be reported; a longer ramp that was read counts
STOP_RESEND_INTERVAL_S = 0.5  # a decelerating drive gets the stop again, in case the first was lost
STOP_POLL_INTERVAL_S = 0.05  # pause between two verified states
UNVERIFIABLE_STOP_SENDS = 3  # stops to a drive that reports no run status (DF800): no read shows that one was lost


class StopProgress:
    """Deadline of a stop, which moves on while the drive decelerates; rules: docs/explanation/bus-stop.md."""

    def __init__(
        self,
        op: OperationContext,
        started_at: float,
        concurrent: Collection[OperationContext] = (),
        joint: Collection[OperationContext] = (),
    ) -> None:
        """``concurrent``: all stops of this drive that are under way, this one among them.

        ``joint``: those of all drives of the bus that are stopped together and read in turns.
        """
        self._op, self._started_at, self._concurrent, self._joint = op, started_at, concurrent, joint
        self._transactions = timeout_transactions(op.dialect)
        self._most_drives = 1  # of ``joint`` so far: the end of a stop does not shorten the deadline
        self._most_first_frames = 1  # of ``concurrent`` so far
        self._fastest_transaction_s = inf  # of this drive's stops; inf: none has a reply yet
        self._deceleration_reported_at = started_at  # by the state of the drive; ``op`` has that by its frequency
        self._progress_at_last_update = started_at
        self._sent_before_progress = 0  # ``op.sent_count`` at the last sign of deceleration that ``update`` found

    @property
    def _last_progress_at(self) -> float:
        """Time of the last sign of deceleration, else of the stop."""
        return max(self._deceleration_reported_at, self._op.last_deceleration_at or self._started_at)

    def update(self, now: float) -> bool:
        """Return whether the drive has decelerated since the last update, by its frequency or its state."""
        derived = self._op.derived
        if derived.state in (DriveState.DECELERATING, DriveState.BRAKING) and not derived.by_frequency:
            self._deceleration_reported_at = now
        before, self._progress_at_last_update = self._progress_at_last_update, self._last_progress_at
        has_decelerated = self._progress_at_last_update > before
        if has_decelerated:
            self._sent_before_progress = self._op.sent_count
        return has_decelerated

    def is_over(self, now: float) -> bool:
        """Return whether the stop is reported as unconfirmed: at its deadline, or once it had all its transactions."""
        if now > self.deadline:
            return True
        required = self._required_transactions()
        if self._op.derived.state is DriveState.UNKNOWN:  # lost replies, each followed by further stops
            required += required // 2
        had_turns = self._op.sent_count - self._sent_before_progress >= required
        return had_turns and now > self._deadline_after(STOP_PROGRESS_TIMEOUT_S)

    @property
    def deadline(self) -> float:
        """Time at which the stop is reported as unconfirmed, whatever goes before its reads."""
        return self._deadline_after(max(STOP_PROGRESS_TIMEOUT_S, self._verification_s()))

    def _deadline_after(self, timeout_s: float) -> float:
        """Return the end of a timeout from the last sign of deceleration.

        The drive's ramp, where it was read, always has its time; beyond that ramp or 120 s no deceleration counts.
        """
        ramp_end = self._started_at + STOP_PROGRESS_TIMEOUT_S + (self._op.drive.deceleration_s or 0.0)
        latest = max(self._started_at + MAX_DECELERATION_S, ramp_end)
        return min(max(self._last_progress_at + timeout_s, ramp_end), latest)

    def _verification_s(self) -> float:
        """Return the bus time of the verified states of all drives and of the first frames of concurrent stops.

        0 while no transaction shows the speed of the bus: a stop whose own frame still waits takes that of the others.
        0 also where the port is lost: then no stop waits for another. A drive that does not report standstill is not
        read, so that its stop waits for none of them.
        """
        if self._op.port_error is not None:
            return 0.0
        if self._op.dialect.reports_run_state:
            self._most_drives = max(self._most_drives, len({op.dialect.address for op in self._joint}))
            first_frames = len({op.first_frame or op for op in self._concurrent})
            self._most_first_frames = max(self._most_first_frames, min(first_frames, MAX_FIRST_FRAMES))
        self._fastest_transaction_s = _fastest_transaction_s(self._fastest_transaction_s, (self._op, *self._concurrent))
        fastest_s = self._fastest_transaction_s
        if not self._op.sent_count:  # afterwards those of other drives no longer count: this one may be silent
            fastest_s = _fastest_transaction_s(fastest_s, self._joint)
        turns = 1.0 if self._most_drives == 1 else self._most_drives * OTHER_TURNS
        seconds = self._required_transactions() * turns * fastest_s
        return seconds if isfinite(seconds) else 0.0

    def _required_transactions(self) -> int:
        """Return the number of transactions that a stop has at least, with those of concurrent stops of its drive."""
        return self._transactions + 2 * (self._most_first_frames - 1)


def _fastest_transaction_s(known_s: float, stops: Iterable[OperationContext]) -> float:
    return min([known_s, *(op.age.fastest_transaction_s for op in stops)])


def timeout_transactions(dialect: Dialect) -> int:
    """Return the number of transactions of two verified states and two stops, at least 16."""
    verified_state = VERIFICATION_ROUNDS * (1 + len(dialect.state_reads()))
    return max(MIN_TIMEOUT_TRANSACTIONS, 2 * (verified_state + len(dialect.stop(StopMode.STOP))))


def stop(
    op: OperationContext,
    mode: StopMode = StopMode.STOP,
    *,
    wait_confirmed: bool = True,
    progress: StopProgress | None = None,
) -> DriveOperation[Outcome]:
    """Stop and return how far that is confirmed. Never raises for what the bus or the drive does.

    ``wait_confirmed`` False returns once the drive has answered the stop, with an unconfirmed outcome; a drive that
    can't report standstill is sent the stop three times in either case, and the outcome is acknowledged.
    """
    progress = progress or StopProgress(op, (yield from get_bus_conditions()).now)
    op.read_priority = RequestPriority.STOP_READ
    try:
        outcome = yield from _send_and_confirm(op, mode, progress, wait_confirmed=wait_confirmed)
    finally:
        op.read_priority = RequestPriority.PARAMETER
    if outcome.succeeded:
        op.may_be_running = op.motion_seen = False
    return outcome


def _send_and_confirm(
    op: OperationContext, mode: StopMode, progress: StopProgress, *, wait_confirmed: bool
) -> DriveOperation[Outcome]:
    started_at = (yield from get_bus_conditions()).now
    answered = yield from send_stop(op, mode)
    if not op.dialect.reports_run_state:
        return (yield from _repeat_unverifiable(op, mode, answered=answered, last_sent_at=started_at))
    if wait_confirmed:
        return (yield from _until_confirmed(op, mode, started_at, progress))
    if not op.stops_sent:
        return unconfirmed_outcome(op)
    return op.outcome(OutcomeStatus.UNKNOWN, "drives.stop_answered" if answered else "drives.stop_unanswered")


def send_stop(op: OperationContext, mode: StopMode) -> DriveOperation[bool]:
    """Send one stop and what must follow it. Return whether the drive accepted it.

    A drive that takes commands only after an unlock is sent it where it rejects the stop, and the stop again.
    """
    if not (yield from _may_stop(op)):
        return False
    answered = yield from _send_stop_frames(op, mode)
    unlock = op.dialect.unlock()
    if op.stop_rejection is not None and unlock is not None:
        yield from op.transact(unlock, RequestPriority.STOP)
        answered = yield from _send_stop_frames(op, mode)
    return answered


def _send_stop_frames(op: OperationContext, mode: StopMode) -> DriveOperation[bool]:
    """Send the frames of one stop. Return whether the drive accepted the first, which stops.

    No other is sent until the drive has accepted that: the levels alone let a paused or held motor run again, and turn
    one that another program has reversed.
    """
    answered = False
    for place, request in enumerate(op.dialect.stop(mode)):
        if place and not answered:
            break
        result: BusResult = yield from op.transact(
            request,
            RequestPriority.COMMAND if place else RequestPriority.STOP,
            tag=None if place or op.stops_sent else OWN_FRAME,
        )
        if place == 0:
            if not op.stops_sent and result.sent_at is None:
                op.first_frame = None  # the next one serves this stop alone
            op.stops_sent += result.sent_at is not None
            op.stop_rejection = None if result.reply is None else op.dialect.rejection(result.reply)
            answered = result.error is None and result.reply is not None and op.stop_rejection is None
            if isinstance(result.error, DrivebusError):
                op.state_reports.name_unusable(result.error)
    return answered


def _may_stop(op: OperationContext) -> DriveOperation[bool]:
    """Return whether the stop may be sent: at once, unless this is the first contact with a station of such a model.

    A station that does not answer is sent it where a drive of this model has been made ready to start there before.
    """
    yield from op.void_checks_after_contact_loss()
    op.stop_awaits_model = not op.drive.model_assumed and op.dialect.model_check() is not None
    unconfirmed = (yield from op.check_model()) if op.stop_awaits_model else None
    op.stop_awaits_model = False
    is_silent_drive = unconfirmed is not None and not unconfirmed.answered and op.drive.was_this_model
    op.withheld_stop = None if is_silent_drive else unconfirmed
    return op.withheld_stop is None


def _repeat_unverifiable(
    op: OperationContext, mode: StopMode, *, answered: bool, last_sent_at: float
) -> DriveOperation[Outcome]:
    """Stop a drive without a run status: repeat it, then report it as acknowledged."""
    for _ in range(UNVERIFIABLE_STOP_SENDS - 1):
        if not answered:  # the reply mirrors the stop: a read shows whether the adapter echoes
            yield from _read_or_wait(op, _read_for_a_named_reply(op), last_sent_at)
        last_sent_at = yield from wait(STOP_POLL_INTERVAL_S)
        answered = (yield from send_stop(op, mode)) or answered
    if answered:
        return op.outcome(OutcomeStatus.ACKNOWLEDGED, "drives.stop_acknowledged")
    return unconfirmed_outcome(op)


def _read_for_a_named_reply(op: OperationContext) -> DriveOperation[None]:
    """Perform a harmless read, which shows whether the adapter echoes; keep what is wrong with its reply."""
    error = yield from op.sync()
    if error is not None:
        op.state_reports.name_unusable(error)


def _until_confirmed(
    op: OperationContext, mode: StopMode, last_sent_at: float, progress: StopProgress
) -> DriveOperation[Outcome]:
    """Read the state and resend the stop until a verified state shows the output off or the deadline is over."""
    while True:
        if not (yield from _read_or_wait(op, op.read_verified_state(allowed_failures=0), last_sent_at)):
            op.derived = STATE_NOT_READ
        now = (yield from get_bus_conditions()).now
        if op.derived.state.output_off and _is_stop_confirmed(op):
            return _stopped_outcome(op)
        slowing = progress.update(now)
        if progress.is_over(now):
            return unconfirmed_outcome(op)
        if not slowing or now - last_sent_at >= STOP_RESEND_INTERVAL_S:
            yield from send_stop(op, mode)
            last_sent_at = now
        yield from wait(STOP_POLL_INTERVAL_S)


def _read_or_wait(op: OperationContext, reads: DriveOperation[Any], last_sent_at: float) -> DriveOperation[bool]:
    """Perform reads, or wait for the next stop where the bus holds reads back for longer. Return whether it read.

    The bus holds them back, for up to 5 s, where a late reply could pass for that of a read; the stop goes on.
    """
    conditions = yield from get_bus_conditions()
    if conditions.reads_wait_until > conditions.now + STOP_RESEND_INTERVAL_S:
        yield from wait(max(0.0, last_sent_at + STOP_RESEND_INTERVAL_S - conditions.now))
        return False
    op.waits_in_quarantine = False  # reads that the bus begins to hold back while they wait fail
    yield from reads
    op.waits_in_quarantine = True
    return True


def unconfirmed_outcome(op: OperationContext) -> Outcome:
    """Return the outcome of a stop that must be checked at the drive, with what the drive has reported."""
    if op.port_error is not None:
        return _port_lost_outcome(op, op.port_error)
    if op.withheld_stop is not None:
        model, withheld = op.dialect.profile.model, op.withheld_stop
        key = "drives.stop_withheld" if withheld.answered else "drives.stop_withheld_silent"
        return op.outcome(OutcomeStatus.UNKNOWN, key, station=op.dialect.address, model=model, why=withheld.why)
    if not op.stops_sent and op.stop_awaits_model:
        params = {"station": op.dialect.address, "model": op.dialect.profile.model}
        return op.outcome(OutcomeStatus.UNKNOWN, "drives.stop_awaits_model", **params)
    if not op.stops_sent:
        return op.outcome(OutcomeStatus.UNKNOWN, "drives.stop_not_completed")
    reports, why = op.state_reports, op.stop_rejection and op.stop_rejection.text
    if reports.newest is None:
        if why is not None:
            return op.outcome(OutcomeStatus.UNKNOWN, "drives.stop_rejected", why=why)
        key = "drives.stop_no_reply" if reports.unusable is None else "drives.stop_unusable_replies"
        return op.outcome(OutcomeStatus.UNKNOWN, key, why=reports.unusable)
    state, output_hz = reports.newest.state, reports.output_hz
    params = {
        "found": reported_text(state, output_hz),
        "reads": reports.count,
        "failures": reports.failures,
        "state": state,
        "output_hz": output_hz,
    }
    if reports.failures:
        key = "drives.stop_reply_lost"
    elif why is not None:
        key, params["why"] = "drives.stop_rejected_running", why
    else:
        key = "drives.stop_unconfirmed" if state.turning else "drives.stop_contradicted"
    outcome = op.outcome(OutcomeStatus.UNKNOWN, key, **params)
    if reports.unusable is not None:
        outcome = with_note(outcome, "drives.unusable_replies", why=reports.unusable)
    if op.derived is not STATE_NOT_READ or outcome.drive_status is None:
        return outcome
    status = replace(outcome.drive_status, state=state, direction=reports.newest.direction, reason=None)
    return replace(outcome, drive_status=status)


def _port_lost_outcome(op: OperationContext, error: PortLost) -> Outcome:
    """Return the outcome of a stop whose last transaction failed because of the port."""
    params: dict[str, Any] = {"why": bilingual_text(error.key, **error.params)}
    if not op.stops_sent:
        return op.outcome(OutcomeStatus.UNKNOWN, "drives.stop_not_sent_port", **params)
    params["sent"] = op.stops_sent
    newest = op.state_reports.newest
    if newest is None:
        return op.outcome(OutcomeStatus.UNKNOWN, "drives.stop_port_lost", **params)
    params["found"] = reported_text(newest.state, op.state_reports.output_hz)
    return op.outcome(OutcomeStatus.UNKNOWN, "drives.stop_port_lost_after", **params)


def removed_outcome(op: OperationContext) -> Outcome:
    """Return the outcome of a stop whose drive was removed from its bus after a stop was sent."""
    newest, sent = op.state_reports.newest, op.stops_sent
    if newest is None:
        return op.outcome(OutcomeStatus.UNKNOWN, "drives.stop_removed", sent=sent)
    found = reported_text(newest.state, op.state_reports.output_hz)
    return op.outcome(OutcomeStatus.UNKNOWN, "drives.stop_removed_after", sent=sent, found=found)


def reported_text(state: DriveState, output_hz: float | None) -> Text:
    """Format ``running at 25.0 Hz``, without a frequency that the drive does not report as good."""
    return bilingual_text(
        "drives.reported" if output_hz is None else "drives.reported_at", state=state, output_hz=output_hz
    )


def _is_stop_confirmed(op: OperationContext) -> bool:
    """Return whether the stop is over: in a fault or with an uncharged DC bus, else where the dialect confirms it."""
    state = op.derived.state
    return state in (DriveState.FAULT, DriveState.NOT_READY) or op.dialect.confirms_stop(op.reading_pairs)


def _stopped_outcome(op: OperationContext) -> Outcome:
    state = op.derived.state
    plain = state in (DriveState.STOPPED, DriveState.EMERGENCY_STOPPED)
    if op.dialect.state_names == ("output_frequency",):  # no reply shows whether the output is on at 0 Hz
        return op.outcome(OutcomeStatus.CONFIRMED, "drives.stop_confirmed_by_frequency")
    key = "drives.stop_confirmed" if plain else "drives.output_off"
    return op.outcome(OutcomeStatus.CONFIRMED, key, state=state)
