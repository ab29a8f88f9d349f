"""Sessions: server-side, in memory, found by the hash of a 256-bit secret that only the browser has (S07)."""

from __future__ import annotations

import asyncio
import hashlib
import secrets
from collections.abc import Iterable
from dataclasses import dataclass, field

from drivebus.plant.access.kept import Kept, Login
from drivebus.plant.access.register import User

IDLE_S = 900.0
"""Without a touch for so long, a session may only see and stop."""
ABSOLUTE_S = 12 * 3600.0
PER_USER = 20
"""A user's oldest session ends when there are more."""


@dataclass(slots=True, eq=False)
class Session(Login):
    """One browser that logged in."""

    over: asyncio.Event = field(default_factory=asyncio.Event)
    why: str | None = None

    def end(self, why: str) -> None:
        """``logout``, ``expired``, ``rights`` or ``replaced``; the first counts."""
        self.why = self.why or why
        self.over.set()

    def age(self, now: float) -> None:
        """It ends when it is too old."""
        if now - self.opened >= ABSOLUTE_S:
            self.end("expired")

    def is_idle(self, now: float) -> bool:
        return now - self.active >= IDLE_S

    def touch(self, now: float) -> None:
        """The person did something. An idle session stays idle: only a password wakes it (``Sessions.wake``)."""
        if not self.is_idle(now):
            self.active = now


class Sessions:
    """Every open session. Times are monotonic seconds (S20)."""

    def __init__(self) -> None:
        self._by_digest: dict[str, Session] = {}

    def open(self, user: User, address: str, now: float) -> tuple[str, Session]:
        """A new secret, always (no secret survives a login), and its session."""
        self._make_room(user.name, now)
        secret = secrets.token_urlsafe(32)
        session = Session(
            "s-" + secrets.token_hex(8), secrets.token_urlsafe(24), user.name, user.stamp, address, now, now
        )
        self._by_digest[digest(secret)] = session
        return secret, session

    def wake(self, session: Session, now: float) -> str:
        """A password was given again: a new secret for the same session, whose leases stay its own.

        Its CSRF token stays too: another tab of the same browser must not need a new one before it can stop.
        """
        self._by_digest = {key: one for key, one in self._by_digest.items() if one is not session}
        secret = secrets.token_urlsafe(32)
        session.active = now
        self._by_digest[digest(secret)] = session
        return secret

    def find(self, secret: str, now: float) -> Session | None:
        session = self._by_digest.get(digest(secret))
        if session is None:
            return None
        session.age(now)
        if session.why is not None:
            del self._by_digest[digest(secret)]
            return None
        return session

    def kept(self) -> tuple[Kept, ...]:
        """For ``access.kept``."""
        return tuple(Kept(**one.fields(), digest=digest) for digest, one in self._by_digest.items() if one.why is None)

    def restore(self, kept: Iterable[Kept]) -> None:
        """As another process had them."""
        for one in kept:
            self._by_digest[one.digest] = Session(**one.fields())

    def of(self, user: str) -> list[Session]:
        return [session for session in self._by_digest.values() if session.user == user and session.why is None]

    def end_all(self, user: str, why: str) -> int:
        """How many ended."""
        ended = self.of(user)
        for session in ended:
            session.end(why)
        self._forget()
        return len(ended)

    def _make_room(self, user: str, now: float) -> None:
        for session in self._by_digest.values():
            session.age(now)
        for session in sorted(self.of(user), key=lambda session: session.active)[: 1 - PER_USER]:
            session.end("replaced")
        self._forget()

    def _forget(self) -> None:
        self._by_digest = {key: one for key, one in self._by_digest.items() if one.why is None}


def digest(secret: str) -> str:
    """Secrets are 128 bits and more of chance: one SHA-256 hides them well enough."""
    return hashlib.sha256(secret.encode("utf-8", "surrogatepass")).hexdigest()
