"""What the web's door leaves for the routes behind it: who came, already let in for this very route."""

from __future__ import annotations

from typing import cast

from starlette.requests import HTTPConnection

from drivebus.service.auth.actor import Actor
from drivebus.service.auth.credentials import Credential


def credential_of(connection: HTTPConnection) -> Credential:
    """Ask ``.actor`` anew for each message of a long connection: rights may shrink meanwhile."""
    return cast(Credential, connection.state.visitor)


def actor_of(connection: HTTPConnection) -> Actor:
    """Who asks, with the rights of this moment. A FastAPI dependency."""
    return credential_of(connection).actor
