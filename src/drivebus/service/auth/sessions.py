"""Login sessions: in memory, found by the hash of a 256-bit secret that only the browser has.

The hashes are also saved, because a crash of the web process must not demand a password before a stop. Times are
monotonic seconds, so that a saved session is valid only until the machine restarts.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import logging
import os
import secrets
from collections.abc import Iterable
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from pydantic import FiniteFloat, TypeAdapter, ValidationError

from drivebus import i18n
from drivebus.atomic_write import atomic_write_private
from drivebus.errors import SystemReason
from drivebus.regular_file import read_regular_file
from drivebus.service.auth.users import User, content_problem

LOG = logging.getLogger("drivebus.service")
_BOOT_ID_FILE = Path("/proc/sys/kernel/random/boot_id")


@dataclass(slots=True, kw_only=True)
class SessionRecord:
    """Fields of a session in memory and on disk. Times are monotonic seconds."""

    id: str
    """Opaque and no secret: control leases belong to it, the audit trail names it."""
    csrf: str
    user: str
    stamp: str
    """``User.stamp`` at the login."""
    address: str
    opened: FiniteFloat
    active: FiniteFloat

    def fields(self) -> dict[str, Any]:
        """Return the common fields."""
        return {each.name: getattr(self, each.name) for each in fields(SessionRecord)}


@dataclass(slots=True, kw_only=True)
class StoredSession(SessionRecord):
    """Session as it is saved."""

    digest: str
    """Hash of its secret."""


@dataclass(frozen=True, slots=True)
class _SessionFile:
    boot: str
    sessions: tuple[StoredSession, ...]


_SESSION_FILE_ADAPTER = TypeAdapter(_SessionFile)


class SessionStore:
    """File ``sessions.json`` in the state directory (0600)."""

    def __init__(self, directory: Path) -> None:
        self.path = directory / "sessions.json"

    @property
    def exists(self) -> bool:
        """Whether the file exists: it is written only where there is a user."""
        return os.path.lexists(self.path)

    def read(self) -> tuple[StoredSession, ...]:
        """Return the sessions saved since the machine started; none, and a log line, if the file cannot be read."""
        try:
            content = read_regular_file(self.path)
            if not content:  # emptied by ``write``
                return ()
            stored = _SESSION_FILE_ADAPTER.validate_json(content)
        except FileNotFoundError:
            return ()
        except (OSError, ValidationError) as error:
            problem = SystemReason(error) if isinstance(error, OSError) else content_problem(error)
            LOG.error(i18n.preferred_text("log.sessions_unreadable", file=self.path, problem=problem))
            return ()
        return stored.sessions if stored.boot == _boot_id() != "" else ()

    def write(self, sessions: tuple[StoredSession, ...]) -> None:
        """Save sessions. A failed write is ignored: logging in and out must not depend on it.

        Then a file that still has an ended session is emptied, which needs no space: the next process would open that
        session again.
        """
        try:
            atomic_write_private(self.path, _SESSION_FILE_ADAPTER.dump_json(_SessionFile(_boot_id(), sessions)))
        except OSError:
            if {stored.digest for stored in self.read()} - {session.digest for session in sessions}:
                with contextlib.suppress(OSError):
                    os.truncate(self.path, 0)


def _boot_id() -> str:
    """Return the id of this boot; empty if unknown, and then no saved session is valid."""
    with contextlib.suppress(OSError):
        return _BOOT_ID_FILE.read_text().strip()
    return ""


SESSION_IDLE_TIMEOUT_S = 900.0
"""After this time without activity a session may only view and stop."""
SESSION_LIFETIME_S = 12 * 3600.0
"""A login lasts one shift."""
REPLACED_SECRET_LIFETIME_S = 10.0
"""For this time the secret that an unlocking has replaced may still view and stop: requests with it are under way."""
MAX_ENDED_SESSIONS = 1000  # whose reason is kept: a browser that was asleep asks for it later
MAX_SESSIONS_PER_USER = 20
"""A further login ends the user's least active session."""


@dataclass(slots=True, eq=False)
class Session(SessionRecord):
    """Session of one browser."""

    ended: asyncio.Event = field(default_factory=asyncio.Event)
    end_reason: str | None = None
    failed_logins: int = 0
    """Wrong passwords of its user between the login before and this one, which opened it."""

    def end(self, reason: str) -> None:
        """End the session; the first reason stays.

        Reasons: ``logout``, ``expired``, ``replaced``, and of an administrator ``removed``, ``disabled``, ``role``,
        ``password`` or ``ended``.
        """
        self.end_reason = self.end_reason or reason
        self.ended.set()

    def expire(self, now: float) -> None:
        """End the session if it is older than ``SESSION_LIFETIME_S``."""
        if now - self.opened >= SESSION_LIFETIME_S:
            self.end("expired")

    def is_idle(self, now: float) -> bool:
        return now - self.active >= SESSION_IDLE_TIMEOUT_S

    def record_activity(self, now: float) -> None:
        """Record activity of the user. An idle session stays idle until ``SessionTable.unlock``."""
        if not self.is_idle(now):
            self.active = now


