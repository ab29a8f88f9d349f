"""The only code that grants a Permit: leave for one frame that is neither a read nor a stop. Pure; no stop comes here.

Every check has its sentence. The bus re-checks station, effect, expiry and generation when the first bit goes out.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from drivebus.drives.state import DriveState, Named, Verdict
from drivebus.drives.talk import Surroundings
from drivebus.errors import Expired, GateError, NotPermitted, Superseded
from drivebus.message import Effect, Permit, WriteClass


class Kind(Named):
    """What the user meant."""

    START = "start"
    JOG = "jog"
    SETPOINT = "setpoint"
    RESET = "reset"
    WRITE = "write"


EXPIRY_S = {Kind.START: 2.0, Kind.JOG: 2.0, Kind.SETPOINT: 5.0, Kind.RESET: 2.0, Kind.WRITE: 5.0}
"""Ruling 12; a fault reset is an edge that a person waits for, like a start."""

FRESH_S = 2.0
"""A status older than this is not "now" for a start: no older than the command itself may be (I1)."""

ERROR_RATE_LIMIT = {"dzb": 0.001}
"""RELIABILITY 4, link-quality gate: 0.1 % where nothing on the wire detects a flipped bit …"""
ERROR_RATE_DEFAULT = 0.01
"""… and 1 % elsewhere."""

FAILURES = 3
"""One or two failures are no rate: a single lost frame among a hundred would else forbid every start for 5 minutes."""


@dataclass(frozen=True, slots=True)
class Command:
    """One wish of a user, once. It can't be renewed: a later wish is another command."""

    id: str
    kind: Kind
    created_at: float
    generation: int

    def expires_at(self, effect: Effect) -> float:
        """A frame that moves is never older than a start may be (I1), whatever it was meant as."""
        limit = EXPIRY_S[self.kind]
        return self.created_at + (min(limit, EXPIRY_S[Kind.START]) if effect is Effect.MOTION else limit)


@dataclass(frozen=True, slots=True)
class Evidence:
    """What a drive's own reports allow. ``can_tell`` is False where the family has no run status (DF800, ruling 4)."""

    verdict: Verdict
    at: float | None
    can_tell: bool
    preflight_done: bool
    within_limits: bool


def grant(
    command: Command, station: int, effect: Effect, write_class: WriteClass, around: Surroundings, evidence: Evidence,
    family: str,
) -> Permit:  # fmt: skip
    """A permit for one frame. Raises GateError, Expired, Superseded or NotPermitted with the reason."""
    _alive(command, effect, around)
    if effect not in (Effect.SETTING, Effect.MOTION):
        raise NotPermitted("drives.no_permit_needed", effect=effect.value)
    if effect is Effect.MOTION and command.kind not in (Kind.START, Kind.JOG, Kind.SETPOINT):
        raise NotPermitted("drives.frame_would_move", kind=command.kind)
    _raise_first(against_anything(station, around))
    if command.kind in (Kind.START, Kind.JOG) or effect is Effect.MOTION:
        _raise_first(against_motion(around, family))
        _drive_is_ready(command, around, evidence)
    if command.kind in (Kind.START, Kind.JOG, Kind.SETPOINT) and not evidence.within_limits:
        raise GateError("drives.limits_unchecked")
    return Permit(station, effect, write_class, command.expires_at(effect), around.generation, command.id)


def _alive(command: Command, effect: Effect, around: Surroundings) -> None:
    if around.generation != command.generation:
        raise Superseded("drives.superseded")
    expires_at = command.expires_at(effect)
    if around.now > expires_at:
        age, limit = around.now - command.created_at, expires_at - command.created_at
        raise Expired("drives.expired", age_s=round(age, 2), limit_s=round(limit, 2))


def _raise_first(errors: Iterator[GateError]) -> None:
    for error in errors:
        raise error


def against_anything(station: int, around: Surroundings) -> Iterator[GateError]:
    """What the bus has against every frame that acts on this station."""
    if around.latched:
        yield GateError("drives.latched", station=station)
    if around.foreign_master:
        yield GateError("drives.foreign_master", station=station)
    if around.duplicate:
        yield GateError("drives.duplicate", station=station)


def against_motion(around: Surroundings, family: str) -> Iterator[GateError]:
    """What it has, besides, against a start."""
    limit = ERROR_RATE_LIMIT.get(family, ERROR_RATE_DEFAULT)
    if around.error_rate > limit and around.failures >= FAILURES:
        percent = round(around.error_rate * 100, 2)
        yield GateError("drives.bad_link", error_percent=percent, limit_percent=limit * 100)


def _drive_is_ready(command: Command, around: Surroundings, evidence: Evidence) -> None:
    if not evidence.preflight_done:
        raise GateError("drives.preflight_not_done")
    if not evidence.can_tell:
        return
    if evidence.at is None or around.now - evidence.at > FRESH_S:
        age = None if evidence.at is None else round(around.now - evidence.at, 2)
        raise GateError("drives.status_stale", age_s=age, limit_s=FRESH_S)
    if evidence.verdict.state not in _ready_states(command.kind):
        raise GateError("drives.state_forbids", state=evidence.verdict.state, kind=command.kind)


def _ready_states(kind: Kind) -> frozenset[DriveState]:
    """A start or jog begins at standstill; a setpoint that is a motion frame (DZB100) only changes a run."""
    return _CHANGES_A_RUN if kind is Kind.SETPOINT else _BEGINS


_BEGINS = frozenset({DriveState.STOPPED})
_CHANGES_A_RUN = frozenset({DriveState.RUNNING, DriveState.ACCELERATING, DriveState.DECELERATING})
