"""What the routes of this room share: the access, the trail, and the session's answer and cookie."""

from __future__ import annotations

from collections.abc import Awaitable
from dataclasses import dataclass
from typing import Any, TypeVar

from starlette.requests import Request
from starlette.responses import JSONResponse

from drivebus.errors import DrivebusError
from drivebus.plant.access.access import Access, Opened
from drivebus.plant.access.refusals import TooManyAttempts, Unavailable
from drivebus.plant.access.sessions import ABSOLUTE_S, IDLE_S
from drivebus.plant.access.visitor import BySession, Visitor
from drivebus.plant.actor import Actor
from drivebus.plant.client import Json, PlantClient
from drivebus.web.door import COOKIES, address
from drivebus.web.refused import Refusals, tell

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Desk:
    """One for an app."""

    access: Access
    client: PlantClient
    refusals: Refusals

    def session_json(self, visitor: Visitor | None) -> Json:
        """Who is logged in, for the page. ``setup``: there is no administrator yet."""
        found: Json = {"setup": self.access.needs_setup, "user": None, "rights": [], "csrf": None}
        if visitor is None:
            return found
        actor = visitor.actor
        found |= {"user": actor.name, "rights": sorted(actor.rights), "session": actor.session}
        return found | (self._browser_json(visitor) if isinstance(visitor, BySession) else {})

    def _browser_json(self, visitor: BySession) -> Json:
        session, now = visitor.session, self.access.clock()
        return {
            "role": str(self.access.register.user(session.user).role),
            "csrf": session.csrf,
            "idle": visitor.is_idle,
            "idle_in_s": round(max(0.0, session.active + IDLE_S - now), 1),
            "expires_in_s": round(max(0.0, session.opened + ABSOLUTE_S - now), 1),
        }

    async def let_in(self, request: Request, how: str, login: Awaitable[Opened], name: str = "") -> JSONResponse:
        """Run ``login``; its session replaces the one that the request came with. Raises AccessError, recorded."""
        try:
            opened = await login
        except DrivebusError as error:
            told = "" if isinstance(error, TooManyAttempts) else name  # else a flood of names would be one of entries
            stranger = Actor(told, frozenset(), "", address=address(request.scope))
            await self.refusals.refused(how, told, error.key, stranger)
            raise
        before: Visitor | None = request.state.visitor
        if isinstance(before, BySession) and before.session is not opened.session:
            before.session.end("replaced")
            await self.access.keep()
        visitor = BySession(opened.session, self.access.around)
        await tell(self.client, entry(how, opened.session.user, outcome="done"), visitor.actor)
        return with_cookie(request, JSONResponse(self.session_json(visitor)), opened.secret)

    async def change(self, what: str, target: str, params: Json, actor: Actor, change: Awaitable[T]) -> T:
        """Run ``change`` with a record before and after it. Raises Unavailable, and nothing is changed, where the
        trail can't be written."""
        if not await tell(self.client, entry(what, target, params, "asked"), actor):
            close = getattr(change, "close", None)
            if close is not None:
                close()
            raise Unavailable("access.no_record")
        try:
            result = await change
        except DrivebusError as error:
            await tell(self.client, entry(what, target, params, error.key), actor)
            raise
        await tell(self.client, entry(what, target, params, "done"), actor)
        return result


def entry(what: str, target: str, params: Json | None = None, outcome: str = "") -> Json:
    """For the audit trail; never with a secret in it."""
    return {"what": what, "target": target, "params": params or {}, "outcome": outcome}


def with_cookie(request: Request, answer: JSONResponse, secret: str) -> JSONResponse:
    """The session's cookie; over TLS (also a reverse proxy's, told by the Origin) with the prefix ``__Host-``."""
    secure = request.url.scheme == "https" or request.headers.get("origin", "").startswith("https://")
    forms: Any = {"path": "/", "httponly": True, "samesite": "strict"}
    answer.set_cookie(COOKIES[0 if secure else 1], secret, max_age=int(ABSOLUTE_S), secure=secure, **forms)
    return answer


def without_cookie(answer: JSONResponse) -> JSONResponse:
    for name in COOKIES:
        answer.delete_cookie(name, path="/", httponly=True, samesite="strict", secure=name.startswith("__Host-"))
    return answer
