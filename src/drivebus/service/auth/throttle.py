"""``LoginThrottle``: growing delay after failed attempts, per user, address, device or session. Pure."""

from __future__ import annotations

from collections import OrderedDict, deque
from contextlib import suppress
from dataclasses import dataclass, field
from heapq import nsmallest

from drivebus.service.auth.client_address import client_network, parse_address
from drivebus.service.auth.names import normalized_name
from drivebus.service.auth.sessions import secret_digest

THROTTLE_WINDOW_S = 900.0
FREE_ATTEMPTS = 10
"""Failed attempts within the window without a delay."""
MIN_LOGIN_DELAY_S = 2.0
"""First delay; it doubles with each further failure."""
MAX_LOGIN_DELAY_S = 120.0
"""Longest delay: fewer than 100 guesses an hour. ``AttemptKeys.repeated`` can double it."""
MAX_THROTTLED_KEYS = 30_000
"""Keys remembered: more than the attempts of one window can create, because each of them takes a hash of 0.1 s."""
_EVICTED_AT_ONCE = MAX_THROTTLED_KEYS // 20  # so that the search for them is rare


@dataclass(frozen=True, slots=True)
class AttemptKeys:
    """Keys under which one attempt is counted."""

    own: tuple[str, ...]
    """Their delays must have passed."""
    repeated: str = ""
    """User at an address. The more often it was tried within the window, the longer are the delays of ``own``, up to
    twice as long after ``FREE_ATTEMPTS``: so the address that asks most often does not get every turn.
    """

    @property
    def all(self) -> tuple[str, ...]:
        return (*self.own, self.repeated) if self.repeated else self.own


def unknown_browser_keys(name: str, address: str) -> AttemptKeys:
    """Return the keys of an attempt from a browser that is not known to have logged in as this user."""
    user, network = f"user:{secret_digest(normalized_name(name))}", address_key(address)
    return AttemptKeys((user, network), f"{user} {network}")


def address_key(address: str) -> str:
    """Return the key of an address, which is that of its network. A text that is no address has a key of its own."""
    with suppress(ValueError):
        address = client_network(parse_address(address))
    return f"address:{address}"


@dataclass(slots=True)
class _Attempts:
    times: deque[float] = field(default_factory=lambda: deque(maxlen=64))

    def remove_expired(self, now: float) -> None:
        while self.times and self.times[0] <= now - THROTTLE_WINDOW_S:
            self.times.popleft()

    def wait_s(self, now: float, factor: float) -> float:
        self.remove_expired(now)
        beyond = len(self.times) - FREE_ATTEMPTS
        if beyond < 0:
            return 0.0
        delay_s = min(MIN_LOGIN_DELAY_S * 2.0**beyond, MAX_LOGIN_DELAY_S)
        return max(0.0, self.times[-1] + factor * delay_s - now)


class LoginThrottle:
    """Growing delay after failed attempts of each key.

    An attempt counts as a failure until ``record_success``, so that concurrent attempts cannot get around the delay.
    """

    def __init__(self) -> None:
        self._attempts: OrderedDict[str, _Attempts] = OrderedDict()
        """The least recently tried key first."""

    def wait_s(self, keys: AttemptKeys, now: float) -> float:
        """Return the seconds until an attempt of ``keys`` is permitted; 0 or more."""
        known = [self._attempts[key] for key in keys.own if key in self._attempts]
        factor = 1.0
        if (repeated := self._attempts.get(keys.repeated)) is not None:
            repeated.remove_expired(now)
            factor += min(len(repeated.times) / FREE_ATTEMPTS, 1.0)
        return max((attempt.wait_s(now, factor) for attempt in known), default=0.0)

    def record_attempt(self, keys: AttemptKeys, now: float) -> None:
        """Count an attempt.

        Call it before the password is checked, and only if it will be checked: an attempt that costs the sender nothing
        must not push out the counts of others.
        """
        for key in keys.all:
            self._attempts.setdefault(key, _Attempts()).times.append(now)
            self._attempts.move_to_end(key)
        if len(self._attempts) > MAX_THROTTLED_KEYS:
            self._evict(now)

    def record_success(self, keys: AttemptKeys, at: float) -> None:
        """Remove the successful attempt of time ``at``. Earlier failures stay: a known account must not reset them."""
        for key in keys.all:
            if key in self._attempts and at in self._attempts[key].times:
                self._attempts[key].times.remove(at)

    def _evict(self, now: float) -> None:
        """Remove expired keys; if there are none, those with the fewest attempts."""
        for key, attempts in list(self._attempts.items()):
            attempts.remove_expired(now)
            if not attempts.times:
                del self._attempts[key]
        if len(self._attempts) > MAX_THROTTLED_KEYS:
            fewest = nsmallest(_EVICTED_AT_ONCE, self._attempts.items(), key=lambda item: len(item[1].times))
            for key, _ in fewest:
                del self._attempts[key]
