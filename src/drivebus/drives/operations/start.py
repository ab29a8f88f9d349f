"""Run a drive: check, get a permit, send once, confirm by verified reads.

A start that was not answered is resent only after a verified state shows standstill, with the frequency that was set.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from drivebus.bus.messages import BusResult
from drivebus.drives.context import DriveContext
from drivebus.drives.dialects.base import CommandFrame, Hold
from drivebus.drives.operations.context import OperationContext, with_note
from drivebus.drives.operations.preflight import ensure_preflight, recheck_maximum_frequency, record_model
from drivebus.drives.operations.preparation import prepare_start
from drivebus.drives.operations.setpoint import (
    lost_setpoint_outcome,
    read_back_setpoint,
    set_frequency,
    write_setpoint,
)
from drivebus.drives.operations.steps import BusConditions, DriveOperation, get_bus_conditions, wait
from drivebus.drives.operations.stop import reported_text, stop
from drivebus.drives.outcome import Outcome, OutcomeStatus, raise_for_status
from drivebus.drives.permissives import COMMAND_TTL_S, RUN_STATES, CommandKind, DriveCommand, state_inhibit
from drivebus.drives.speed_progress import SpeedProgress
from drivebus.drives.state import Direction, DriveState, DriveStatus
from drivebus.errors import (
    CapabilityError,
    DrivebusError,
    Expired,
    PortLost,
    PreflightError,
    StartInhibited,
    Superseded,
    TargetNotReached,
)
from drivebus.values import Quality, Text

SPEED_POLL_INTERVAL_S = 0.1  # pause between two verified states while the drive accelerates
RAMP_FACTOR = 1.5  # a ramp may take 1.5 times its set time
RAMP_SLACK_S = 2.0  # added to that, for short ramps
DEFAULT_RAMP_TIMEOUT_S = 60.0  # of a model that does not report its ramp
AT_SPEED_TOLERANCE = 0.005  # share of the set frequency; at least two steps of the reported one
COMMAND_SETTLE_S = 0.15  # pause before the first read: a C320 may still report "stopped" (its manual, 2.4.6)
START_CONFIRM_TIMEOUT_S = 3.0  # a drive that still stands after this did not execute the start
OVERSPEED_SHARE = 0.2  # excess over the set frequency; slip compensation and overshoot stay below 10 %
OVERSPEED_HZ = 3.0  # least excess, which counts at low frequencies
SPEED_UNKNOWN_NOTES = ("drives.setpoint_not_shown", "drives.start_interrupted")  # left out once the speed is confirmed
WITHHELD_ERRORS = (StartInhibited, Expired, Superseded)  # errors of a frame that was not sent
_SPEEDING_STATES = (DriveState.RUNNING, DriveState.ACCELERATING)
MAX_RESENDS = 2  # times that an unanswered start or reset is resent, while it has not expired


def run(
    op: OperationContext, frequency_hz: float, direction: Direction | None, *, will_wait: bool = False
) -> DriveOperation[Outcome]:
    """Run at a frequency. Raises before sending: CapabilityError, LimitError, PreflightError, StartInhibited, Expired.

    ``will_wait``: ``wait_at_speed`` follows, so a model that can't show its speed is rejected now.
    """
    check_run(op.drive, frequency_hz, direction, will_wait=will_wait)
    yield from op.start_clock()
    try:
        yield from check_readiness(op)
        word, actual_hz = op.check_frequency(frequency_hz)  # again: the pre-flight check reads what the word means
        _check_pause(op, direction)
        kind = CommandKind.RESUME if _is_paused(op) else CommandKind.START
        if op.derived.state.turning and kind is CommandKind.START:
            outcome = yield from _change_running_speed(op, frequency_hz, direction)
        else:
            outcome = yield from _start_from_standstill(op, actual_hz, direction, word, kind)
    except PortLost as error:
        if op.may_be_running:
            raise
        raise PortLost("drives.start_not_sent_port", why=Text.per_language(error.text)) from error
    if actual_hz == 0.0 and outcome.succeeded:
        outcome = with_note(outcome, "drives.run_at_zero")
    return _with_unread_preconditions(op, outcome)


def check_run(drive: DriveContext, frequency_hz: float, direction: Direction | None, *, will_wait: bool) -> None:
    """Check what forbids a run without a read of the drive. Raises CapabilityError, LimitError or StartInhibited."""
    drive.require_capability("run")
    drive.check_direction(direction)
    word, _ = drive.check_frequency(frequency_hz)
    drive.dialect.start(direction, word)  # raises where the model or a missing calibration forbids it
    if will_wait and not drive.dialect.can_confirm_speed():
        raise CapabilityError("drives.cannot_wait", model=drive.dialect.profile.model)


def check_readiness(op: OperationContext) -> DriveOperation[None]:
    """Read the state and the pre-flight check, and the state again where the check took time.

    A fault is reported first: parameters can't be read then (C320). Raises StartInhibited, PreflightError or the
    error of the bus.
    """
    yield from op.require_state()
    state = op.derived.state
    if op.dialect.reports_run_state and not state.turning and state is not DriveState.STOPPED:
        raise state_inhibit(op.derived, CommandKind.START)
    yield from op.void_checks_after_contact_loss()
    known = op.drive.preflight
    if (yield from ensure_preflight(op)) is not known:
        yield from op.require_state()
    yield from record_model(op)


def _is_paused(op: OperationContext) -> bool:
    """Return whether a start ends a pause of this drive."""
    return op.derived.state is DriveState.PAUSED and Hold.PAUSE.value in op.dialect.profile.capabilities


def _check_pause(op: OperationContext, direction: Direction | None) -> None:
    """Check that a paused drive may go on. Raises StartInhibited in a fault, or while its motor turns the other way."""
    if not _is_paused(op):
        return
    derived = op.derived
    if derived.fault_code is not None:
        raise StartInhibited("drives.state_forbids", state=DriveState.FAULT, kind=CommandKind.RESUME)
    if op.output_hz() != 0.0 and derived.direction not in (None, direction or Direction.FORWARD):
        raise StartInhibited("drives.turning", state=derived.state, direction=derived.direction)


def _create_start(
    op: OperationContext, kind: CommandKind, direction: Direction | None, conditions: BusConditions
) -> DriveCommand:
    """Create the start as it was decided: a stop or a pause by another program meanwhile does not change its kind.

    Raises StartInhibited where the state that was read last forbids the end of a pause.
    """
    _check_pause(op, direction)
    return op.create_command(kind, conditions)


def _change_running_speed(
    op: OperationContext, frequency_hz: float, direction: Direction | None
) -> DriveOperation[Outcome]:
    """Change the frequency of a running drive. Reversing begins at standstill."""
    derived = op.derived
    target_direction = direction or Direction.FORWARD
    runs = derived.state in RUN_STATES
    if not runs or (derived.direction is not None and derived.direction is not target_direction):
        if derived.direction is None:
            raise StartInhibited("drives.turning_state", state=derived.state)
        raise StartInhibited("drives.turning", state=derived.state, direction=derived.direction)
    if derived.direction is None and direction is not None:
        raise StartInhibited("drives.turning_unknown_direction", direction=direction)
    stop_epoch = (yield from get_bus_conditions()).stop_epoch
    slows_down = derived.state is DriveState.DECELERATING or _output_falls(op)
    outcome = yield from set_frequency(op, frequency_hz)
    output_hz = op.output_hz()
    # Two readings of a slow ramp may be equal. That it leads to a stop shows only later: the speed does not rise.
    must_rise = output_hz is not None and abs(output_hz) < frequency_hz - speed_tolerance_hz(op, frequency_hz)
    if (slows_down or must_rise) and outcome.succeeded:
        return (yield from _check_runs_on(op, outcome, frequency_hz, stop_epoch))
    return outcome


def _check_runs_on(
    op: OperationContext, outcome: Outcome, frequency_hz: float, stop_epoch: int
) -> DriveOperation[Outcome]:
    """Check that a drive was not being stopped when it got its new frequency, which would not start it again.

    While it is faster than the new frequency it may slow down to it or stop: a note says so. A speed that neither
    falls nor rises until the end shows nothing.
    """
    until = (yield from get_bus_conditions()).now + START_CONFIRM_TIMEOUT_S
    reports_output = "output_frequency" in op.dialect.profile.signals  # a Huanyang H2A reports its speed instead
    near_hz = speed_tolerance_hz(op, frequency_hz) if reports_output else 0.0
    first_hz = lowest_hz = abs(op.output_hz() or 0.0)
    while True:
        yield from wait(COMMAND_SETTLE_S)
        yield from op.read_verified_state()
        conditions = yield from get_bus_conditions()
        if conditions.stop_epoch != stop_epoch:
            raise op.superseded_error()
        state, output = op.derived.state, abs(op.output_hz() or 0.0)
        lowest_hz = min(lowest_hz, output)
        falls = state is DriveState.DECELERATING or output < first_hz
        runs_on = not reports_output or output > lowest_hz or abs(output - frequency_hz) <= near_hz
        if state.driven and (runs_on or (not falls and conditions.now > until)):
            return outcome
        if falls and output > frequency_hz + near_hz:
            return with_note(outcome, "drives.still_decelerating", output_hz=output)
        if state in (DriveState.FAULT, DriveState.EMERGENCY_STOPPED, DriveState.NOT_READY):
            return op.outcome(OutcomeStatus.FAILED, "drives.start_failed", state=state)
        if state.output_off or conditions.now > until:
            status = OutcomeStatus.UNKNOWN if state is DriveState.UNKNOWN else OutcomeStatus.FAILED
            return op.outcome(status, "drives.run_while_decelerating", found=reported_text(state, op.output_hz()))


def _output_falls(op: OperationContext) -> bool:
    """Return whether the output frequency fell between the last two readings: some drives report *running* then."""
    pair = op.reading_pairs.pair("output_frequency")
    values = [abs(reading.value) for reading in pair or () if isinstance(reading.value, int | float)]
    return len(values) == 2 and values[1] < values[0]


def _start_from_standstill(
    op: OperationContext, frequency_hz: float, direction: Direction | None, word: int, kind: CommandKind
) -> DriveOperation[Outcome]:
    if op.dialect.start_includes_setpoint:
        return (yield from _send_start(op, frequency_hz, direction, word, kind))
    yield from prepare_start(op)
    conditions = yield from op.check_deadline()
    start = _create_start(op, kind, direction, conditions)
    yield from op.request_permit(start, op.dialect.start(direction, word)[0])  # no permit, no frequency
    setpoint = op.create_command(CommandKind.SETPOINT, conditions)
    outcome = yield from write_setpoint(op, setpoint, word, frequency_hz)
    if outcome.status is OutcomeStatus.REFUSED:
        return _refused_outcome(outcome, "drives.start_setpoint_refused", frequency_hz=frequency_hz)
    if not outcome.succeeded:
        return _not_started_outcome(outcome)
    yield from op.check_not_superseded(setpoint)
    try:
        yield from recheck_maximum_frequency(op)
        if op.dialect.reports_run_state:
            yield from op.require_state()
        if (lost := lost_setpoint_outcome(op)) is not None:
            return _not_started_outcome(lost)
        return (yield from _send_start(op, frequency_hz, direction, word, kind))
    except (StartInhibited, PreflightError, Expired) as withheld:  # after the frequency was sent
        return op.outcome(OutcomeStatus.FAILED, "drives.not_started", why=withheld)


def _send_start(
    op: OperationContext, frequency_hz: float, direction: Direction | None, word: int, kind: CommandKind
) -> DriveOperation[Outcome]:
    conditions = yield from op.check_deadline()
    command = _create_start(op, kind, direction, conditions)
    highest_hz = frequency_hz
    if command.kind is CommandKind.RESUME:  # the motor may still ramp down from a higher frequency
        highest_hz = max(frequency_hz, abs(op.output_hz() or 0.0))
    op.overspeed_hz = highest_hz + max(OVERSPEED_SHARE * highest_hz, OVERSPEED_HZ)
    frames = op.dialect.start(direction, word)
    lost_before = op.lost_replies
    result = yield from send_frames(op, command, frames)
    refused = op.rejected_outcome(result)
    if refused is not None:
        return _refused_outcome(refused, "drives.start_refused")
    outcome = yield from confirm_start(op, command, frames, direction, answered=result.error is None)
    yield from _stop_at_overspeed(op, frequency_hz)
    if outcome.status is OutcomeStatus.CONFIRMED and op.dialect.start_includes_setpoint:
        has_lost = op.lost_replies > lost_before
        return (yield from _check_setpoint(op, outcome, word, frequency_hz, has_lost=has_lost))
    return outcome


def _refused_outcome(refused: Outcome, key: str, **params: Any) -> Outcome:
    """Return a rejection with the frame that the drive rejected named by the sentence of ``key``."""
    why = Text.per_language(refused.text)
    return replace(refused, key=key, params={**params, "code": refused.params["code"], "why": why})


def _not_started_outcome(outcome: Outcome) -> Outcome:
    """Return the outcome of a start that was not sent because its frequency is not known to be set."""
    return replace(outcome, status=OutcomeStatus.FAILED, key="drives.not_started", params={"why": outcome})


def send_frames(
    op: OperationContext, command: DriveCommand, frames: tuple[CommandFrame, ...]
) -> DriveOperation[BusResult]:
    """Send the acting frame and the frames that must follow it. Return the result of the acting one.

    Raises StartInhibited, Expired or Superseded only before the acting frame was sent.
    """
    first: BusResult = yield from op.send_command(command, frames[0])
    if first.sent:
        try:
            for frame in frames[1:]:
                yield from op.send_command(command, frame)
        except WITHHELD_ERRORS:
            pass
    return first


def resend_frames(
    op: OperationContext, command: DriveCommand, frames: tuple[CommandFrame, ...]
) -> DriveOperation[bool | None]:
    """Send the frames again. Return whether the drive answered, None where they may not be sent any more."""
    try:
        result = yield from send_frames(op, command, frames)
    except WITHHELD_ERRORS:
        return None
    return result.error is None


def confirm_start(
    op: OperationContext,
    command: DriveCommand,
    frames: tuple[CommandFrame, ...],
    direction: Direction | None,
    *,
    answered: bool,
) -> DriveOperation[Outcome]:
    """Confirm the start by verified states; resend an unanswered one only while they show standstill."""
    if not op.dialect.reports_run_state:
        return op.unverifiable_outcome("drives.start_acknowledged", "drives.start_unknown", answered=answered)
    sent_again = 0
    deadline = (yield from op.check_not_superseded(command)) + START_CONFIRM_TIMEOUT_S
    op.motion_seen = False
    while True:
        yield from wait(COMMAND_SETTLE_S)
        yield from op.read_verified_state()
        now = yield from op.check_not_superseded(command)
        state = op.derived.state
        if state.driven:
            return _running_outcome(op, direction)
        if state in (DriveState.FAULT, DriveState.EMERGENCY_STOPPED, DriveState.NOT_READY) and not op.motion_seen:
            return op.outcome(OutcomeStatus.FAILED, "drives.start_failed", state=state)
        start_shown = op.motion_seen or op.dialect.confirms_start(op.reading_pairs)
        may_resend = state is DriveState.STOPPED and not answered and not start_shown and not lost_setpoint_outcome(op)
        if may_resend and sent_again < MAX_RESENDS and now < command.created_at + COMMAND_TTL_S[CommandKind.START]:
            answered_again = yield from resend_frames(op, command, frames)
            answered, sent_again = bool(answered_again), MAX_RESENDS if answered_again is None else sent_again + 1
        elif op.motion_seen and state.output_off:
            has_tripped = state in (DriveState.FAULT, DriveState.NOT_READY)
            key = "drives.started_and_tripped" if has_tripped else "drives.started_and_stopped"
            return op.outcome(OutcomeStatus.FAILED, key, state=state)
        elif now > deadline:
            return _unconfirmed_outcome(op, state)


def _running_outcome(op: OperationContext, direction: Direction | None) -> Outcome:
    wrong = _wrong_direction_outcome(op, direction) or lost_setpoint_outcome(op)
    return wrong or op.outcome(OutcomeStatus.CONFIRMED, "drives.start_confirmed", state=op.derived.state)


def _wrong_direction_outcome(op: OperationContext, direction: Direction | None) -> Outcome | None:
    """Return the outcome of a drive that reports another direction than commanded; a start without one is forward."""
    expected, reported = direction or Direction.FORWARD, op.derived.direction
    if reported is None or reported is expected:
        return None
    return op.outcome(OutcomeStatus.FAILED, "drives.wrong_direction", expected=expected, found=reported)


def _unconfirmed_outcome(op: OperationContext, state: DriveState) -> Outcome:
    if state is DriveState.UNKNOWN or state.turning:  # jogging, braking or decelerating by another command
        return op.outcome(OutcomeStatus.UNKNOWN, "drives.start_unknown")
    op.drive.preflight = None  # the next start checks again whether the drive accepts commands
    lost = lost_setpoint_outcome(op)
    return lost or op.outcome(
        OutcomeStatus.FAILED, "drives.start_ignored", state=state, after_s=START_CONFIRM_TIMEOUT_S
    )


def _check_setpoint(
    op: OperationContext, outcome: Outcome, word: int, frequency_hz: float, *, has_lost: bool
) -> DriveOperation[Outcome]:
    """Check the frequency of a confirmed start, where the drive shows it.

    A drive that shows only its output frequency (C320) has not reached it yet: ``wait_at_speed`` confirms it. Where
    replies were missing since the start, a note says that a power failure may have changed the frequency.
    """
    if not op.dialect.setpoint_reads() and op.dialect.can_confirm_speed():
        return with_note(outcome, "drives.start_interrupted") if has_lost else outcome
    if not op.dialect.setpoint_reads():
        return with_note(outcome, "drives.setpoint_not_shown", frequency_hz=frequency_hz)
    checked = yield from read_back_setpoint(op, word, frequency_hz, answered=True)
    if checked.status is OutcomeStatus.FAILED:
        return raise_for_status(checked)  # raises: the drive runs at another frequency
    merged = replace(outcome, exchanges=checked.exchanges)
    if checked.status is OutcomeStatus.CONFIRMED:
        return merged
    return with_note(merged, "drives.setpoint_not_shown", frequency_hz=frequency_hz)


def _with_unread_preconditions(op: OperationContext, outcome: Outcome) -> Outcome:
    """Name the preconditions that could not be read; none is assumed to be met."""
    preflight = op.drive.preflight
    for notation, why in preflight.unreadable if preflight else ():
        outcome = with_note(outcome, "drives.precondition_unread", notation=notation, why=why)
    return outcome


def speed_tolerance_hz(op: OperationContext, frequency_hz: float) -> float:
    """Return the greatest difference in Hz at which the output frequency counts as the set one."""
    step = op.dialect.profile.signals["output_frequency"].scale.factor
    return max(2.0 * step, AT_SPEED_TOLERANCE * frequency_hz)


def ramp_timeout_s(acceleration_s: float | None, timeout_s: float | None) -> float:
    """Return the longest time that a ramp may take: ``timeout_s``, else by the ramp time ``acceleration_s``."""
    if timeout_s is not None:
        return timeout_s
    return DEFAULT_RAMP_TIMEOUT_S if acceleration_s is None else acceleration_s * RAMP_FACTOR + RAMP_SLACK_S


def wait_at_speed(
    op: OperationContext,
    frequency_hz: float,
    outcome: Outcome,
    *,
    timeout_s: float | None,
    direction: Direction | None = None,
    on_progress: Callable[[DriveStatus], None] | None = None,
) -> DriveOperation[Outcome]:
    """Wait until the drive reports running at ``frequency_hz``. Raises TargetNotReached with what it reports.

    Without ``timeout_s`` it waits as long as the speed approaches: a ramp may be unknown, or changed meanwhile.
    """
    conditions = yield from get_bus_conditions()
    stop_epoch = conditions.stop_epoch
    limit_s = ramp_timeout_s(op.drive.acceleration_s, timeout_s)
    began = conditions.now
    near_hz = speed_tolerance_hz(op, frequency_hz)
    progress = SpeedProgress()
    is_near = False
    while True:
        error = yield from op.read_verified_state()
        conditions = yield from get_bus_conditions()
        if conditions.stop_epoch != stop_epoch:
            raise op.superseded_error()
        if on_progress is not None:
            on_progress(op.drive_status())
        yield from _stop_at_overspeed(op, frequency_hz)
        wrong = _wrong_direction_outcome(op, direction)
        if wrong is not None:
            return wrong
        state, output = op.derived.state, op.output_hz()
        was_near = is_near
        is_near = state is DriveState.RUNNING and output is not None and abs(abs(output) - frequency_hz) <= near_hz
        if was_near and is_near:  # one reading may be of a motor that only passes this frequency
            key = "drives.running_at"
            done = op.outcome(OutcomeStatus.CONFIRMED, key, frequency_hz=frequency_hz, output_hz=output)
            notes = tuple(note for note in outcome.notes if note[0] not in SPEED_UNKNOWN_NOTES)
            return replace(done, notes=notes)
        if output is not None:
            progress.update(abs(abs(output) - frequency_hz), conditions.now)
        waited_s = conditions.now - began
        if timeout_s is None and progress.is_recent(conditions.now):
            limit_s = max(limit_s, waited_s)
        if state.output_off or (waited_s > limit_s and not is_near):
            times = {"limit_s": round(limit_s, 1), "waited_s": round(waited_s, 1)}
            raise _not_reached_error(op, frequency_hz, output, times, error)
        yield from wait(SPEED_POLL_INTERVAL_S)


def _stop_at_overspeed(op: OperationContext, frequency_hz: float) -> DriveOperation[None]:
    """Stop a drive that was started from standstill and runs clearly faster than commanded, and raise TargetNotReached.

    Two readings must show it, the later one no slower: a falling frequency is overshoot, or a motor that was still
    turning and is caught by a speed search. A reading of uncertain scale shows nothing.
    """
    pair = op.reading_pairs.pair("output_frequency")
    if op.overspeed_hz is None or pair is None or op.derived.state not in _SPEEDING_STATES:
        return
    values = [
        abs(reading.value)
        for reading in pair
        if isinstance(reading.value, int | float) and reading.quality is Quality.GOOD
    ]
    if len(values) < len(pair) or not op.overspeed_hz < values[0] <= values[1]:
        return
    stopped = yield from stop(op)
    failure = TargetNotReached(
        "drives.overspeed", expected_hz=frequency_hz, found_hz=values[1], ended=Text.per_language(stopped.text)
    )
    status = OutcomeStatus.FAILED if stopped.succeeded else OutcomeStatus.UNKNOWN
    failure.outcome = op.outcome(status, failure.key, **failure.params)
    raise failure


def _not_reached_error(
    op: OperationContext,
    frequency_hz: float,
    output_hz: float | None,
    times: Mapping[str, float],
    error: DrivebusError | None,
) -> TargetNotReached:
    state = op.derived.state
    key = "drives.off_before_reached" if state.output_off else "drives.not_reached"
    key = key if error is None else "drives.not_reached_no_reply"
    failure = TargetNotReached(key, expected_hz=frequency_hz, found_hz=output_hz, state=state, **times)
    status = OutcomeStatus.FAILED if error is None else OutcomeStatus.UNKNOWN
    failure.outcome = op.outcome(status, key, **failure.params)
    return failure
