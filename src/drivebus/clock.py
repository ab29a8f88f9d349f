"""Clock and random source that pure code gets as arguments, the one wall clock and the one unseeded random number."""

from __future__ import annotations

import secrets
from datetime import UTC, datetime
from typing import Protocol

MAX_TIME_MS = 253_402_300_799_999  # the end of the year 9999 in milliseconds since 1970


def wall_clock() -> datetime:
    """Return the time in UTC by the system clock: for labels only, no wait depends on it."""
    return datetime.now(UTC)


def wall_ms() -> int:
    """Return the time in milliseconds since the Unix epoch by the system clock: for labels only."""
    return int(wall_clock().timestamp() * 1000)


def random_word() -> int:
    """Return a random 16-bit number of the operating system, which no process can repeat on purpose."""
    return secrets.randbelow(0x10000)


class Clock(Protocol):
    """Monotonic seconds; never the wall clock."""

    def __call__(self) -> float: ...


class Rng(Protocol):
    """Random source with a seed (``random.Random`` fits)."""

    def random(self) -> float: ...
    def randrange(self, start: int, stop: int, /) -> int: ...
