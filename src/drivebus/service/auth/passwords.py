"""Passwords that somebody who knows no secret tries first: common words, rows of a keyboard, digits. Pure.

How often a password may be tried: a growing delay per user and per address, never a lock-out (S05). Pure.

Passwords: hashed with argon2 in a thread of their own: the loop never waits for one. The one door to argon2.
"""

from __future__ import annotations

import asyncio
import re
import secrets
import unicodedata
from collections import OrderedDict, deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import TypeVar

from argon2 import PasswordHasher
from argon2.exceptions import Argon2Error, InvalidHashError

from drivebus.service.auth.errors import AuthUnavailable, InvalidInput

MIN_UNCOMMON_CHARACTERS = 4
"""So many different characters must be left besides what is common."""
_COMMON_WORDS = """
password passwort passwd pass login secret default changeme letmein welcome hello iloveyou woaini wodemima mima
admin administrator root user guest test master super operator engineer viewer service company office factory
drive drivebus inverter motor pump plant dragon monkey football sunshine princess summer winter spring autumn
"""
_KEYBOARD_ROWS = (
    "abcdefghijklmnopqrstuvwxyz",
    "01234567890",
    "qwertyuiop",
    "asdfghjkl",
    "zxcvbnm",
    "1q2w3e4r5t6y7u8i9o0p",
    "1qaz2wsx3edc4rfv5tgb6yhn7ujm",
)
_KEYBOARD_RUN_LENGTH = 3
"""So many neighbours of a row, either way, are one."""
_LEET_SPELLING = str.maketrans("@4$5031!", "aassoeii")
"""p@ssw0rd is password."""


def _keyboard_runs(row: str) -> set[str]:
    return {
        way[at : at + _KEYBOARD_RUN_LENGTH]
        for way in (row, row[::-1])
        for at in range(len(row) - _KEYBOARD_RUN_LENGTH + 1)
    }


_COMMON_PARTS = frozenset(_COMMON_WORDS.split()).union(*map(_keyboard_runs, _KEYBOARD_ROWS))


def is_guessable(password: str) -> bool:
    """Is it nothing but common words, rows and digits, p@ssw0rd too, and a few characters more?"""
    folded = password.casefold()
    return any(_is_common(each) for each in (folded, folded.translate(_LEET_SPELLING)))


def _is_common(said: str) -> bool:
    found = ((match.start(), part) for part in _COMMON_PARTS for match in re.finditer(f"(?={re.escape(part)})", said))
    known = {at for start, part in found for at in range(start, start + len(part))}
    own = {character for at, character in enumerate(said) if at not in known and not character.isdigit()}
    return (bool(known) or said.isdigit()) and len(own) < MIN_UNCOMMON_CHARACTERS


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


T = TypeVar("T")

MIN_PASSWORD_LENGTH = 10
MAX_PASSWORD_LENGTH = 200
_MIN_DIFFERENT_CHARACTERS = 5
_MAX_WAITING_HASHES = 8
"""So many may wait for the thread; more are sent away, or a flood of logins would fill the memory (S14)."""


class Passwords:
    """Makes and checks hashes. ``hasher`` None: 64 MiB, 3 passes, one lane (RFC 9106, second choice), about 0.1 s."""

    def __init__(self, hasher: PasswordHasher | None = None) -> None:
        self._hasher = hasher or PasswordHasher(time_cost=3, memory_cost=65536, parallelism=1)
        self._thread = ThreadPoolExecutor(1, "password")
        self._unknown_user_hash = self._hasher.hash(secrets.token_urlsafe())
        self._waiting = 0

    async def hash(self, password: str) -> str:
        """Raises Unavailable where too many wait."""
        return await self._in_thread(self._hasher.hash, _normalized(password))

    async def verify(self, known: str | None, password: str) -> bool:
        """As slow for a user that does not exist (``known`` None) as for a wrong password. Raises Unavailable."""
        right = await self._in_thread(self._verify, known or self._unknown_user_hash, _normalized(password))
        return right and known is not None

    def _verify(self, known: str, password: str) -> bool:
        try:
            return self._hasher.verify(known, password)
        except (Argon2Error, InvalidHashError):
            return False

    async def _in_thread(self, work: Callable[..., T], *arguments: str) -> T:
        if self._waiting >= _MAX_WAITING_HASHES:
            raise AuthUnavailable("access.busy")
        self._waiting += 1
        try:
            return await asyncio.get_running_loop().run_in_executor(self._thread, work, *arguments)
        finally:
            self._waiting -= 1


def check_password_policy(password: str, name: str) -> str:
    """Is this fit to be the password of ``name``? Raises Unfit with the reason."""
    said = _normalized(password)
    if not MIN_PASSWORD_LENGTH <= len(said) <= MAX_PASSWORD_LENGTH:
        raise InvalidInput("access.password_length", shortest=MIN_PASSWORD_LENGTH, longest=MAX_PASSWORD_LENGTH)
    if len(set(said)) < _MIN_DIFFERENT_CHARACTERS or is_guessable(said) or name.casefold() in said.casefold():
        raise InvalidInput("access.password_common", different=_MIN_DIFFERENT_CHARACTERS, own=MIN_UNCOMMON_CHARACTERS)
    return password


def _normalized(password: str) -> str:
    return unicodedata.normalize("NFC", password)
