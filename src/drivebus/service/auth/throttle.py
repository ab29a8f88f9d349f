"""How often a password may be tried: a growing delay per user and per address, never a lock-out (S05). Pure."""

from __future__ import annotations

from collections import OrderedDict, deque
from dataclasses import dataclass, field

THROTTLE_WINDOW_S = 900.0
FREE_ATTEMPTS = 10
"""So many failures in the window cost nothing (S05)."""
MIN_LOGIN_DELAY_S = 2.0
MAX_LOGIN_DELAY_S = 120.0
"""With ten free ones, fewer than 100 guesses an hour get through, whatever is tried."""
MAX_THROTTLED_KEYS = 10_000
"""So many users and addresses are remembered; the one that was heard of longest ago goes first."""


@dataclass(slots=True)
class _Attempts:
    times: deque[float] = field(default_factory=lambda: deque(maxlen=64))

    def wait_s(self, now: float) -> float:
        while self.times and self.times[0] <= now - THROTTLE_WINDOW_S:
            self.times.popleft()
        beyond = len(self.times) - FREE_ATTEMPTS
        if beyond < 0:
            return 0.0
        return max(0.0, self.times[-1] + min(MIN_LOGIN_DELAY_S * 2.0**beyond, MAX_LOGIN_DELAY_S) - now)


class LoginThrottle:
    """Counts tries; every try counts as a failure until it is told that it was none."""

    def __init__(self) -> None:
        self._attempts: OrderedDict[str, _Attempts] = OrderedDict()

    def wait_s(self, keys: tuple[str, ...], now: float) -> float:
        """Seconds until any of ``keys`` may try again; 0 or more."""
        return max((self._attempts[key].wait_s(now) for key in keys if key in self._attempts), default=0.0)

    def record_attempt(self, keys: tuple[str, ...], now: float) -> None:
        """Before the password is looked at, so that a hundred at once are a hundred."""
        for key in keys:
            self._attempts.setdefault(key, _Attempts()).times.append(now)
            self._attempts.move_to_end(key)
        while len(self._attempts) > MAX_THROTTLED_KEYS:
            self._attempts.popitem(last=False)

    def record_success(self, keys: tuple[str, ...], at: float) -> None:
        """That try was right: it does not count. Earlier ones do, or a guesser could wipe them."""
        for key in keys:
            if key in self._attempts and at in self._attempts[key].times:
                self._attempts[key].times.remove(at)
