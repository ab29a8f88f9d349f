"""``PasswordHashing``: argon2 hashes of passwords. The only module that imports argon2."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from argon2 import PasswordHasher
from argon2.exceptions import Argon2Error, InvalidHashError

from drivebus.service.auth.errors import AuthUnavailable
from drivebus.service.auth.password_policy import normalized_password

T = TypeVar("T")

_MAX_WAITING_HASHES = 8
"""Hashes waiting for a thread; further ones are refused, so that a flood of logins cannot fill the memory."""


class PasswordHashing:
    """Hashing and verification of passwords on two threads.

    One thread serves browsers and sessions that are known, so that a flood from unknown browsers never makes them wait.
    ``hasher`` None: argon2id with 64 MiB, 3 passes, one lane (RFC 9106, second recommended option), about 0.1 s.
    """

    def __init__(self, hasher: PasswordHasher | None = None) -> None:
        self._hasher = hasher or PasswordHasher(time_cost=3, memory_cost=65536, parallelism=1)
        self._threads = {known: ThreadPoolExecutor(1, "password") for known in (False, True)}
        self._waiting = {False: 0, True: 0}
        self._unknown_user_hash = self._hasher.hash(secrets.token_urlsafe())

    async def hash(self, password: str) -> str:
        """Return the encoded hash of a password. Raises AuthUnavailable if too many hashes are waiting."""
        return await self._in_thread(self._hasher.hash, normalized_password(password), is_known=True)

    def check_capacity(self, *, is_known: bool) -> None:
        """Check that the thread of known or of unknown browsers takes another hash. Raises AuthUnavailable."""
        if self._waiting[is_known] >= _MAX_WAITING_HASHES:
            raise AuthUnavailable("auth.busy")

    async def verify(self, encoded: str | None, password: str, *, is_known: bool = False) -> bool:
        """Return whether a password matches the hash ``encoded``, which is None for an unknown user.

        ``is_known``: it comes from a browser or session in which the user has logged in before. Raises AuthUnavailable
        if too many hashes are waiting.
        """
        # An unknown user takes as long as a wrong password: the time reveals no user names.
        arguments = (encoded or self._unknown_user_hash, normalized_password(password))
        matches = await self._in_thread(self._verify, *arguments, is_known=is_known)
        return matches and encoded is not None

    def _verify(self, stored_hash: str, password: str) -> bool:
        try:
            return self._hasher.verify(stored_hash, password)
        except (Argon2Error, InvalidHashError):
            return False

    async def _in_thread(self, work: Callable[..., T], *arguments: str, is_known: bool) -> T:
        self.check_capacity(is_known=is_known)
        self._waiting[is_known] += 1
        try:
            return await asyncio.get_running_loop().run_in_executor(self._threads[is_known], work, *arguments)
        finally:
            self._waiting[is_known] -= 1
