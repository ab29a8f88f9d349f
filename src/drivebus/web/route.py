"""``Route`` and ``RouteTable``: every path of the web process with the access that it requires.

Only an ``AccessRouter`` adds routes to the app, so that each has its access; a path that is not in the table never
reaches a handler.
"""

from __future__ import annotations

import re
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, TypeVar

from fastapi import APIRouter

from drivebus.service.auth.rights import Right


class AccessLevel(StrEnum):
    """Access that is not a right."""

    PUBLIC = "public"
    """No credential, also before the set-up."""
    SESSION = "session"
    """A session of a browser, idle or not."""


RequiredAccess = Right | AccessLevel
WEBSOCKET = "WEBSOCKET"
READ_METHODS = ("GET", WEBSOCKET)
Handler = TypeVar("Handler", bound=Callable[..., Awaitable[Any]])


@dataclass(frozen=True, slots=True, kw_only=True)
class Route:
    """One method of one path."""

    method: str
    path: str
    access: RequiredAccess
    background: bool = False
    """Sent by a page on its own; it does not count as activity of the user."""

    @property
    def yields(self) -> bool:
        """Whether it waits for its turn on the event loop: reads, and requests without a credential.

        Commands keep the order in which they arrived, so that a stop voids every command sent before it.
        """
        return self.method in READ_METHODS or self.access is AccessLevel.PUBLIC

    @property
    def pattern(self) -> re.Pattern[str]:
        parts = re.split(r"({\w+(?::path)?})", self.path)
        return re.compile(
            "".join(_segment_pattern(part) if part.startswith("{") else re.escape(part) for part in parts)
        )


def _segment_pattern(part: str) -> str:
    return ".+" if part.endswith(":path}") else "[^/]+"


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

    def __init__(self, prefix: str = "", **options: Any) -> None:
        self.prefix = prefix
        self.fastapi = APIRouter(prefix=prefix, **options)
        self.routes: list[Route] = []

    def add(
        self,
        method: str,
        path: str,
        handler: Callable[..., Awaitable[Any]],
        *,
        access: RequiredAccess,
        background: bool = False,
        **options: Any,
    ) -> None:
        """Add a route; ``options`` are FastAPI's."""
        self.routes.append(Route(method=method, path=self.prefix + path, access=access, background=background))
        if method == WEBSOCKET:
            self.fastapi.add_api_websocket_route(path, handler, **options)
        else:
            self.fastapi.add_api_route(path, handler, methods=[method], **options)

    def route(
        self, method: str, path: str, *, access: RequiredAccess, background: bool = False, **options: Any
    ) -> Callable[[Handler], Handler]:
        """Decorator for ``add``."""

        def decorate(handler: Handler) -> Handler:
            self.add(method, path, handler, access=access, background=background, **options)
            return handler

        return decorate
