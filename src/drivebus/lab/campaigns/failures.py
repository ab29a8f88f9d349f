"""``failures`` (G12, G14): the n-th call fails, for n = 1, 2, … until a run comes through clean, seam by seam.

Seams: the port (open, write, delivery, close; all families), the store of counts (each call of the system to its
files; the program killed there; the power cut there), a capture, profiles, the catalogues of sentences, kernel timers,
and a bus's own clock that stands still. Each time a user's whole story is lived through the failure: no hang, no torn
file, no error that is not ours, stops go, and afterwards everything works again.

The budget is how many calls of each seam fail: where it has more, so many are drawn, and one error for each.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

from drivebus.lab.breaking import failing_files as files
from drivebus.lab.breaking.disk import Disk
from drivebus.lab.breaking.failing_port import PortStory
from drivebus.lab.breaking.failing_time import kernel_timers, still_clock
from drivebus.lab.breaking.faultyport import ways
from drivebus.lab.campaign import Campaign, Session
from drivebus.lab.kinds import KINDS, Kind

Way = TypeVar("Way")
Play = Callable[[Disk], None]


def _system(*names: str) -> tuple[dict[str, Any], ...]:
    return tuple({"error": OSError(code, os.strerror(code))} for code in (getattr(errno, name) for name in names))


KILL: dict[str, Any] = {"error": None}
SHORT: dict[str, Any] = {"error": None, "short": True}
STORE = (*_system("ENOSPC", "EIO", "EROFS", "EACCES"), KILL)
CAPTURE = (*_system("ENOSPC", "EIO"), KILL, SHORT)
READING = _system("EIO", "EACCES", "EMFILE")


def _calls(session: Session, seam: str, ways_of: Sequence[Sequence[Way]]) -> list[tuple[int, Way]]:
    """Which calls fail, and how: all in every way, or as many as the budget allows, each in one."""
    total, budget = len(ways_of), session.budget
    session.figures[seam] = {"calls": total, "failed": min(total, budget)}
    if total <= budget:
        return [(nth, way) for nth, found in enumerate(ways_of, 1) for way in found]
    chance = session.rng(seam)
    return [(nth, chance.choice(ways_of[nth - 1])) for nth in sorted(chance.sample(range(1, total + 1), budget))]


def ports(session: Session, kind: Kind) -> None:
    def story(nth: int = 0, error: str = "EIO", late: bool = False) -> PortStory:
        name = f"{kind.name}/{nth}/{error}" + ("/sent" if late else "")
        found = PortStory(session, kind, name)
        row.append(found.fails(nth, error, late))
        return found

    row: list[list[str]] = []
    story()
    for nth, (error, late) in _calls(session, f"port {kind.name}", [ways(call) for call in row[0]]):
        if not story(nth, error, late).port.failed:
            session.violation(f"{kind.name}: call {nth} of the port never came")
        session.did()
    if story(len(row[0]) + 1).port.failed:
        session.violation(f"{kind.name}: the run after the last call was not clean")


def disk(session: Session, seam: str, errors: Sequence[dict[str, Any]], play: Play, place: Path | None = None) -> None:
    """Files in ``place``, else in a new folder for each run."""

    def played(nth: int, **how: Any) -> Disk:
        with TemporaryDirectory() as folder:
            found = Disk(place or Path(folder), nth, **how)
            play(found)
        return found

    calls = played(0).calls
    for nth, how in _calls(session, seam, [errors] * calls):
        found = played(nth, **how)
        session.line(f"{seam} {nth} {how.get('error') or 'killed'}: {found.failed}")
        session.count(f"{seam}: {found.failed} failed")
        if not found.failed:
            session.violation(f"{seam}: call {nth} never came")
        session.did()
    if played(calls + 1, **errors[0]).failed:
        session.violation(f"{seam}: the run after the last call was not clean")


def counted(session: Session, seam: str, play: Callable[[Session, int], int]) -> None:
    """A seam that fails in one way only."""
    calls = play(session, 0)
    for nth, _ in _calls(session, seam, [(None,)] * calls):
        play(session, nth)
        session.line(f"{seam} {nth}")
        session.did()


def run(session: Session) -> None:
    """Every seam; two for the store, as a killed program and a cut power leave different files."""
    for kind in KINDS:
        ports(session, kind)
    clean: list[str] = []
    records: list[bytes] = []
    disk(session, "store", STORE, partial(files.store, session))
    disk(session, "store, power cut", (KILL,), partial(files.store, session, power=True))
    disk(session, "capture", CAPTURE, lambda one: files.capture(session, one, clean, records))
    disk(session, "profiles", READING, partial(files.profile, session), files.PROFILES)
    disk(session, "sentences", READING, partial(files.sentences, session), files.SENTENCES)
    counted(session, "kernel timers", kernel_timers)
    counted(session, "still clock", still_clock)


CAMPAIGN = Campaign("failures", "calls", ("G12", "G14", "I6", "I8", "I10"), 10_000, 8, run)
