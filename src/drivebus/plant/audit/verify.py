"""Finds every edit, deletion, swap, insertion and cut of the trail, and names the file and the line."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from drivebus.plant.audit import seal
from drivebus.plant.audit.files import Places, first_of
from drivebus.plant.audit.seal import Checkpoint
from drivebus.plant.failure import both
from drivebus.plant.view import Json

MOST: Final = 200
"""Problems that are told one by one; all are counted."""


@dataclass(frozen=True, slots=True)
class Problem:
    """Something that its writer did not write. ``line`` 0: of the file as a whole."""

    kind: str
    file: str
    line: int
    params: Mapping[str, Any] = field(default_factory=dict)

    def as_json(self) -> Json:
        told = {"file": self.file, "line": self.line, **self.params}
        return {"kind": self.kind, **told, "text": both(f"audit.problem.{self.kind}", told)}


@dataclass(slots=True)
class Report:
    """What the files say about themselves."""

    entries: int = 0
    checkpoints: int = 0
    keyed: bool = False
    """The key was there: checkpoints that somebody else made would have been found."""
    covered: int = 0
    """Up to this record a checkpoint vouches; later ones could be cut off unseen."""
    found: int = 0
    problems: list[Problem] = field(default_factory=list)

    @property
    def ok(self) -> bool:
        return not self.found

    def problem(self, kind: str, path: Path, line: int, **params: Any) -> None:
        self.found += 1
        if len(self.problems) < MOST:
            self.problems.append(Problem(kind, path.name, line, params))

    def as_json(self) -> Json:
        return {
            "ok": self.ok, "entries": self.entries, "checkpoints": self.checkpoints, "keyed": self.keyed,
            "covered": self.covered, "found": self.found, "problems": [one.as_json() for one in self.problems],
        }  # fmt: skip


def verify(places: Places) -> Report:
    """Read everything. Raises OSError where a file is there and can't be read."""
    report = Report()
    marks = _checkpoints(places, report)
    _Walk(places, report, marks).go()
    return report


class _Walk:
    """Along the chain, from its first record on."""

    def __init__(self, places: Places, report: Report, marks: list[Checkpoint]) -> None:
        self._places, self._report, self._marks = places, report, marks
        self._wanted: dict[int, set[str]] = {}
        for mark in marks:
            self._wanted.setdefault(mark.n, set()).add(mark.hash)
        self._n = 0
        self._hash: str | None = seal.FIRST
        """None: the line before is spoilt, so that nobody can tell what must come next."""
        self._told = 0
        """So many checkpoints there must have been, as the records say."""

    def go(self) -> None:
        files = self._places.files()
        for path in files:
            self._file(path, whole=path != self._places.current)
        end = files[-1] if files else self._places.current
        beyond = [mark for mark in self._marks if mark.n > self._n]
        if beyond:
            self._report.problem("cut", end, 0, last=self._n, checkpoint=beyond[-1].n)
        if self._told > len(self._marks):
            there, expected = len(self._marks), self._told
            self._report.problem("marks_missing", self._places.checkpoints, 0, there=there, expected=expected)
        self._report.covered = max((mark.n for mark in self._marks), default=0)

    def _file(self, path: Path, whole: bool) -> None:
        first = first_of(path)
        if whole and first != self._n + 1:
            self._report.problem("name", path, 0, expected=self._n + 1)
        for number, line in _lines(path):
            if line.endswith(b"\n"):
                self._line(path, number, line[:-1])
            else:
                self._report.problem("unfinished", path, number, octets=len(line))

    def _line(self, path: Path, number: int, line: bytes) -> None:
        self._report.entries += 1
        found = seal.record(line)
        if found is None:
            self._report.problem("changed", path, number)
            self._n, self._hash = self._n + 1, None
            return
        if found.n != self._n + 1 or self._hash not in (None, found.prev):
            self._report.problem("broken", path, number, expected=self._n + 1, n=found.n)
        self._n, self._hash, self._told = found.n, found.hash, max(self._told, found.checkpoints)
        if self._wanted.get(found.n, {found.hash}) != {found.hash}:
            self._report.problem("rewritten", path, number, n=found.n)


def _checkpoints(places: Places, report: Report) -> list[Checkpoint]:
    """Those that can be trusted, in order."""
    try:
        key = places.read_key()
    except OSError:
        key = None
    report.keyed = key is not None
    found: list[Checkpoint] = []
    mac, number, n = seal.FIRST, 0, 0
    path = places.checkpoints
    for at, line in _lines(path) if path.exists() else ():
        mark = seal.checkpoint(line[:-1], key) if line.endswith(b"\n") else None
        if mark is None:
            report.problem("mark_changed", path, at)
            number += 1
            continue
        if mark.prev != mac or mark.number != number + 1 or mark.n <= n:
            report.problem("mark_broken", path, at, expected=number + 1, number=mark.number)
        mac, number, n = mark.mac, mark.number, mark.n
        found.append(mark)
    report.checkpoints = len(found)
    return found


def _lines(path: Path) -> Iterator[tuple[int, bytes]]:
    with path.open("rb") as file:
        yield from enumerate(file, 1)
