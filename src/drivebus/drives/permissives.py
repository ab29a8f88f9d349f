"""Permissives of a motion command, and the only code that grants a Permit.

Every frame that is neither a read nor a stop needs a permit; a stop never comes here. The bus checks station, effect,
expiry and stop epoch of the permit again when the first bit goes out.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from drivebus.bus.messages import Permit, RetryPolicy
from drivebus.drives.operations.steps import BusConditions
from drivebus.drives.state import DerivedState, DriveState, LocalizedEnum
from drivebus.errors import Expired, NotPermitted, StartInhibited, Superseded
from drivebus.protocols.codec import Effect
from drivebus.protocols.family import protocol_family


class CommandKind(LocalizedEnum):
    """Kind of a command, as the user requested it."""

    START = "start"
    JOG = "jog"
    SETPOINT = "setpoint"
    PAUSE = "pause"
    RESUME = "resume"
    """Run again after a pause: a start that does not begin at standstill."""
    RAMP_HOLD = "ramp_hold"
    RESET = "reset"
    WRITE = "write"
    INPUTS = "inputs"
    """Write to input terminals, one of which may start the motor; the user has confirmed it."""


COMMAND_TTL_S = {  # a command that is older than this was not meant for now; an operator waits for a start or a reset
    CommandKind.START: 2.0,
    CommandKind.JOG: 2.0,
    CommandKind.SETPOINT: 5.0,
    CommandKind.PAUSE: 5.0,
    CommandKind.RESUME: 2.0,
    CommandKind.RAMP_HOLD: 2.0,
    CommandKind.RESET: 2.0,
    CommandKind.WRITE: 5.0,
    CommandKind.INPUTS: 2.0,
}
MAX_STATUS_AGE_S = 2.0  # a start needs a status that is no older than the command itself may be
MIN_DAMAGED_REPLIES = 3  # one damaged reply in a hundred would otherwise inhibit every start for 5 minutes

RUN_STATES = frozenset({DriveState.RUNNING, DriveState.ACCELERATING, DriveState.DECELERATING})
"""States in which a motor follows its set frequency."""
_STATES_FOR_MOTION = {
    CommandKind.START: frozenset({DriveState.STOPPED}),
    CommandKind.JOG: frozenset({DriveState.STOPPED}),
    CommandKind.RESUME: frozenset({DriveState.PAUSED}),
    CommandKind.SETPOINT: RUN_STATES,
    CommandKind.RAMP_HOLD: RUN_STATES,
}
"""Commands that may move the motor, each with the states in which its frame may be sent."""
_STARTS = (CommandKind.START, CommandKind.JOG, CommandKind.RESUME)


@dataclass(frozen=True, slots=True)
class DriveCommand:
    """Command of a user. It can't be renewed: a later request is another command."""

    id: str
    kind: CommandKind
    created_at: float
    """Monotonic seconds."""
    stop_epoch: int

    def expires_at(self, effect: Effect) -> float:
        """Return the expiry of a frame; one that moves expires as a start does, whatever the kind of the command."""
        limit = COMMAND_TTL_S[self.kind]
        return self.created_at + (min(limit, COMMAND_TTL_S[CommandKind.START]) if effect is Effect.MOTION else limit)


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveEvidence:
    """Evidence of a drive for a permit: what it reported and which checks were made.

    ``reports_run_state`` is False for models without a run status (DF800); their pre-flight check counts alone.
    """

    derived: DerivedState
    state_at: float | None
    """Monotonic seconds of the older of the two readings of the state."""
    reports_run_state: bool
    preflight_passed: bool
    limits_checked: bool
    is_prepared: bool
    """The status asks for no further word before a start."""
    motion_seen: bool
    """A read since the command began, or since its own last stop, showed the motor turning."""
    run_seen: bool
    """A read since the command began showed the motor following its set frequency."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PermitInputs:
    """Inputs of the decision on one frame: the command, the frame, the bus and the drive."""

    command: DriveCommand
    station: int
    family: str
    effect: Effect
    retry_policy: RetryPolicy
    conditions: BusConditions
    evidence: DriveEvidence


def grant_permit(inputs: PermitInputs) -> Permit:
    """Grant a permit for one frame. Raises StartInhibited, Expired, Superseded or NotPermitted with the reason."""
    command, effect, conditions = inputs.command, inputs.effect, inputs.conditions
    _check_valid(command, effect, conditions)
    if effect not in (Effect.SETTING, Effect.MOTION):
        raise NotPermitted("drives.no_permit_needed", effect=effect.value)
    if effect is Effect.MOTION and command.kind not in (*_STATES_FOR_MOTION, CommandKind.INPUTS):
        raise NotPermitted("drives.frame_would_move", kind=command.kind)
    _raise_first(unmet_bus_permissives(inputs.station, conditions))
    if command.kind in _STARTS or effect is Effect.MOTION:
        _raise_first(unmet_start_permissives(conditions, inputs.family))
        if command.kind is not CommandKind.INPUTS:  # an input may also have to be cleared on a running drive
            _check_drive_state(command, effect, conditions, inputs.evidence)
    if command.kind in _STATES_FOR_MOTION and not inputs.evidence.limits_checked:
        raise StartInhibited("drives.limits_unchecked")
    return Permit(
        station=inputs.station,
        effect=effect,
        retry_policy=inputs.retry_policy,
        expires_at=command.expires_at(effect),
        stop_epoch=conditions.stop_epoch,
        command_id=command.id,
    )


def state_inhibit(derived: DerivedState, kind: CommandKind) -> StartInhibited:
    """Return the error of a command that the state of the drive forbids; an unknown state is no report of the drive."""
    if derived.state is DriveState.UNKNOWN:
        return StartInhibited("drives.state_not_known", kind=kind, why=derived.unknown_reason)
    return StartInhibited("drives.state_forbids", state=derived.state, kind=kind)


def _check_valid(command: DriveCommand, effect: Effect, conditions: BusConditions) -> None:
    if conditions.stop_epoch != command.stop_epoch:
        raise Superseded("drives.superseded")
    expires_at = command.expires_at(effect)
    if conditions.now > expires_at:
        age, limit = conditions.now - command.created_at, expires_at - command.created_at
        raise Expired("drives.expired", age_s=round(age, 2), limit_s=round(limit, 2))


def _raise_first(errors: Iterator[StartInhibited]) -> None:
    for error in errors:
        raise error


def unmet_bus_permissives(station: int, conditions: BusConditions) -> Iterator[StartInhibited]:
    """Yield the bus permissives that no acting frame of this station meets now."""
    if conditions.start_inhibited:
        yield StartInhibited("drives.start_inhibited", station=station)
    if conditions.foreign_master:
        yield StartInhibited("drives.foreign_master", station=station)
    if conditions.duplicate_address:
        yield StartInhibited("drives.duplicate", station=station)


def unmet_start_permissives(conditions: BusConditions, family: str) -> Iterator[StartInhibited]:
    """Yield the further bus permissives that a start does not meet now."""
    limit = protocol_family(family).max_error_rate
    if conditions.damage_rate > limit and conditions.damaged >= MIN_DAMAGED_REPLIES:
        percent = round(conditions.damage_rate * 100, 2)
        yield StartInhibited("drives.high_error_rate", error_percent=percent, limit_percent=limit * 100)


def _check_drive_state(
    command: DriveCommand, effect: Effect, conditions: BusConditions, evidence: DriveEvidence
) -> None:
    """Check the state: a start begins at standstill or ends a pause, a setpoint that moves (DZB100) changes a run.

    A motor that turned when the command began was stopped or paused after it, which a start must not undo.
    """
    if not evidence.preflight_passed:
        raise StartInhibited("drives.preflight_not_done")
    if not evidence.reports_run_state:
        return
    if evidence.state_at is None or conditions.now - evidence.state_at > MAX_STATUS_AGE_S:
        age = None if evidence.state_at is None else round(conditions.now - evidence.state_at, 2)
        raise StartInhibited("drives.status_stale", age_s=age, limit_s=MAX_STATUS_AGE_S)
    if evidence.derived.state not in _STATES_FOR_MOTION[command.kind]:
        raise state_inhibit(evidence.derived, command.kind)
    if evidence.motion_seen and command.kind in (CommandKind.START, CommandKind.JOG):
        raise StartInhibited("drives.stopped_meanwhile", kind=command.kind)
    if evidence.run_seen and command.kind is CommandKind.RESUME:
        raise StartInhibited("drives.paused_meanwhile")
    if effect is Effect.MOTION and not evidence.is_prepared:
        raise StartInhibited("drives.not_prepared")
