"""The only code that grants a Permit: leave for one frame that is neither a read nor a stop. Pure; no stop comes here.

Every check has its sentence. The bus re-checks station, effect, expiry and generation when the first bit goes out.
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
    """What the user meant."""

    START = "start"
    JOG = "jog"
    SETPOINT = "setpoint"
    RESET = "reset"
    WRITE = "write"


COMMAND_TTL_S = {
    CommandKind.START: 2.0,
    CommandKind.JOG: 2.0,
    CommandKind.SETPOINT: 5.0,
    CommandKind.RESET: 2.0,
    CommandKind.WRITE: 5.0,
}
"""Ruling 12; a fault reset is an edge that a person waits for, like a start."""

MAX_STATUS_AGE_S = 2.0
"""A status older than this is not "now" for a start: no older than the command itself may be (I1)."""

MIN_FAILURES_FOR_ERROR_RATE = 3
"""One or two failures are no rate: a single lost frame among a hundred would else forbid every start for 5 minutes."""


@dataclass(frozen=True, slots=True)
class DriveCommand:
    """One wish of a user, once. It can't be renewed: a later wish is another command."""

    id: str
    kind: CommandKind
    created_at: float
    stop_epoch: int

    def expires_at(self, effect: Effect) -> float:
        """A frame that moves is never older than a start may be (I1), whatever it was meant as."""
        limit = COMMAND_TTL_S[self.kind]
        return self.created_at + (min(limit, COMMAND_TTL_S[CommandKind.START]) if effect is Effect.MOTION else limit)


@dataclass(frozen=True, slots=True)
class PermitInputs:
    """What a drive's own reports allow. ``can_tell`` is False where the family has no run status (DF800, ruling 4)."""

    derived: DerivedState
    state_at: float | None
    reports_run_state: bool
    preflight_passed: bool
    limits_checked: bool


def grant_permit(
    command: DriveCommand,
    station: int,
    effect: Effect,
    write_class: RetryPolicy,
    around: BusConditions,
    evidence: PermitInputs,
    family: str,
) -> Permit:
    """A permit for one frame. Raises StartInhibited, Expired, Superseded or NotPermitted with the reason."""
    _check_valid(command, effect, around)
    if effect not in (Effect.SETTING, Effect.MOTION):
        raise NotPermitted("drives.no_permit_needed", effect=effect.value)
    if effect is Effect.MOTION and command.kind not in (CommandKind.START, CommandKind.JOG, CommandKind.SETPOINT):
        raise NotPermitted("drives.frame_would_move", kind=command.kind)
    _raise_first(unmet_bus_permissives(station, around))
    if command.kind in (CommandKind.START, CommandKind.JOG) or effect is Effect.MOTION:
        _raise_first(unmet_start_permissives(around, family))
        _check_drive_state(command, around, evidence)
    if command.kind in (CommandKind.START, CommandKind.JOG, CommandKind.SETPOINT) and not evidence.limits_checked:
        raise StartInhibited("drives.limits_unchecked")
    return Permit(
        station=station,
        effect=effect,
        retry_policy=write_class,
        expires_at=command.expires_at(effect),
        stop_epoch=around.stop_epoch,
        command_id=command.id,
    )


def _check_valid(command: DriveCommand, effect: Effect, around: BusConditions) -> None:
    if around.stop_epoch != command.stop_epoch:
        raise Superseded("drives.superseded")
    expires_at = command.expires_at(effect)
    if around.now > expires_at:
        age, limit = around.now - command.created_at, expires_at - command.created_at
        raise Expired("drives.expired", age_s=round(age, 2), limit_s=round(limit, 2))


def _raise_first(errors: Iterator[StartInhibited]) -> None:
    for error in errors:
        raise error


def unmet_bus_permissives(station: int, around: BusConditions) -> Iterator[StartInhibited]:
    """What the bus has against every frame that acts on this station."""
    if around.start_inhibited:
        yield StartInhibited("drives.latched", station=station)
    if around.foreign_master:
        yield StartInhibited("drives.foreign_master", station=station)
    if around.duplicate:
        yield StartInhibited("drives.duplicate", station=station)


def unmet_start_permissives(around: BusConditions, family: str) -> Iterator[StartInhibited]:
    """What it has, besides, against a start."""
    limit = protocol_family(family).max_error_rate
    if around.error_rate > limit and around.failures >= MIN_FAILURES_FOR_ERROR_RATE:
        percent = round(around.error_rate * 100, 2)
        yield StartInhibited("drives.bad_link", error_percent=percent, limit_percent=limit * 100)


def _check_drive_state(command: DriveCommand, around: BusConditions, evidence: PermitInputs) -> None:
    if not evidence.preflight_passed:
        raise StartInhibited("drives.preflight_not_done")
    if not evidence.reports_run_state:
        return
    if evidence.state_at is None or around.now - evidence.state_at > MAX_STATUS_AGE_S:
        age = None if evidence.state_at is None else round(around.now - evidence.state_at, 2)
        raise StartInhibited("drives.status_stale", age_s=age, limit_s=MAX_STATUS_AGE_S)
    if evidence.derived.state not in _allowed_states(command.kind):
        raise StartInhibited("drives.state_forbids", state=evidence.derived.state, kind=command.kind)


def _allowed_states(kind: CommandKind) -> frozenset[DriveState]:
    """A start or jog begins at standstill; a setpoint that is a motion frame (DZB100) only changes a run."""
    return _SETPOINT_STATES if kind is CommandKind.SETPOINT else _START_STATES


_START_STATES = frozenset({DriveState.STOPPED})
_SETPOINT_STATES = frozenset({DriveState.RUNNING, DriveState.ACCELERATING, DriveState.DECELERATING})
