"""The end of a file that a writer may have left in the middle of a line, or a power cut with holes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from drivebus.service.audit import records
from drivebus.service.storage import append_log


@dataclass(frozen=True, slots=True)
class TornTail:
    """``rest``: the octets from ``ended`` on, which were never acknowledged."""

    path: Path
    valid_bytes: int
    torn: bytes


def unterminated_tail(path: Path) -> TornTail:
    """What follows the last line end. Raises OSError."""
    size, data = path.stat().st_size, append_log.read_tail(path)
    return _tail_from(path, size, data, data.rfind(b"\n") + 1)


def torn_tail(path: Path, safe: int) -> TornTail:
    """What follows the last whole record, and from the first broken one on, but never at or before record ``safe``:
    a checkpoint tells that those were whole once, so that only somebody's hand can have broken them. Raises OSError.
    """
    size, data = path.stat().st_size, append_log.read_tail(path)
    cut = end = data.rfind(b"\n") + 1
    while end > 0:
        start = data.rfind(b"\n", 0, end - 1) + 1
        if start == 0 and len(data) < size:  # the middle of a line
            break
        found = records.decode_record(data[start : end - 1])
        if found is None:
            cut = start
        elif found.n <= safe:
            break
        end = start
    return _tail_from(path, size, data, cut)


def _tail_from(path: Path, size: int, data: bytes, at: int) -> TornTail:
    return TornTail(path, size - len(data) + at, data[at:])
