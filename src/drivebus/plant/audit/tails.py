"""The end of a file that a writer may have left in the middle of a line, or a power cut with holes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from drivebus.plant import journal
from drivebus.plant.audit import seal


@dataclass(frozen=True, slots=True)
class Tail:
    """``rest``: the octets from ``ended`` on, which were never acknowledged."""

    path: Path
    ended: int
    rest: bytes


def unfinished(path: Path) -> Tail:
    """What follows the last line end. Raises OSError."""
    size, data = path.stat().st_size, journal.tail(path)
    return _cut(path, size, data, data.rfind(b"\n") + 1)


def tail_of(path: Path, safe: int) -> Tail:
    """What follows the last whole record, and from the first broken one on, but never at or before record ``safe``:
    a checkpoint tells that those were whole once, so that only somebody's hand can have broken them. Raises OSError.
    """
    size, data = path.stat().st_size, journal.tail(path)
    cut = end = data.rfind(b"\n") + 1
    while end > 0:
        start = data.rfind(b"\n", 0, end - 1) + 1
        if start == 0 and len(data) < size:  # the middle of a line
            break
        found = seal.record(data[start : end - 1])
        if found is None:
            cut = start
        elif found.n <= safe:
            break
        end = start
    return _cut(path, size, data, cut)


def _cut(path: Path, size: int, data: bytes, at: int) -> Tail:
    return Tail(path, size - len(data) + at, data[at:])
