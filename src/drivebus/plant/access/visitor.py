"""Whoever stands at the door with a good credential: a session or a token, and what it may do at this moment."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass

from drivebus.plant.access.register import Register, Token
from drivebus.plant.access.rights import Right
from drivebus.plant.access.sessions import Session
from drivebus.plant.actor import Actor

_LOOK_S = 0.5
"""A role that is changed in the file ends what is open within this (S04 asks for 1 s)."""
_IDLE = frozenset({Right.VIEW, Right.STOP})
"""What an idle session still may (S07); a stop never waits for a password (S05)."""


@dataclass(frozen=True, slots=True)
class Around:
    """What a visitor's rights follow from, looked at anew each time."""

    register: Callable[[], Register]
    clock: Callable[[], float]
    """Monotonic seconds."""
    wall_ms: Callable[[], int]
    """UTC, for tokens' dates only."""


@dataclass(frozen=True, slots=True)
class BySession:
    """A person with a browser."""

    session: Session
    around: Around

    @property
    def why_over(self) -> str | None:
        """None while it is good; else ``logout``, ``expired``, ``rights``, ``replaced``."""
        user = self.around.register().find(self.session.user)
        if user is None or user.stamp != self.session.stamp:
            self.session.end("rights")
        self.session.age(self.around.clock())
        return self.session.why

    @property
    def is_idle(self) -> bool:
        return self.session.is_idle(self.around.clock())

    @property
    def actor(self) -> Actor:
        """As of now: no rights at all once it is over."""
        rights = frozenset() if self.why_over else self.around.register().rights_of(self.session.user)
        allowed = rights & _IDLE if self.is_idle else rights
        return Actor(self.session.user, allowed, self.session.id, remote=True, address=self.session.address)

    async def ended(self) -> str:
        """Wait until it is over; why."""
        while (why := self.why_over) is None:
            await _either(self.session.over)
        return why


@dataclass(frozen=True, slots=True)
class ByToken:
    """A program."""

    token: Token
    address: str
    around: Around

    is_idle = False

    @property
    def why_over(self) -> str | None:
        if self.token not in self.around.register().tokens:  # with a user go the user's tokens
            return "rights"
        return "expired" if self.around.wall_ms() >= self.token.expires_ms else None

    @property
    def actor(self) -> Actor:
        """As of now: what the token says, as far as its user still may it."""
        held = self.around.register().rights_of(self.token.user) & set(self.token.rights)
        rights: frozenset[Right] = frozenset() if self.why_over else held
        name = f"{self.token.user}/{self.token.name}"
        return Actor(name, rights, f"token-{self.token.id}", remote=True, address=self.address)

    async def ended(self) -> str:
        before, never = self.actor.rights, asyncio.Event()
        while (why := self.why_over) is None and self.actor.rights == before:
            await _either(never)
        return why or "rights"


Visitor = BySession | ByToken


async def _either(over: asyncio.Event) -> None:
    """Until ``over``, or until it is time to look again."""
    try:
        await asyncio.wait_for(over.wait(), _LOOK_S)
    except TimeoutError:
        return
