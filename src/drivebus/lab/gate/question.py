"""Every question that the gate can be asked: all combinations of what a drive and its line may have shown.

The evidence has no history: any combination may stand at any instant, so that every order of reading, checking and
forgetting is covered. Asked is the real conversation (``Talk.permit``), with the bus's own surroundings.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

from drivebus.bus.core import BusCore
from drivebus.drives.gate import Command, Kind
from drivebus.drives.memory import Missing, Preflight
from drivebus.drives.shell import surroundings
from drivebus.drives.state import DriveState, Verdict
from drivebus.drives.talk import Surroundings, play
from drivebus.errors import BusError, GateError
from drivebus.lab.gate.bytes import Act
from drivebus.lab.gate.grid import JUST_S
from drivebus.lab.gate.monitor import FAMILY_RATE, FEWEST, FRESH_S, RATE
from drivebus.lab.gate.subject import OURS, Subject
from drivebus.message import Permit
from drivebus.profiles.model import Text
from drivebus.reading import Reading

NOWHERE = Text("", "")
PREFLIGHTS = {
    "passed": Preflight((), (), (), 0.0),
    "failed": Preflight((), (Missing("x", 1, (2,), NOWHERE),), (), 0.0),
    "absent": None,
}
AGES_S = {"fresh": 0.0, "at the limit": FRESH_S, "stale": FRESH_S + JUST_S, "absent": None}


@dataclass(frozen=True, slots=True)
class Shown:
    """One combination."""

    age: str = "fresh"
    state: DriveState = DriveState.STOPPED
    limits: bool = True
    preflight: str = "passed"
    foreign: bool | None = False
    """None: as the bus itself says; so the next."""
    duplicate: bool | None = False
    rate: float = 0.0
    damaged: int = 0


def good(subject: Subject) -> Shown:
    """Everything in order."""
    return Shown(state=DriveState.RUNNING if subject.kind is Kind.SETPOINT else DriveState.STOPPED)


def combinations(subject: Subject, small: bool) -> Iterator[Shown]:
    """All of them; ``small``: one representative for what is refused alike."""
    best = good(subject).state
    wrong = DriveState.STOPPED if best is DriveState.RUNNING else DriveState.RUNNING
    limit = FAMILY_RATE.get(subject.model, RATE)
    links = [(0.0, 0), (limit, 9), (limit * 1.5, FEWEST - 1), (limit * 1.5, FEWEST)]
    states, preflights = [best, wrong, DriveState.UNKNOWN], list(PREFLIGHTS)
    if small:
        links, states, preflights = [links[0], links[3]], states[:2], ["passed", "absent"]
    flags = (False, True)
    for age, state, limits, preflight, foreign, duplicate, (rate, damaged) in product(
        AGES_S, states, flags, preflights, flags, flags, links
    ):
        yield Shown(age, state, limits, preflight, foreign, duplicate, rate, damaged)


def lacks(subject: Subject, act: Act, shown: Shown) -> tuple[str, ...]:
    """What is missing in the evidence for this frame, by the rulings (4, 12; RELIABILITY 4 and 6.4)."""
    found: list[tuple[str, bool | None]] = [("no foreign master", shown.foreign), ("no duplicate", shown.duplicate)]
    if subject.kind is not Kind.RESET:
        found.append(("limits checked", not shown.limits))
    if act is Act.MOVES or subject.kind in (Kind.START, Kind.JOG):
        bad = shown.rate > FAMILY_RATE.get(subject.model, RATE) and shown.damaged >= FEWEST
        found += [("good link", bad), ("preflight passed", shown.preflight != "passed")]
        if subject.model != "df800":  # it reports no status: its preflight is all that it can tell (ruling 4)
            old = shown.age in ("stale", "absent")
            found += [("fresh status", old), ("state allows", not old and shown.state is not good(subject).state)]
    return tuple(name for name, missing in found if missing)


class View:
    """The bus as ``surroundings`` sees it."""

    def __init__(self, core: BusCore, now: float) -> None:
        self.core, self._now = core, now

    def now(self) -> float:
        return self._now

    def health(self, address: int) -> Any:
        found = self.core.health(address, self._now)
        return replace(found, error_rate=0.0, damaged=0, damage_rate=0.0)  # the combinations bring their own

    def generation(self, address: int) -> int:
        return self.core.stations[address].generation

    def latched(self, address: int) -> bool:
        return self.core.stations[address].latched


def around(core: BusCore, now: float) -> Surroundings:
    """What the bus knows now, by the function that real drives use."""
    view: Any = View(core, now)
    return surroundings(view, OURS)


def ask(subject: Subject, command: Command, place: int, seen: Surroundings, shown: Shown) -> Permit | None:
    """The real gate's answer."""
    talk, now = subject.talk, seen.now
    talk.verdict, talk.within_limits = Verdict(shown.state), shown.limits
    talk.memory.preflight = PREFLIGHTS[shown.preflight]
    talk.book.forget()
    age = AGES_S[shown.age]
    if age is not None:
        names = subject.dialect.state_names
        talk.book.note({n: Reading(1, source_time=now - (age if n == names[-1] else 0.0)) for n in names})
    world = replace(
        seen,
        foreign_master=seen.foreign_master if shown.foreign is None else shown.foreign,
        duplicate=seen.duplicate if shown.duplicate is None else shown.duplicate,
        error_rate=shown.rate,
        failures=shown.damaged,
    )
    try:
        return play(talk.permit(command, subject.frames[place]), lambda _: world)
    except (GateError, BusError):
        return None
