"""Pause a run, and hold the ramp for a while: both are levels that keep a running motor from its set frequency.

A pause lasts until a start or a stop. A ramp hold has no status bit, so no later command could know of it: the
operation that begins it ends it too.
"""

from __future__ import annotations

from dataclasses import replace

from drivebus.drives.context import DriveContext
from drivebus.drives.dialects.base import Hold
from drivebus.drives.operations.command_age import CommandAge
from drivebus.drives.operations.context import OperationContext, with_note
from drivebus.drives.operations.preflight import ensure_preflight
from drivebus.drives.operations.start import COMMAND_SETTLE_S, START_CONFIRM_TIMEOUT_S, speed_tolerance_hz
from drivebus.drives.operations.steps import DriveOperation, get_bus_conditions, wait
from drivebus.drives.operations.stop import stop
from drivebus.drives.outcome import Outcome, OutcomeStatus
from drivebus.drives.permissives import RUN_STATES, CommandKind, DriveCommand, state_inhibit
from drivebus.drives.state import DriveState
from drivebus.errors import Expired, LimitError, StartInhibited
from drivebus.values import Text

MAX_RAMP_HOLD_S = 10.0  # longest time for which one command keeps the frequency where it is
MAX_END_DELAY_S = 2.0  # a hold that lasted so much longer, because this computer was held up, is reported
RAMP_HOLD_POLL_INTERVAL_S = 0.2  # pause between two verified states while the ramp is held


def pause(op: OperationContext) -> DriveOperation[Outcome]:
    """Pause the run: the motor ramps down to 0 Hz. Raises CapabilityError, StartInhibited or the error of the bus."""
    op.drive.require_capability(Hold.PAUSE.value)
    yield from op.start_clock()
    yield from op.require_state()
    if op.derived.state is DriveState.PAUSED:
        return op.outcome(OutcomeStatus.CONFIRMED, "drives.paused")
    _check_runs(op, CommandKind.PAUSE)
    command = op.create_command(CommandKind.PAUSE, (yield from op.check_deadline()))
    op.dialect.adopt_direction(op.reading_pairs)
    result = yield from op.send_command(command, op.dialect.hold(Hold.PAUSE))
    refused = op.rejected_outcome(result)
    if refused is not None:
        return refused
    return (yield from _wait_until_paused(op, command))


def _check_runs(op: OperationContext, kind: CommandKind) -> None:
    if op.derived.state not in RUN_STATES:
        raise state_inhibit(op.derived, kind)


def _wait_until_paused(op: OperationContext, command: DriveCommand) -> DriveOperation[Outcome]:
    deadline = (yield from get_bus_conditions()).now + START_CONFIRM_TIMEOUT_S
    while True:
        yield from wait(COMMAND_SETTLE_S)
        error = yield from op.read_verified_state()
        now = yield from op.check_not_superseded(command)
        state = op.derived.state
        if state is DriveState.PAUSED:
            return op.outcome(OutcomeStatus.CONFIRMED, "drives.paused")
        if state.output_off:
            return op.outcome(OutcomeStatus.FAILED, "drives.not_paused", state=state)
        if now > deadline:
            is_known = error is None and state is not DriveState.UNKNOWN
            key = "drives.not_paused" if is_known else "drives.pause_unknown"
            return op.outcome(OutcomeStatus.FAILED if is_known else OutcomeStatus.UNKNOWN, key, state=state)


def check_ramp_hold(drive: DriveContext, seconds: float) -> None:
    """Check what forbids a ramp hold without a read of the drive. Raises CapabilityError or LimitError."""
    drive.require_capability(Hold.RAMP.value)
    if not 0.0 < seconds <= MAX_RAMP_HOLD_S:
        raise LimitError("drives.ramp_hold_time", seconds=seconds, limit_s=MAX_RAMP_HOLD_S)


