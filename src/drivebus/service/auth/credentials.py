"""Authenticated credentials: a session or a token, with the rights that it has at this moment."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass

from drivebus.service.auth.actor import Actor
from drivebus.service.auth.rights import RequiredAccess, Right
from drivebus.service.auth.sessions import Session
from drivebus.service.auth.users import Token, UserDatabase

_RIGHTS_CHECK_INTERVAL_S = 0.5
"""Longest time for which an open connection keeps rights that its user has lost."""
_IDLE_SESSION_RIGHTS = frozenset({Right.VIEW, Right.STOP})
"""Rights of an idle session: a stop never waits for a password."""


@dataclass(frozen=True, slots=True)
class AuthContext:
    """Sources from which the rights of a credential are computed on each use."""

    database: Callable[[], UserDatabase]
    clock: Callable[[], float]
    """Monotonic seconds."""
    wall_ms: Callable[[], int]
    """UTC, for the expiry of tokens only."""


@dataclass(frozen=True, slots=True)
class SessionCredential:
    """Credential of a browser session."""

    session: Session
    context: AuthContext
    secret_ends: float | None = None
    """Time at which its secret ends that an unlocking has replaced: until then it has the rights of an idle session."""

    @property
    def end_reason(self) -> str | None:
        """None while it is valid; else as in ``Session.end``."""
        user = self.context.database().find(self.session.user)
        changed = "removed" if user is None else user.change_since(self.session.stamp)
        if changed is not None:
            self.session.end(changed)
        now = self.context.clock()
        self.session.expire(now)
        if self.secret_ends is not None and now >= self.secret_ends:
            return self.session.end_reason or "replaced"
        return self.session.end_reason

    @property
    def is_idle(self) -> bool:
        return self.secret_ends is not None or self.session.is_idle(self.context.clock())

    @property
    def actor(self) -> Actor:
        """Actor with the rights of this moment; none once the session has ended."""
        rights = frozenset() if self.end_reason else self.context.database().rights_of(self.session.user)
        allowed = rights & _IDLE_SESSION_RIGHTS if self.is_idle else rights
        return Actor(self.session.user, allowed, self.session.id, remote=True, address=self.session.address)

    async def wait_ended(self) -> str:
        """Wait until the session ends and return the reason."""
        while (reason := self.end_reason) is None:
            await _wait_or_check(self.session.ended)
        return reason


@dataclass(frozen=True, slots=True)
class TokenCredential:
    """Credential of a program's token."""

    token: Token
    address: str
    context: AuthContext

    is_idle = False

    @property
    def end_reason(self) -> str | None:
        if self.token not in self.context.database().tokens:  # tokens are deleted with their user
            return "rights"
        return "expired" if self.context.wall_ms() >= self.token.expires_ms else None

    @property
    def actor(self) -> Actor:
        """Actor with the rights of this moment: those of the token that its user still has."""
        effective = self.context.database().rights_of(self.token.user) & set(self.token.rights)
        rights: frozenset[Right] = frozenset() if self.end_reason else effective
        name = f"{self.token.user}/{self.token.name}"
        return Actor(name, rights, f"token-{self.token.id}", remote=True, address=self.address)

    def user_may(self, right: RequiredAccess) -> bool:
        """Return whether the user of the token has a right, which the token may lack."""
        return right in self.context.database().rights_of(self.token.user)

    async def wait_ended(self) -> str:
        """Wait until the token ends or its rights change, and return the reason."""
        before, never = self.actor.rights, asyncio.Event()
        while (reason := self.end_reason) is None and self.actor.rights == before:
            await _wait_or_check(never)
        return reason or "rights"


Credential = SessionCredential | TokenCredential


async def _wait_or_check(ended: asyncio.Event) -> None:
    """Wait for ``ended``, at most until the next check of rights."""
    try:
        await asyncio.wait_for(ended.wait(), _RIGHTS_CHECK_INTERVAL_S)
    except TimeoutError:
        return