class SessionTable:
    """All open sessions. Times are monotonic seconds."""

    def __init__(self) -> None:
        self._by_digest: dict[str, Session] = {}
        self._replaced: dict[str, tuple[Session, float]] = {}
        """Digest of a replaced secret: its session, and the time at which the secret ends."""
        self._ended: dict[str, str] = {}
        """Digest of an ended session's digest, which itself is removed: the reason; the oldest first, at most
        ``MAX_ENDED_SESSIONS``.
        """

    def open(self, user: User, address: str, now: float) -> tuple[str, Session]:
        """Open a session and return its secret, which is new for every login, and the session."""
        self._limit_sessions(user.name, now)
        secret = secrets.token_urlsafe(32)
        session = Session(
            id="s-" + secrets.token_hex(8),
            csrf=secrets.token_urlsafe(24),
            user=user.name,
            stamp=user.stamp,
            address=address,
            opened=now,
            active=now,
        )
        self._by_digest[secret_digest(secret)] = session
        return secret, session

    def unlock(self, session: Session, now: float) -> str:
        """Unlock an idle session after a password check and return its new secret.

        Its id and CSRF token stay: its control leases remain valid, and another tab of the browser can still stop. A
        request with the old secret, which may be a stop, can still be under way: see ``find_replaced``.
        """
        ends = now + REPLACED_SECRET_LIFETIME_S
        self._replaced = {key: replacement for key, replacement in self._replaced.items() if now < replacement[1]}
        self._replaced |= {key: (other, ends) for key, other in self._by_digest.items() if other is session}
        self._by_digest = {key: other for key, other in self._by_digest.items() if other is not session}
        secret = secrets.token_urlsafe(32)
        session.active = now
        self._by_digest[secret_digest(secret)] = session
        return secret

    def find(self, secret: str, now: float) -> Session | None:
        """Return the open session of a secret; None if there is none or it has ended."""
        session = self._by_digest.get(secret_digest(secret))
        if session is None:
            return None
        session.expire(now)
        if session.end_reason is not None:
            self._remove_ended()
            return None
        return session

    def end_reason(self, secret: str) -> str | None:
        """Return why the session of a secret has ended; None while it is open, and if it is not known (any more)."""
        self._remove_ended()
        return self._ended.get(secret_digest(secret_digest(secret)))

    def find_replaced(self, secret: str) -> tuple[Session, float] | None:
        """Return the session whose unlocking has replaced this secret, and the time at which the secret ends."""
        return self._replaced.get(secret_digest(secret))

    def stored(self) -> tuple[StoredSession, ...]:
        """Return the open sessions for ``SessionStore``."""
        return tuple(
            StoredSession(**session.fields(), digest=digest)
            for digest, session in self._by_digest.items()
            if session.end_reason is None
        )

    def restore(self, stored: Iterable[StoredSession]) -> None:
        """Add the saved sessions of an earlier process."""
        for record in stored:
            self._by_digest[record.digest] = Session(**record.fields())

    def open_sessions(self, user: str, now: float) -> list[Session]:
        """Return the open sessions of a user; those that are too old end."""
        for session in self._by_digest.values():
            session.expire(now)
        return self.of_user(user)

    def of_user(self, user: str) -> list[Session]:
        return [session for session in self._by_digest.values() if session.user == user and session.end_reason is None]

    def end_all(self, user: str, reason: str) -> int:
        """End every session of a user and return their number."""
        ended = self.of_user(user)
        for session in ended:
            session.end(reason)
        self._remove_ended()
        return len(ended)

    def _limit_sessions(self, user: str, now: float) -> None:
        by_activity = sorted(self.open_sessions(user, now), key=lambda session: session.active)
        for session in by_activity[: 1 - MAX_SESSIONS_PER_USER]:
            session.end("replaced")
        self._remove_ended()

    def _remove_ended(self) -> None:
        for digest, session in [*self._by_digest.items()]:
            if session.end_reason is not None:
                del self._by_digest[digest]
                self._ended[secret_digest(digest)] = session.end_reason
        for oldest in [*self._ended][:-MAX_ENDED_SESSIONS]:
            del self._ended[oldest]


def secret_digest(secret: str) -> str:
    """Return the SHA-256 of a secret. Secrets are at least 128 random bits, so that no slower hash is needed."""
    return hashlib.sha256(secret.encode("utf-8", "surrogatepass")).hexdigest()
