"""Finds every edit, deletion, swap, insertion and cut of the trail, and names the file and the line."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from drivebus.service.api.errors import localized
from drivebus.service.audit import records
from drivebus.service.audit.chain import AuditPaths, first_number_of
from drivebus.service.audit.records import AuditCheckpoint
from drivebus.service.live.views import Json

MAX_REPORTED_PROBLEMS: Final = 200
"""Problems that are told one by one; all are counted."""


@dataclass(frozen=True, slots=True)
class AuditProblem:
    """Something that its writer did not write. ``line`` 0: of the file as a whole."""

    kind: str
    file: str
    line: int
    params: Mapping[str, Any] = field(default_factory=dict)

    def as_json(self) -> Json:
        told = {"file": self.file, "line": self.line, **self.params}
        return {"kind": self.kind, **told, "text": localized(f"audit.problem.{self.kind}", told)}


@dataclass(slots=True)
class AuditReport:
    """What the files say about themselves."""

    entries: int = 0
    checkpoints: int = 0
    keyed: bool = False
    """The key was there: checkpoints that somebody else made would have been found."""
    covered: int = 0
    """Up to this record a checkpoint vouches; later ones could be cut off unseen."""
    problem_count: int = 0
    problems: list[AuditProblem] = field(default_factory=list)

    @property
    def ok(self) -> bool:
        return not self.problem_count

    def add_problem(self, kind: str, path: Path, line: int, **params: Any) -> None:
        self.problem_count += 1
        if len(self.problems) < MAX_REPORTED_PROBLEMS:
            self.problems.append(AuditProblem(kind, path.name, line, params))

    def as_json(self) -> Json:
        return {
            "ok": self.ok,
            "entries": self.entries,
            "checkpoints": self.checkpoints,
            "keyed": self.keyed,
            "covered": self.covered,
            "found": self.problem_count,
            "problems": [one.as_json() for one in self.problems],
        }


def verify(places: AuditPaths) -> AuditReport:
    """Read everything. Raises OSError where a file is there and can't be read."""
    report = AuditReport()
    marks = _checkpoints(places, report)
    _ChainVerifier(places, report, marks).run()
    return report


class _ChainVerifier:
    """Along the chain, from its first record on."""

    def __init__(self, places: AuditPaths, report: AuditReport, marks: list[AuditCheckpoint]) -> None:
        self._paths, self._report, self._checkpoints = places, report, marks
        self._expected_hashes: dict[int, set[str]] = {}
        for mark in marks:
            self._expected_hashes.setdefault(mark.n, set()).add(mark.hash)
        self._last_number = 0
        self._last_hash: str | None = records.GENESIS_HASH
        """None: the line before is spoilt, so that nobody can tell what must come next."""
        self._claimed_checkpoints = 0
        """So many checkpoints there must have been, as the records say."""

    def run(self) -> None:
        files = self._paths.files()
        for path in files:
            self._verify_file(path, whole=path != self._paths.current)
        end = files[-1] if files else self._paths.current
        beyond = [mark for mark in self._checkpoints if mark.n > self._last_number]
        if beyond:
            self._report.add_problem("cut", end, 0, last=self._last_number, checkpoint=beyond[-1].n)
        if self._claimed_checkpoints > len(self._checkpoints):
            there, expected = len(self._checkpoints), self._claimed_checkpoints
            self._report.add_problem("marks_missing", self._paths.checkpoints, 0, there=there, expected=expected)
        self._report.covered = max((mark.n for mark in self._checkpoints), default=0)

    def _verify_file(self, path: Path, whole: bool) -> None:
        first = first_number_of(path)
        if whole and first != self._last_number + 1:
            self._report.add_problem("name", path, 0, expected=self._last_number + 1)
        for number, line in _lines(path):
            if line.endswith(b"\n"):
                self._verify_line(path, number, line[:-1])
            else:
                self._report.add_problem("unfinished", path, number, octets=len(line))

    def _verify_line(self, path: Path, number: int, line: bytes) -> None:
        self._report.entries += 1
        found = records.decode_record(line)
        if found is None:
            self._report.add_problem("changed", path, number)
            self._last_number, self._last_hash = self._last_number + 1, None
            return
        if found.n != self._last_number + 1 or self._last_hash not in (None, found.prev):
            self._report.add_problem("broken", path, number, expected=self._last_number + 1, n=found.n)
        self._last_number, self._last_hash, self._claimed_checkpoints = (
            found.n,
            found.hash,
            max(self._claimed_checkpoints, found.checkpoints),
        )
        if self._expected_hashes.get(found.n, {found.hash}) != {found.hash}:
            self._report.add_problem("rewritten", path, number, n=found.n)


def _checkpoints(places: AuditPaths, report: AuditReport) -> list[AuditCheckpoint]:
    """Those that can be trusted, in order."""
    try:
        key = places.read_key()
    except OSError:
        key = None
    report.keyed = key is not None
    found: list[AuditCheckpoint] = []
    mac, number, n = records.GENESIS_HASH, 0, 0
    path = places.checkpoints
    for at, line in _lines(path) if path.exists() else ():
        mark = records.decode_checkpoint(line[:-1], key) if line.endswith(b"\n") else None
        if mark is None:
            report.add_problem("mark_changed", path, at)
            number += 1
            continue
        if mark.prev != mac or mark.number != number + 1 or mark.n <= n:
            report.add_problem("mark_broken", path, at, expected=number + 1, number=mark.number)
        mac, number, n = mark.mac, mark.number, mark.n
        found.append(mark)
    report.checkpoints = len(found)
    return found


def _lines(path: Path) -> Iterator[tuple[int, bytes]]:
    with path.open("rb") as file:
        yield from enumerate(file, 1)
