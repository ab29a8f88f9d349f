"""Who asks: carried by every call to the plant, written into the audit trail."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from drivebus.service.auth.rights import ROLE_RIGHTS, Right, Role


@dataclass(frozen=True, slots=True)
class Actor:
    """A person or a program, what it may do, and through which session it speaks."""

    name: str
    rights: frozenset[Right]
    session: str
    """Opaque id of the session, token or local connection: leases belong to it. Never a secret."""
    remote: bool = True
    """Not on the local socket by its own hand: a start takes two steps (6.5)."""
    address: str = ""
    """Where it connected from, for the audit trail."""

    def may(self, right: Right) -> bool:
        return right in self.rights

    def as_json(self) -> dict[str, Any]:
        rights = sorted(self.rights)
        return {
            "name": self.name,
            "rights": rights,
            "session": self.session,
            "remote": self.remote,
            "address": self.address,
        }

    @classmethod
    def from_json(cls, found: dict[str, Any]) -> Actor:
        """Raises KeyError, ValueError for what is no actor."""
        rights = frozenset(Right(right) for right in found["rights"])
        return cls(str(found["name"]), rights, str(found["session"]), bool(found["remote"]), str(found["address"]))


def local_actor(name: str, session: str) -> Actor:
    """Whoever may open the plant's own socket: the user that runs it."""
    return Actor(name, ROLE_RIGHTS[Role.ADMINISTRATOR], session, remote=False, address="local")
