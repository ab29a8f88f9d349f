"""What the web's door leaves for the routes behind it: who came, already let in for this very route."""

from __future__ import annotations

from typing import cast

from starlette.requests import HTTPConnection

from drivebus.plant.access.visitor import Visitor
from drivebus.plant.actor import Actor


def visitor(connection: HTTPConnection) -> Visitor:
    """Ask ``.actor`` anew for each message of a long connection: rights may shrink meanwhile."""
    return cast(Visitor, connection.state.visitor)


def actor(connection: HTTPConnection) -> Actor:
    """Who asks, with the rights of this moment. A FastAPI dependency."""
    return visitor(connection).actor
