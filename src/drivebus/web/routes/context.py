"""What the routes of this room share: the access, the trail, and the session's answer and cookie."""

from __future__ import annotations

from collections.abc import Awaitable
from dataclasses import dataclass
from typing import Any, TypeVar

from starlette.requests import Request
from starlette.responses import JSONResponse

from drivebus.errors import DrivebusError
from drivebus.service.auth.actor import Actor
from drivebus.service.auth.credentials import Credential, SessionCredential
from drivebus.service.auth.errors import AuthUnavailable, TooManyAttempts
from drivebus.service.auth.service import AuthService, LoginResult
from drivebus.service.auth.sessions import SESSION_IDLE_TIMEOUT_S, SESSION_LIFETIME_S
from drivebus.service.ipc.service_client import Json, ServiceClient
from drivebus.web.middleware.auth import COOKIE_NAMES, client_address
from drivebus.web.middleware.denial_log import DenialLog, try_record

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class RouteContext:
    """One for an app."""

    access: AuthService
    client: ServiceClient
    denials: DenialLog

    def session_json(self, visitor: Credential | None) -> Json:
        """Who is logged in, for the page. ``setup``: there is no administrator yet."""
        found: Json = {"setup": self.access.needs_setup, "user": None, "rights": [], "csrf": None}
        if visitor is None:
            return found
        actor = visitor.actor
        found |= {"user": actor.name, "rights": sorted(actor.rights), "session": actor.session}
        return found | (self._session_details(visitor) if isinstance(visitor, SessionCredential) else {})

    def _session_details(self, visitor: SessionCredential) -> Json:
        session, now = visitor.session, self.access.clock()
        return {
            "role": str(self.access.database.user(session.user).role),
            "csrf": session.csrf,
            "idle": visitor.is_idle,
            "idle_in_s": round(max(0.0, session.active + SESSION_IDLE_TIMEOUT_S - now), 1),
            "expires_in_s": round(max(0.0, session.opened + SESSION_LIFETIME_S - now), 1),
        }

    async def complete_login(
        self, request: Request, how: str, login: Awaitable[LoginResult], name: str = ""
    ) -> JSONResponse:
        """Run ``login``; its session replaces the one that the request came with. Raises AuthError, recorded."""
        try:
            opened = await login
        except DrivebusError as error:
            told = "" if isinstance(error, TooManyAttempts) else name  # else a flood of names would be one of entries
            stranger = Actor(told, frozenset(), "", address=client_address(request.scope))
            await self.denials.record_denial(how, told, error.key, stranger)
            raise
        before: Credential | None = request.state.visitor
        if isinstance(before, SessionCredential) and before.session is not opened.session:
            before.session.end("replaced")
            await self.access.keep()
        visitor = SessionCredential(opened.session, self.access.context)
        await try_record(self.client, audit_entry(how, opened.session.user, outcome="done"), visitor.actor)
        return set_session_cookie(request, JSONResponse(self.session_json(visitor)), opened.secret)

    async def record_change(self, what: str, target: str, params: Json, actor: Actor, change: Awaitable[T]) -> T:
        """Run ``change`` with a record before and after it. Raises Unavailable, and nothing is changed, where the
        trail can't be written."""
        if not await try_record(self.client, audit_entry(what, target, params, "asked"), actor):
            close = getattr(change, "close", None)
            if close is not None:
                close()
            raise AuthUnavailable("access.no_record")
        try:
            result = await change
        except DrivebusError as error:
            await try_record(self.client, audit_entry(what, target, params, error.key), actor)
            raise
        await try_record(self.client, audit_entry(what, target, params, "done"), actor)
        return result


def audit_entry(what: str, target: str, params: Json | None = None, outcome: str = "") -> Json:
    """For the audit trail; never with a secret in it."""
    return {"what": what, "target": target, "params": params or {}, "outcome": outcome}


def set_session_cookie(request: Request, answer: JSONResponse, secret: str) -> JSONResponse:
    """The session's cookie; over TLS (also a reverse proxy's, told by the Origin) with the prefix ``__Host-``."""
    secure = request.url.scheme == "https" or request.headers.get("origin", "").startswith("https://")
    forms: Any = {"path": "/", "httponly": True, "samesite": "strict"}
    answer.set_cookie(COOKIE_NAMES[0 if secure else 1], secret, max_age=int(SESSION_LIFETIME_S), secure=secure, **forms)
    return answer


def clear_session_cookies(answer: JSONResponse) -> JSONResponse:
    for name in COOKIE_NAMES:
        answer.delete_cookie(name, path="/", httponly=True, samesite="strict", secure=name.startswith("__Host-"))
    return answer
