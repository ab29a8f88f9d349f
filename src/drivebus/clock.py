"""Clock and random source that pure code gets as arguments, and the one wall clock."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Protocol


def wall_clock() -> datetime:
    """Return the time in UTC by the system clock: for labels only, no wait depends on it."""
    return datetime.now(UTC)


def wall_ms() -> int:
    """Return the time in milliseconds since the Unix epoch by the system clock: for labels only."""
    return int(wall_clock().timestamp() * 1000)


class Clock(Protocol):
    """Monotonic seconds; never the wall clock."""

    def __call__(self) -> float: ...


class Rng(Protocol):
    """Random source with a seed (``random.Random`` fits)."""

    def random(self) -> float: ...
    def randrange(self, start: int, stop: int, /) -> int: ...