def hold_ramp(op: OperationContext, seconds: float) -> DriveOperation[Outcome]:
    """Keep the output frequency where it is for some seconds, then let the motor follow its set frequency again.

    Raises before sending: CapabilityError, LimitError (the time, or the present frequency), PreflightError,
    StartInhibited, Expired or the error of the bus.
    """
    check_ramp_hold(op.drive, seconds)
    yield from op.start_clock()
    yield from op.require_state()
    _check_runs(op, CommandKind.RAMP_HOLD)
    yield from op.void_checks_after_contact_loss()
    yield from ensure_preflight(op)
    yield from op.require_state()
    output_hz = op.output_hz()
    if output_hz is None:
        raise state_inhibit(op.derived, CommandKind.RAMP_HOLD)
    op.check_frequency(abs(output_hz))
    command = op.create_command(CommandKind.RAMP_HOLD, (yield from op.check_deadline()))
    op.dialect.adopt_direction(op.reading_pairs)
    result = yield from op.send_command(command, op.dialect.hold(Hold.RAMP))
    refused = op.rejected_outcome(result)
    if refused is not None:
        return refused
    if result.error is not None:
        return (yield from _end_ramp_hold(op, output_hz, answered=False))
    held_frequency = HeldFrequency((yield from get_bus_conditions()).now)
    if (ended := (yield from _wait_for_hold_end(op, command, seconds, held_frequency))) is not None:
        return ended
    outcome = yield from _end_ramp_hold(op, output_hz, answered=True)
    if not outcome.succeeded:
        return outcome
    if held_frequency.has_changed(op):
        params = {"from_hz": held_frequency.first_hz, "to_hz": held_frequency.last_hz}
        return replace(outcome, status=OutcomeStatus.FAILED, key="drives.ramp_not_held", params=params)
    held_s = (yield from get_bus_conditions()).now - held_frequency.began_at
    if held_s <= seconds + MAX_END_DELAY_S:
        return outcome
    return with_note(outcome, "drives.ramp_held_for", held_s=round(held_s, 1))


class HeldFrequency:
    """Output frequency while a ramp is held: the first and the last that was read."""

    def __init__(self, began_at: float) -> None:
        self.began_at = began_at
        self.first_hz: float | None = None
        self.last_hz: float | None = None

    def add(self, output_hz: float | None) -> None:
        """Add the output frequency of a verified state, None where it was not read."""
        if output_hz is not None:
            self.first_hz = output_hz if self.first_hz is None else self.first_hz
            self.last_hz = output_hz

    def has_changed(self, op: OperationContext) -> bool:
        """Return whether it has changed: the drive did not hold it, or has lost the hold with its power."""
        if self.first_hz is None or self.last_hz is None:
            return False
        return abs(self.last_hz - self.first_hz) > speed_tolerance_hz(op, abs(self.first_hz))


def _wait_for_hold_end(
    op: OperationContext, command: DriveCommand, seconds: float, held_frequency: HeldFrequency
) -> DriveOperation[Outcome | None]:
    """Read the state until the time is over; return the outcome of a motor that was switched off meanwhile."""
    ends_at = held_frequency.began_at + seconds
    while True:
        yield from op.read_verified_state()
        now = yield from op.check_not_superseded(command)
        if op.derived.state.output_off:
            op.may_be_running = False
            return op.outcome(OutcomeStatus.FAILED, "drives.ramp_hold_ended", state=op.derived.state)
        held_frequency.add(op.output_hz())
        if now >= ends_at:
            return None
        yield from wait(min(RAMP_HOLD_POLL_INTERVAL_S, ends_at - now))


def _end_ramp_hold(op: OperationContext, output_hz: float, *, answered: bool) -> DriveOperation[Outcome]:
    """End the hold, by a stop where the drive does not acknowledge that. ``answered``: it has acknowledged the hold."""
    op.age = CommandAge(requested_at=None, checks_started_at=None)  # the end was requested for now
    command = op.create_command(CommandKind.RAMP_HOLD, (yield from get_bus_conditions()))
    op.dialect.adopt_direction(op.reading_pairs)
    try:
        result = yield from op.send_command(command, op.dialect.end_hold())
        if result.error is None and op.rejected_outcome(result) is None:
            op.may_be_running = False
            return op.unverifiable_outcome(
                "drives.ramp_held", "drives.ramp_hold_unanswered", answered=answered, output_hz=output_hz
            )
    except (StartInhibited, Expired):
        pass  # the drive no longer shows that it runs, or the bus forbids every motion by now
    stopped = yield from stop(op)
    return op.outcome(OutcomeStatus.UNKNOWN, "drives.ramp_hold_unknown", ended=Text.per_language(stopped.text))
