"""Sessions outlive the web process: a crash of it must not put a password between anybody and a stop.

Only hashes are kept. Times are of the monotonic clock, so they count only until the machine starts anew.

Sessions: server-side, in memory, found by the hash of a 256-bit secret that only the browser has (S07).
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import secrets
from collections.abc import Iterable
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from drivebus.service.auth.users import User, replace_private

_BOOT = Path("/proc/sys/kernel/random/boot_id")


@dataclass(slots=True)
class SessionRecord:
    """Whose session it is, whichever process holds it. Times are monotonic seconds (S20)."""

    id: str
    """Opaque, no secret: leases belong to it, the audit trail names it."""
    csrf: str
    user: str
    stamp: str
    """Of the user as it was at the login."""
    address: str
    opened: float
    active: float

    def fields(self) -> dict[str, Any]:
        """Those of every session."""
        return {one.name: getattr(self, one.name) for one in fields(SessionRecord)}


@dataclass(slots=True, kw_only=True)
class StoredSession(SessionRecord):
    """One session as it is kept."""

    digest: str
    """Of its secret."""


@dataclass(frozen=True, slots=True)
class _SessionFile:
    boot: str
    sessions: tuple[StoredSession, ...]


_SESSION_FILE_ADAPTER = TypeAdapter(_SessionFile)


class SessionStore:
    """``sessions.json`` in the state directory (0600)."""

    def __init__(self, directory: Path) -> None:
        self.path = directory / "sessions.json"

    def read(self) -> tuple[StoredSession, ...]:
        """What was kept since the machine started; nothing where the file can't be read: everybody logs in again."""
        with contextlib.suppress(OSError, ValidationError):
            found = _SESSION_FILE_ADAPTER.validate_json(self.path.read_bytes())
            return found.sessions if found.boot == _boot_id() != "" else ()
        return ()

    def write(self, sessions: tuple[StoredSession, ...]) -> None:
        """Nothing happens where it can't be written: logging in and out go on."""
        with contextlib.suppress(OSError):
            replace_private(self.path, _SESSION_FILE_ADAPTER.dump_json(_SessionFile(_boot_id(), sessions)))


def _boot_id() -> str:
    """Empty where the system does not tell: then nothing is believed."""
    with contextlib.suppress(OSError):
        return _BOOT.read_text().strip()
    return ""


SESSION_IDLE_TIMEOUT_S = 900.0
"""Without a touch for so long, a session may only see and stop."""
SESSION_LIFETIME_S = 12 * 3600.0
MAX_SESSIONS_PER_USER = 20
"""A user's oldest session ends when there are more."""


@dataclass(slots=True, eq=False)
class Session(SessionRecord):
    """One browser that logged in."""

    ended: asyncio.Event = field(default_factory=asyncio.Event)
    end_reason: str | None = None

    def end(self, why: str) -> None:
        """``logout``, ``expired``, ``rights`` or ``replaced``; the first counts."""
        self.end_reason = self.end_reason or why
        self.ended.set()

    def expire(self, now: float) -> None:
        """It ends when it is too old."""
        if now - self.opened >= SESSION_LIFETIME_S:
            self.end("expired")

    def is_idle(self, now: float) -> bool:
        return now - self.active >= SESSION_IDLE_TIMEOUT_S

    def record_activity(self, now: float) -> None:
        """The person did something. An idle session stays idle: only a password wakes it (``Sessions.wake``)."""
        if not self.is_idle(now):
            self.active = now


class SessionTable:
    """Every open session. Times are monotonic seconds (S20)."""

    def __init__(self) -> None:
        self._by_digest: dict[str, Session] = {}

    def open(self, user: User, address: str, now: float) -> tuple[str, Session]:
        """A new secret, always (no secret survives a login), and its session."""
        self._limit_sessions(user.name, now)
        secret = secrets.token_urlsafe(32)
        session = Session(
            "s-" + secrets.token_hex(8), secrets.token_urlsafe(24), user.name, user.stamp, address, now, now
        )
        self._by_digest[secret_digest(secret)] = session
        return secret, session

    def unlock(self, session: Session, now: float) -> str:
        """A password was given again: a new secret for the same session, whose leases stay its own.

        Its CSRF token stays too: another tab of the same browser must not need a new one before it can stop.
        """
        self._by_digest = {key: one for key, one in self._by_digest.items() if one is not session}
        secret = secrets.token_urlsafe(32)
        session.active = now
        self._by_digest[secret_digest(secret)] = session
        return secret

    def find(self, secret: str, now: float) -> Session | None:
        session = self._by_digest.get(secret_digest(secret))
        if session is None:
            return None
        session.expire(now)
        if session.end_reason is not None:
            del self._by_digest[secret_digest(secret)]
            return None
        return session

    def stored(self) -> tuple[StoredSession, ...]:
        """For ``access.kept``."""
        return tuple(
            StoredSession(**one.fields(), digest=digest)
            for digest, one in self._by_digest.items()
            if one.end_reason is None
        )

    def restore(self, kept: Iterable[StoredSession]) -> None:
        """As another process had them."""
        for one in kept:
            self._by_digest[one.digest] = Session(**one.fields())

    def of_user(self, user: str) -> list[Session]:
        return [session for session in self._by_digest.values() if session.user == user and session.end_reason is None]

    def end_all(self, user: str, why: str) -> int:
        """How many ended."""
        ended = self.of_user(user)
        for session in ended:
            session.end(why)
        self._remove_ended()
        return len(ended)

    def _limit_sessions(self, user: str, now: float) -> None:
        for session in self._by_digest.values():
            session.expire(now)
        for session in sorted(self.of_user(user), key=lambda session: session.active)[: 1 - MAX_SESSIONS_PER_USER]:
            session.end("replaced")
        self._remove_ended()

    def _remove_ended(self) -> None:
        self._by_digest = {key: one for key, one in self._by_digest.items() if one.end_reason is None}


def secret_digest(secret: str) -> str:
    """Secrets are 128 bits and more of chance: one SHA-256 hides them well enough."""
    return hashlib.sha256(secret.encode("utf-8", "surrogatepass")).hexdigest()
