"""UTC labels of monotonic times."""

from __future__ import annotations

from collections.abc import Callable
from typing import overload

MAX_CLOCK_ERROR_MS = 1000  # a wall clock that was set by more moves the labels too


class UtcClock:
    """Monotonic time and its UTC milliseconds.

    All labels have one base, so that their differences are exact ages: the wall clock at the start and the monotonic
    time since. ``follow_wall_clock`` moves the base when the wall clock was set.
    """

    def __init__(self, now: Callable[[], float], wall_ms: Callable[[], int]) -> None:
        self.now, self._wall_ms = now, wall_ms
        self._base_ms = wall_ms() - now() * 1000

    @overload
    def utc_ms(self, at: float) -> int: ...
    @overload
    def utc_ms(self, at: None) -> None: ...
    def utc_ms(self, at: float | None) -> int | None:
        """Return the label of a monotonic second."""
        return None if at is None else round(self._base_ms + at * 1000)

    def now_ms(self) -> int:
        """Return the label of this moment."""
        return self.utc_ms(self.now())

    def follow_wall_clock(self) -> None:
        """Take over a wall clock that was set."""
        base_ms = self._wall_ms() - self.now() * 1000
        if abs(base_ms - self._base_ms) > MAX_CLOCK_ERROR_MS:
            self._base_ms = base_ms
