"""Inputs of the permissives: all combinations of what a drive and its bus may have shown.

Any combination may hold at any instant, which covers every order of readings and checks. The permit comes from the real
operation with the bus's own conditions.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

from drivebus.bus.core import BusCore
from drivebus.bus.messages import Permit
from drivebus.drives.context import Preflight, UnmetPrecondition
from drivebus.drives.operations.steps import BusConditions, run_pure
from drivebus.drives.permissives import CommandKind, DriveCommand
from drivebus.drives.runner import bus_conditions
from drivebus.drives.state import DerivedState, DriveState
from drivebus.errors import BusError, StartInhibited
from drivebus.values import Reading, Text
from verification.model_check.model_subject import FINE_STEP_S, OUR_ADDRESS, ModelSubject
from verification.model_check.permit_monitor import (
    DAMAGE_COUNT_MIN,
    DAMAGE_RATE_MAX,
    EVIDENCE_MAX_AGE_S,
    FAMILY_DAMAGE_RATE_MAX,
)
from verification.reference.effects import RequestEffect

NO_TEXT = Text("", "")
CHECK_RESULTS = {
    "passed": Preflight((), (), (), 0.0),
    "failed": Preflight((), (UnmetPrecondition("x", 1, (2,), NO_TEXT),), (), 0.0),
    "absent": None,
}
EVIDENCE_AGES_S = {
    "fresh": 0.0,
    "at the limit": EVIDENCE_MAX_AGE_S,
    "stale": EVIDENCE_MAX_AGE_S + FINE_STEP_S,
    "absent": None,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class PermissiveInputs:
    """Combination of inputs."""

    age: str = "fresh"
    state: DriveState = DriveState.STOPPED
    limits: bool = True
    preflight: str = "passed"
    foreign: bool | None = False
    """None: as the bus itself reports; ``duplicate`` alike."""
    duplicate: bool | None = False
    rate: float = 0.0
    damaged: int = 0


def all_permissives_met(subject: ModelSubject) -> PermissiveInputs:
    """Return the inputs with which every permissive is met."""
    runs = subject.kind in (CommandKind.SETPOINT, CommandKind.PAUSE, CommandKind.RAMP_HOLD)
    return PermissiveInputs(state=DriveState.RUNNING if runs else DriveState.STOPPED)


def input_combinations(subject: ModelSubject, *, small: bool) -> Iterator[PermissiveInputs]:
    """Yield all combinations; ``small``: one of those that are refused alike."""
    best = all_permissives_met(subject).state
    wrong = DriveState.STOPPED if best is DriveState.RUNNING else DriveState.RUNNING
    limit = FAMILY_DAMAGE_RATE_MAX.get(subject.model, DAMAGE_RATE_MAX)
    links = [(0.0, 0), (limit, 9), (limit * 1.5, DAMAGE_COUNT_MIN - 1), (limit * 1.5, DAMAGE_COUNT_MIN)]
    states, preflights = [best, wrong, DriveState.UNKNOWN], list(CHECK_RESULTS)
    if small:
        links, states, preflights = [links[0], links[3]], states[:2], ["passed", "absent"]
    flags = (False, True)
    for age, state, limits, preflight, foreign, duplicate, (rate, damaged) in product(
        EVIDENCE_AGES_S, states, flags, preflights, flags, flags, links
    ):
        yield PermissiveInputs(
            age=age,
            state=state,
            limits=limits,
            preflight=preflight,
            foreign=foreign,
            duplicate=duplicate,
            rate=rate,
            damaged=damaged,
        )


def missing_permissives(subject: ModelSubject, effect: RequestEffect, shown: PermissiveInputs) -> tuple[str, ...]:
    """Return the permissives that these inputs do not meet for a frame with this effect."""
    found: list[tuple[str, bool | None]] = [("no foreign master", shown.foreign), ("no duplicate", shown.duplicate)]
    if subject.kind not in (CommandKind.RESET, CommandKind.PAUSE):
        found.append(("limits checked", not shown.limits))
    if effect is RequestEffect.MOTION or subject.kind in (CommandKind.START, CommandKind.JOG):
        bad = (
            shown.rate > FAMILY_DAMAGE_RATE_MAX.get(subject.model, DAMAGE_RATE_MAX)
            and shown.damaged >= DAMAGE_COUNT_MIN
        )
        found += [("good link", bad), ("preflight passed", shown.preflight != "passed")]
        if subject.model != "df800":  # it reports no status: its preflight is all that it can tell
            old = shown.age in ("stale", "absent")
            found += [
                ("fresh status", old),
                ("state allows", not old and shown.state is not all_permissives_met(subject).state),
            ]
    return tuple(name for name, missing in found if missing)


class CoreBusView:
    """Bus as ``bus_conditions`` sees it."""

    def __init__(self, core: BusCore, now: float) -> None:
        self.core, self._now = core, now

    def now(self) -> float:
        return self._now

    def health(self, address: int) -> Any:
        found = self.core.health(address, self._now)
        return replace(found, error_rate=0.0, damaged=0, damage_rate=0.0)  # the combinations bring their own

    def contact_losses(self, address: int) -> int:
        return self.core.stations[address].contact_losses

    def stop_epoch(self, address: int) -> int:
        return self.core.stations[address].stop_epoch

    def start_inhibited(self, address: int) -> bool:
        return self.core.stations[address].start_inhibited


def bus_snapshot(core: BusCore, now: float) -> BusConditions:
    """Return the conditions of the bus, by the function that real drives use."""
    view: Any = CoreBusView(core, now)
    return bus_conditions(view, OUR_ADDRESS)


def request_permit(
    subject: ModelSubject, command: DriveCommand, place: int, bus_state: BusConditions, shown: PermissiveInputs
) -> Permit | None:
    """Return the permit of the real permissives; None where they refuse."""
    op, now = subject.op, bus_state.now
    op.derived, op.limits_checked = DerivedState(shown.state), shown.limits
    op.drive.preflight = CHECK_RESULTS[shown.preflight]
    op.reading_pairs.clear()
    age = EVIDENCE_AGES_S[shown.age]
    if age is not None:
        names = subject.dialect.state_names
        op.reading_pairs.add({n: Reading(value=1, source_time=now - (age if n == names[-1] else 0.0)) for n in names})
    conditions = replace(
        bus_state,
        foreign_master=bus_state.foreign_master if shown.foreign is None else shown.foreign,
        duplicate_address=bus_state.duplicate_address if shown.duplicate is None else shown.duplicate,
        damage_rate=shown.rate,
        damaged=shown.damaged,
    )
    try:
        return run_pure(op.request_permit(command, subject.frames[place]), lambda _: conditions)
    except (StartInhibited, BusError):
        return None
