"""Verification of an audit trail: finds every edit, deletion, swap, insertion and cut, with file and line."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from drivebus.service.api.errors import localized
from drivebus.service.audit import records
from drivebus.service.audit.chain import AuditPaths, first_number_of
from drivebus.service.audit.records import AuditCheckpoint
from drivebus.service.storage.append_log import open_to_read
from drivebus.types import Json

MAX_REPORTED_PROBLEMS: Final = 200
"""All problems are counted; only this many are listed."""


@dataclass(frozen=True, slots=True)
class AuditProblem:
    """Deviation from what the writer wrote. ``line`` 0 stands for the whole file."""

    kind: str
    file: str
    line: int
    params: Mapping[str, Any] = field(default_factory=dict)

    def as_json(self) -> Json:
        details = {"file": self.file, "line": self.line, **self.params}
        return {"kind": self.kind, **details, "text": localized(f"audit.problem.{self.kind}", details)}


@dataclass(slots=True, kw_only=True)
class AuditReport:
    """Result of a verification."""

    entries: int = 0
    checkpoints: int = 0
    keyed: bool = False
    """Whether the key was there, so that forged checkpoints would have been detected."""
    covered: int = 0
    """Number of the last record that a checkpoint covers; later ones can be cut off undetected."""
    head: int | None = None
    """Number of the newest checkpoint according to the head. None: without it, removed checkpoints and the records
    after them are not detected.
    """
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
            "head": self.head,
            "found": self.problem_count,
            "problems": [problem.as_json() for problem in self.problems],
        }


def verify(paths: AuditPaths, at_least: int = 0) -> AuditReport:
    """Read and verify all files of a trail, which must have ``at_least`` this number of records.

    Raises OSError for an existing file that cannot be read.
    """
    report = AuditReport()
    try:
        key = paths.read_key()
    except OSError:
        key = None
    report.keyed = key is not None
    head = _head(paths, report, key)  # before the checkpoints: a running service writes it after them
    checkpoints = _checkpoints(paths, report, key)
    _ChainVerifier(paths, report, checkpoints, head).run(at_least)
    return report


class _ChainVerifier:
    """Walk along the chain of records from its beginning."""

    def __init__(
        self,
        paths: AuditPaths,
        report: AuditReport,
        checkpoints: list[AuditCheckpoint],
        head: AuditCheckpoint | None,
    ) -> None:
        self._paths, self._report, self._checkpoints = paths, report, checkpoints
        self._covering = [*checkpoints, head] if head else checkpoints
        self._expected_hashes: dict[int, set[str]] = {}
        for checkpoint in self._covering:
            self._expected_hashes.setdefault(checkpoint.n, set()).add(checkpoint.hash)
        self._last_number = 0
        self._last_hash: str | None = records.GENESIS_HASH
        """None after a broken line: the hash that must follow is unknown."""
        self._claimed_checkpoints = head.number if head else 0
        """Number of checkpoints that existed according to the head and the records."""

    def run(self, at_least: int) -> None:
        files = self._paths.files()
        if not files:
            self._report.add_problem("absent", self._paths.current, 0)
        for path in files:
            self._verify_file(path, whole=path != self._paths.current)
        end = files[-1] if files else self._paths.current
        newest = max((checkpoint.n for checkpoint in self._covering), default=0)
        if newest > self._last_number:
            self._report.add_problem("cut", end, 0, last=self._last_number, checkpoint=newest)
        if at_least > self._last_number:
            self._report.add_problem("fewer", end, 0, last=self._last_number, expected=at_least)
        if self._claimed_checkpoints > len(self._checkpoints):
            there, expected = len(self._checkpoints), self._claimed_checkpoints
            self._report.add_problem("checkpoints_missing", self._paths.checkpoints, 0, there=there, expected=expected)
        self._report.covered = max((checkpoint.n for checkpoint in self._checkpoints), default=0)

    def _verify_file(self, path: Path, *, whole: bool) -> None:
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
        record = records.decode_record(line)
        if record is None:
            self._report.add_problem("changed", path, number)
            self._last_number, self._last_hash = self._last_number + 1, None
            return
        if record.n != self._last_number + 1 or self._last_hash not in (None, record.prev):
            self._report.add_problem("broken", path, number, expected=self._last_number + 1, n=record.n)
        self._last_number, self._last_hash = record.n, record.hash
        self._claimed_checkpoints = max(self._claimed_checkpoints, record.checkpoints)
        if self._expected_hashes.get(record.n, {record.hash}) != {record.hash}:
            self._report.add_problem("rewritten", path, number, n=record.n)


def _head(paths: AuditPaths, report: AuditReport, key: bytes | None) -> AuditCheckpoint | None:
    """Return the newest checkpoint according to the head, and report a head that is none."""
    if not paths.head.exists():
        return None
    with open_to_read(paths.head) as file:
        head = records.decode_checkpoint(file.read().rstrip(b"\n"), key)
    if head is None:
        report.add_problem("head_changed", paths.head, 0)
    else:
        report.head = head.number
    return head


def _checkpoints(paths: AuditPaths, report: AuditReport, key: bytes | None) -> list[AuditCheckpoint]:
    """Return the valid checkpoints in order, and report the others."""
    checkpoints: list[AuditCheckpoint] = []
    mac, number, n = records.GENESIS_HASH, 0, 0
    path = paths.checkpoints
    for at, line in _lines(path) if path.exists() else ():
        checkpoint = records.decode_checkpoint(line[:-1], key) if line.endswith(b"\n") else None
        if checkpoint is None:
            report.add_problem("checkpoint_changed", path, at)
            number += 1
            continue
        if checkpoint.prev != mac or checkpoint.number != number + 1 or checkpoint.n <= n:
            report.add_problem("checkpoint_broken", path, at, expected=number + 1, number=checkpoint.number)
        mac, number, n = checkpoint.mac, checkpoint.number, checkpoint.n
        checkpoints.append(checkpoint)
    report.checkpoints = len(checkpoints)
    return checkpoints


def _lines(path: Path) -> Iterator[tuple[int, bytes]]:
    with open_to_read(path) as file:
        yield from enumerate(file, 1)
