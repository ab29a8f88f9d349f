"""Whoever stands at the door with a good credential: a session or a token, and what it may do at this moment."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass

from drivebus.service.auth.actor import Actor
from drivebus.service.auth.rights import Right
from drivebus.service.auth.sessions import Session
from drivebus.service.auth.users import Token, UserDatabase

_RIGHTS_CHECK_INTERVAL_S = 0.5
"""A role that is changed in the file ends what is open within this (S04 asks for 1 s)."""
_IDLE_SESSION_RIGHTS = frozenset({Right.VIEW, Right.STOP})
"""What an idle session still may (S07); a stop never waits for a password (S05)."""


@dataclass(frozen=True, slots=True)
class AuthContext:
    """What a visitor's rights follow from, looked at anew each time."""

    database: Callable[[], UserDatabase]
    clock: Callable[[], float]
    """Monotonic seconds."""
    wall_ms: Callable[[], int]
    """UTC, for tokens' dates only."""


@dataclass(frozen=True, slots=True)
class SessionCredential:
    """A person with a browser."""

    session: Session
    context: AuthContext

    @property
    def end_reason(self) -> str | None:
        """None while it is good; else ``logout``, ``expired``, ``rights``, ``replaced``."""
        user = self.context.database().find(self.session.user)
        if user is None or user.stamp != self.session.stamp:
            self.session.end("rights")
        self.session.expire(self.context.clock())
        return self.session.end_reason

    @property
    def is_idle(self) -> bool:
        return self.session.is_idle(self.context.clock())

    @property
    def actor(self) -> Actor:
        """As of now: no rights at all once it is over."""
        rights = frozenset() if self.end_reason else self.context.database().rights_of(self.session.user)
        allowed = rights & _IDLE_SESSION_RIGHTS if self.is_idle else rights
        return Actor(self.session.user, allowed, self.session.id, remote=True, address=self.session.address)

    async def wait_ended(self) -> str:
        """Wait until it is over; why."""
        while (why := self.end_reason) is None:
            await _wait_or_check(self.session.ended)
        return why


@dataclass(frozen=True, slots=True)
class TokenCredential:
    """A program."""

    token: Token
    address: str
    context: AuthContext

    is_idle = False

    @property
    def end_reason(self) -> str | None:
        if self.token not in self.context.database().tokens:  # with a user go the user's tokens
            return "rights"
        return "expired" if self.context.wall_ms() >= self.token.expires_ms else None

    @property
    def actor(self) -> Actor:
        """As of now: what the token says, as far as its user still may it."""
        held = self.context.database().rights_of(self.token.user) & set(self.token.rights)
        rights: frozenset[Right] = frozenset() if self.end_reason else held
        name = f"{self.token.user}/{self.token.name}"
        return Actor(name, rights, f"token-{self.token.id}", remote=True, address=self.address)

    async def wait_ended(self) -> str:
        before, never = self.actor.rights, asyncio.Event()
        while (why := self.end_reason) is None and self.actor.rights == before:
            await _wait_or_check(never)
        return why or "rights"


Credential = SessionCredential | TokenCredential


async def _wait_or_check(over: asyncio.Event) -> None:
    """Until ``over``, or until it is time to look again."""
    try:
        await asyncio.wait_for(over.wait(), _RIGHTS_CHECK_INTERVAL_S)
    except TimeoutError:
        return
