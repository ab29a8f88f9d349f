"""What the outside world is to pure code: a clock, chance and a store, as Protocols; and the one wall clock."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from typing import Protocol


def wall_clock() -> datetime:
    """This moment in UTC, by the clock that people and servers set: for labels only, nothing waits by it (F21)."""
    return datetime.now(UTC)


def wall_ms() -> int:
    """The same in UTC milliseconds."""
    return int(wall_clock().timestamp() * 1000)


class Clock(Protocol):
    """Monotonic seconds; never the wall clock (F21)."""

    def __call__(self) -> float: ...


class Rng(Protocol):
    """Chance with a seed (``random.Random`` fits)."""

    def random(self) -> float: ...
    def randrange(self, start: int, stop: int, /) -> int: ...


class Store(Protocol):
    """A small persistent mapping (EEPROM wear, proofs); writes are durable when ``put`` and ``update`` return."""

    def get(self, key: str) -> str | None:
        """The value of a key, None where it has none."""
        ...

    def put(self, key: str, value: str) -> None:
        """Keep a value under a key."""
        ...

    def update(self, key: str, change: Callable[[str | None], str]) -> None:
        """Put what ``change`` makes of the value, with no other writer in between; where it raises, put nothing."""
        ...
