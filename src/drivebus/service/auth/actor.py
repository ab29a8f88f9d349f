"""Actor of a call to the service: identity and rights, recorded in the audit trail."""

from __future__ import annotations

import getpass
import os
from dataclasses import dataclass
from typing import Any

from drivebus.service.auth.rights import ROLE_RIGHTS, RequiredAccess, Right, Role

SERVICE_NAME = "drivebus"
"""Name of the service in the audit trail and the log, for what it does by itself; no user may have it."""
STOP_ALL_NAME = "stop-all"
"""Name of ``drivebus stop --all`` in the audit trail, whose socket takes no name; no user may have it."""


@dataclass(frozen=True, slots=True)
class Actor:
    """Person or program with its rights and its session."""

    name: str
    rights: frozenset[Right]
    session: str
    """Opaque id of the session, token or local connection: control leases belong to it. Never a secret."""
    remote: bool = True
    """Whether the call comes from another machine or a browser; then a start takes two steps (arm, start)."""
    address: str = ""
    """Address of the client, for the audit trail."""

    @property
    def user(self) -> str:
        """Name of the user who acts, also of one whose token does (``user/token``)."""
        return self.name.partition("/")[0]

    @property
    def is_program(self) -> bool:
        """Whether a program acts with a token of the user."""
        return self.remote and self.name != self.user

    def may(self, required: RequiredAccess) -> bool:
        """Return whether the actor has the right; no actor has an access level as a right."""
        return required in self.rights

    def is_same_session(self, other: Actor) -> bool:
        """Return whether both act in one session, which control leases, requests and jogs belong to."""
        return self.session == other.session

    def is_same_local_user(self, other: Actor) -> bool:
        """Return whether both are the same user on the local socket, in one terminal or in two."""
        return not self.remote and not other.remote and self.name == other.name

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
    def from_json(cls, data: dict[str, Any]) -> Actor:
        """Return the actor of its JSON form. Raises KeyError, ValueError for anything else."""
        rights = frozenset(Right(right) for right in data["rights"])
        return cls(str(data["name"]), rights, str(data["session"]), bool(data["remote"]), str(data["address"]))


def local_user() -> str:
    """Return the name of the person at this machine's command line: who called sudo, else the user of the process.

    ``sudo -u drivebus`` would record all users under the name that stands for the service itself.
    """
    name = os.environ.get("SUDO_USER") or getpass.getuser()
    return f"{name}/command-line" if name in (SERVICE_NAME, STOP_ALL_NAME) else name


def local_actor(name: str, session: str) -> Actor:
    """Return the actor of the local socket, which only the service's own user can open."""
    return Actor(name, ROLE_RIGHTS[Role.ADMINISTRATOR], session, remote=False, address="local")
