"""How often a password may be tried: a growing delay per user and per address, never a lock-out (S05). Pure."""

from __future__ import annotations

from collections import OrderedDict, deque
from dataclasses import dataclass, field

WINDOW_S = 900.0
FREE = 10
"""So many failures in the window cost nothing (S05)."""
SHORTEST_S = 2.0
LONGEST_S = 120.0
"""With ten free ones, fewer than 100 guesses an hour get through, whatever is tried."""
KEYS = 10_000
"""So many users and addresses are remembered; the one that was heard of longest ago goes first."""


@dataclass(slots=True)
class _Tries:
    at: deque[float] = field(default_factory=lambda: deque(maxlen=64))

    def wait_s(self, now: float) -> float:
        while self.at and self.at[0] <= now - WINDOW_S:
            self.at.popleft()
        beyond = len(self.at) - FREE
        if beyond < 0:
            return 0.0
        return max(0.0, self.at[-1] + min(SHORTEST_S * 2.0**beyond, LONGEST_S) - now)


class Throttle:
    """Counts tries; every try counts as a failure until it is told that it was none."""

    def __init__(self) -> None:
        self._tries: OrderedDict[str, _Tries] = OrderedDict()

    def wait_s(self, keys: tuple[str, ...], now: float) -> float:
        """Seconds until any of ``keys`` may try again; 0 or more."""
        return max((self._tries[key].wait_s(now) for key in keys if key in self._tries), default=0.0)

    def tried(self, keys: tuple[str, ...], now: float) -> None:
        """Before the password is looked at, so that a hundred at once are a hundred."""
        for key in keys:
            self._tries.setdefault(key, _Tries()).at.append(now)
            self._tries.move_to_end(key)
        while len(self._tries) > KEYS:
            self._tries.popitem(last=False)

    def succeeded(self, keys: tuple[str, ...], at: float) -> None:
        """That try was right: it does not count. Earlier ones do, or a guesser could wipe them."""
        for key in keys:
            if key in self._tries and at in self._tries[key].at:
                self._tries[key].at.remove(at)
