"""PasswordHashing: policy for new ones, throttle of attempts, hashing. The only module that imports argon2."""

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
"""Different characters that a password needs besides common words, keyboard rows and digits."""
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
"""Neighbours of a keyboard row, in either direction, that count as common."""
_LEET_SPELLING = str.maketrans("@4$5031!", "aassoeii")
"""Substitutions such as p@ssw0rd for password."""


def _keyboard_runs(row: str) -> set[str]:
    return {
        direction[at : at + _KEYBOARD_RUN_LENGTH]
        for direction in (row, row[::-1])
        for at in range(len(row) - _KEYBOARD_RUN_LENGTH + 1)
    }


_COMMON_PARTS = frozenset(_COMMON_WORDS.split()).union(*map(_keyboard_runs, _KEYBOARD_ROWS))


def is_guessable(password: str) -> bool:
    """Return whether a password is made of common words, keyboard rows and digits, and few other characters."""
    folded = password.casefold()
    return any(_is_common(each) for each in (folded, folded.translate(_LEET_SPELLING)))


def _is_common(text: str) -> bool:
    found = ((match.start(), part) for part in _COMMON_PARTS for match in re.finditer(f"(?={re.escape(part)})", text))
    common = {at for start, part in found for at in range(start, start + len(part))}
    uncommon = {character for at, character in enumerate(text) if at not in common and not character.isdigit()}
    return (bool(common) or text.isdigit()) and len(uncommon) < MIN_UNCOMMON_CHARACTERS


THROTTLE_WINDOW_S = 900.0
FREE_ATTEMPTS = 10
"""Failed attempts within the window without a delay."""
MIN_LOGIN_DELAY_S = 2.0
"""First delay; it doubles with each further failure."""
MAX_LOGIN_DELAY_S = 120.0
"""Longest delay: fewer than 100 guesses an hour, and never a lock-out."""
MAX_THROTTLED_KEYS = 10_000
"""Users and addresses remembered; the least recently used is dropped first, so that memory stays bounded."""


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
    """Growing delay after failed attempts, per user and per address.

    An attempt counts as a failure until ``record_success``, so that concurrent attempts cannot get around the delay.
    """

    def __init__(self) -> None:
        self._attempts: OrderedDict[str, _Attempts] = OrderedDict()

    def wait_s(self, keys: tuple[str, ...], now: float) -> float:
        """Return the seconds until all of ``keys`` may try again; 0 or more."""
        return max((self._attempts[key].wait_s(now) for key in keys if key in self._attempts), default=0.0)

    def record_attempt(self, keys: tuple[str, ...], now: float) -> None:
        """Count an attempt. Call it before the password is checked."""
        for key in keys:
            self._attempts.setdefault(key, _Attempts()).times.append(now)
            self._attempts.move_to_end(key)
        while len(self._attempts) > MAX_THROTTLED_KEYS:
            self._attempts.popitem(last=False)

    def record_success(self, keys: tuple[str, ...], at: float) -> None:
        """Remove the successful attempt of time ``at``. Earlier failures stay: a known account must not reset them."""
        for key in keys:
            if key in self._attempts and at in self._attempts[key].times:
                self._attempts[key].times.remove(at)


T = TypeVar("T")

MIN_PASSWORD_LENGTH = 10
MAX_PASSWORD_LENGTH = 200
_MIN_DIFFERENT_CHARACTERS = 5
_MAX_WAITING_HASHES = 8
"""Hashes waiting for the thread; further ones are refused, so that a flood of logins cannot fill the memory."""


class PasswordHashing:
    """Hashing and verification on a thread of its own. ``hasher`` None: 64 MiB, 3 passes, one lane (RFC 9106, second
    recommended option), about 0.1 s.
    """

    def __init__(self, hasher: PasswordHasher | None = None) -> None:
        self._hasher = hasher or PasswordHasher(time_cost=3, memory_cost=65536, parallelism=1)
        self._thread = ThreadPoolExecutor(1, "password")
        self._unknown_user_hash = self._hasher.hash(secrets.token_urlsafe())
        self._waiting = 0

    async def hash(self, password: str) -> str:
        """Return the encoded hash of a password. Raises AuthUnavailable if too many hashes are waiting."""
        return await self._in_thread(self._hasher.hash, _normalized(password))

    async def verify(self, known: str | None, password: str) -> bool:
        """Return whether a password matches a hash. Raises AuthUnavailable if too many hashes are waiting.

        It takes as long for an unknown user (``known`` None) as for a wrong password.
        """
        matches = await self._in_thread(self._verify, known or self._unknown_user_hash, _normalized(password))
        return matches and known is not None

    def _verify(self, known: str, password: str) -> bool:
        try:
            return self._hasher.verify(known, password)
        except (Argon2Error, InvalidHashError):
            return False

    async def _in_thread(self, work: Callable[..., T], *arguments: str) -> T:
        if self._waiting >= _MAX_WAITING_HASHES:
            raise AuthUnavailable("auth.busy")
        self._waiting += 1
        try:
            return await asyncio.get_running_loop().run_in_executor(self._thread, work, *arguments)
        finally:
            self._waiting -= 1


def check_password_policy(password: str, name: str) -> str:
    """Return ``password`` if the user ``name`` may have it. Raises InvalidInput with the reason."""
    text = _normalized(password)
    if not MIN_PASSWORD_LENGTH <= len(text) <= MAX_PASSWORD_LENGTH:
        raise InvalidInput("auth.password_length", shortest=MIN_PASSWORD_LENGTH, longest=MAX_PASSWORD_LENGTH)
    if len(set(text)) < _MIN_DIFFERENT_CHARACTERS or is_guessable(text) or name.casefold() in text.casefold():
        raise InvalidInput("auth.password_common", different=_MIN_DIFFERENT_CHARACTERS, own=MIN_UNCOMMON_CHARACTERS)
    return password


def _normalized(password: str) -> str:
    return unicodedata.normalize("NFC", password)
