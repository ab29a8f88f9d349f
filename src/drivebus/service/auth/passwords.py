"""Passwords: hashed with argon2 in a thread of their own: the loop never waits for one. The one door to argon2."""

from __future__ import annotations

import asyncio
import secrets
import unicodedata
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from argon2 import PasswordHasher
from argon2.exceptions import Argon2Error, InvalidHashError

from drivebus.service.auth.errors import AuthUnavailable, InvalidInput
from drivebus.service.auth.guessable_passwords import MIN_UNCOMMON_CHARACTERS, is_guessable

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
