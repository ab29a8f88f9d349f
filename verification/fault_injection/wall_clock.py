"""A wall clock that jumps, in the place of the system's; and who in the product reads any wall clock at all."""

from __future__ import annotations

import ast
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from drivebus import clock as seams

YEAR_S = 365.2425 * 86400
CLOCK_JUMPS_S = {
    "+1 s": 1.0,
    "-1 s": -1.0,
    "+1 h": 3600.0,
    "-1 h": -3600.0,
    "+10 y": 10 * YEAR_S,
    "-10 y": -10 * YEAR_S,
    "summer time begins": 0.0,
    "summer time ends": 0.0,
}
"""By how much each jump moves UTC; summer time moves the local hour alone."""
TIME_ZONES = {"summer time begins": "CEST-2", "summer time ends": "CET-1"}
WALL_CLOCK_FUNCTIONS = {
    "time.time",
    "time.time_ns",
    "time.localtime",
    "time.gmtime",
    "time.ctime",
    "time.asctime",
    "time.strftime",
    "time.CLOCK_REALTIME",
    "datetime.now",
    "datetime.utcnow",
    "datetime.today",
    "date.today",
}
"""What reads a wall clock in Python, by its last two names."""


class JumpingWallClock:
    """Goes on with ``passed`` seconds from ``begin`` (UTC), and jumps when told to."""

    def __init__(self, begin: datetime, passed: Callable[[], float]) -> None:
        self._begin, self._monotonic, self._offset = begin, passed, timedelta()

    def now(self) -> datetime:
        return self._begin + self._offset + timedelta(seconds=self._monotonic())

    def jump(self, name: str) -> None:
        """One of CLOCK_JUMPS_S."""
        self._offset += timedelta(seconds=CLOCK_JUMPS_S[name])
        if name in TIME_ZONES:
            _set_zone(TIME_ZONES[name])


def before_midnight(seconds: float) -> datetime:
    """So long before a midnight of UTC, where each jump may be one to another day."""
    return datetime(2026, 3, 29, tzinfo=UTC) - timedelta(seconds=seconds)


@contextmanager
def installed_clock(clock: JumpingWallClock) -> Iterator[JumpingWallClock]:
    """While this lasts, this is what the product's one door, and ``time`` itself, say."""
    doors: dict[tuple[Any, str], Callable[[], Any]] = {
        (seams, "wall_clock"): clock.now,
        (time, "time"): lambda: clock.now().timestamp(),
        (time, "time_ns"): lambda: int(clock.now().timestamp() * 1e9),
    }
    before = {door: getattr(*door) for door in doors}
    zone = os.environ.get("TZ")
    _replace_functions(doors)
    _set_zone(TIME_ZONES["summer time ends"])
    try:
        yield clock
    finally:
        _replace_functions(before)
        _set_zone(zone)


def _replace_functions(doors: dict[tuple[Any, str], Callable[[], Any]]) -> None:
    for (module, name), function in doors.items():
        setattr(module, name, function)


def _set_zone(name: str | None) -> None:
    if name is None:
        os.environ.pop("TZ", None)
    else:
        os.environ["TZ"] = name
    if hasattr(time, "tzset"):  # Windows has none
        time.tzset()


def clock_readers(package: Path) -> set[tuple[str, str]]:
    """(file, name) of all that reads a wall clock in the sources of a package."""
    files = {path.relative_to(package): path for path in package.rglob("*.py")}
    return {
        (name.as_posix(), read)
        for name, path in files.items()
        for read in _clock_reads(ast.parse(path.read_text(encoding="utf-8")))
    }


def _clock_reads(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            found = [".".join(ast.unparse(node).split(".")[-2:])]
        elif isinstance(node, ast.ImportFrom) and node.module == "time":
            found = [f"time.{alias.name}" for alias in node.names]
        else:
            continue
        yield from (name for name in found if name in WALL_CLOCK_FUNCTIONS)
