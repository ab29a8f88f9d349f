"""``Route`` and ``RouteTable``: every path of the web process with the access that it requires.

Only an ``AccessRouter`` adds routes to the app, so that each has its access; a path that is not in the table never
reaches a handler.
"""

from __future__ import annotations

import re
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass
from typing import Any, TypeVar

from fastapi import APIRouter

from drivebus.service.api.operations import Operation
from drivebus.service.auth.rights import AccessLevel, RequiredAccess

WEBSOCKET = "WEBSOCKET"
READ_METHODS = ("GET", WEBSOCKET)
Handler = TypeVar("Handler", bound=Callable[..., Awaitable[Any]])


@dataclass(frozen=True, slots=True, kw_only=True)
class Route:
    """Method of a path."""

    method: str
    path: str
    access: RequiredAccess
    background: bool = False
    """Sent by a page on its own; it does not count as activity of the user."""

    yields: bool = True
    """Whether it waits for its turn on the event loop: reads, and requests without a credential.

    Commands keep the order in which they arrived, so that a stop voids every command sent before it.
    """

    @classmethod
    def of(cls, operation: Operation) -> Route:
        """Return the route of an operation."""
        return cls(
            method=operation.method,
            path=operation.url_path,
            access=operation.right,
            background=operation.background,
            yields=operation.yields or operation.right is AccessLevel.PUBLIC,
        )

    @property
    def pattern(self) -> re.Pattern[str]:
        parts = re.split(r"({\w+(?::path)?})", self.path)
        return re.compile(
            "".join(_segment_pattern(part) if part.startswith("{") else re.escape(part) for part in parts)
        )


def _segment_pattern(segment: str) -> str:
    return ".+" if segment.endswith(":path}") else "[^/]+"


class RouteTable:
    """All routes of an app. Raises ValueError for one that is declared twice."""

    def __init__(self, routes: Iterable[Route]) -> None:
        self.routes = tuple(routes)
        self._patterns = [(route, route.pattern) for route in self.routes]
        if len({(route.method, route.path) for route in self.routes}) != len(self.routes):
            raise ValueError("a route is declared twice")

    def match(self, path: str) -> list[Route]:
        """Return the routes of ``path``, one for each method."""
        return [route for route, pattern in self._patterns if pattern.fullmatch(path)]


class AccessRouter:
    """FastAPI router whose routes all declare the access that they require."""

    def __init__(self) -> None:
        self.fastapi = APIRouter()
        self.routes: list[Route] = []

    def add(self, route: Route, handler: Callable[..., Awaitable[Any]], **options: Any) -> None:
        """Add a route; ``options`` are FastAPI's for HTTP."""
        self.routes.append(route)
        if route.method == WEBSOCKET:
            self.fastapi.add_api_websocket_route(route.path, handler)
        else:
            self.fastapi.add_api_route(route.path, handler, methods=[route.method], **options)

    def exempt(self, method: str, path: str, *, access: RequiredAccess) -> Callable[[Handler], Handler]:
        """Return a decorator for the handler of a route that is no operation: a file or the live WebSocket."""

        def decorate(handler: Handler) -> Handler:
            self.add(Route(method=method, path=path, access=access), handler, include_in_schema=False)
            return handler

        return decorate
