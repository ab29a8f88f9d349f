"""Routes of one's own account: set-up, login, logout, unlocking, password."""

from __future__ import annotations

from collections.abc import Awaitable
from typing import Any

from starlette.requests import Request
from starlette.responses import JSONResponse

from drivebus.errors import DrivebusError
from drivebus.service.api.errors import param_fault, params_error
from drivebus.service.api.operations import API_PREFIX
from drivebus.service.auth.actor import Actor
from drivebus.service.auth.credentials import Credential, SessionCredential
from drivebus.service.auth.errors import TooManyAttempts
from drivebus.service.auth.service import AuthService, LoginResult
from drivebus.service.auth.sessions import SESSION_IDLE_TIMEOUT_S, SESSION_LIFETIME_S
from drivebus.types import Json
from drivebus.web.context import audit_entry, context_of, credential_of
from drivebus.web.middleware.auth import COOKIE_NAMES, client_address
from drivebus.web.middleware.denial_log import try_record
from drivebus.web.route import AccessLevel, AccessRouter
from drivebus.web.routes.schemas import (
    CodeLoginBody,
    LoginBody,
    PasswordBody,
    SetupBody,
    UnlockBody,
    body_schema,
    parse_body,
)

router = AccessRouter(API_PREFIX, tags=["account"])


@router.route("GET", "/health", access=AccessLevel.PUBLIC)
async def health() -> dict[str, bool]:
    return {"ok": True}


@router.route("GET", "/session", access=AccessLevel.PUBLIC)
async def get_session(request: Request) -> JSONResponse:
    return JSONResponse(_session_json(context_of(request).auth, request.state.credential))


@router.route("POST", "/session/activity", access=AccessLevel.SESSION)
async def report_activity(request: Request) -> JSONResponse:
    """Keep the session from becoming idle; the middleware has recorded the activity."""
    return JSONResponse(_session_json(context_of(request).auth, request.state.credential))


@router.route("POST", "/session/unlock", access=AccessLevel.SESSION, openapi_extra=body_schema(UnlockBody))
async def unlock(request: Request) -> JSONResponse:
    """Give an idle session its rights back for the password; it gets a new cookie."""
    session, body = _session_credential(request).session, parse_body(request, UnlockBody)
    unlocking = context_of(request).auth.unlock(session, body.password)
    return await _complete_login(request, "unlock", unlocking, session.user)


@router.route("POST", "/setup", access=AccessLevel.PUBLIC, openapi_extra=body_schema(SetupBody))
async def set_up(request: Request) -> JSONResponse:
    """Create the first administrator."""
    body, auth = parse_body(request, SetupBody), context_of(request).auth
    address = client_address(request.scope)
    creating = auth.create_first_administrator(body.secret, body.name, body.password, address)
    return await _complete_login(request, "set-up", creating, body.name)


@router.route("POST", "/login", access=AccessLevel.PUBLIC, openapi_extra=body_schema(LoginBody))
async def login(request: Request) -> JSONResponse:
    body = parse_body(request, LoginBody)
    opening = context_of(request).auth.login(body.name, body.password, client_address(request.scope))
    return await _complete_login(request, "login", opening, body.name)


@router.route("POST", "/login/code", access=AccessLevel.PUBLIC, openapi_extra=body_schema(CodeLoginBody))
async def login_with_code(request: Request) -> JSONResponse:
    body = parse_body(request, CodeLoginBody)
    opening = context_of(request).auth.login_with_code(body.code, client_address(request.scope))
    return await _complete_login(request, "login-code", opening)


_ALL_SESSIONS: Json = {
    "parameters": [
        {
            "name": "all",
            "in": "query",
            "required": False,
            "schema": {"type": "boolean", "default": False},
            "description": "End every session of the user.",
        }
    ]
}


@router.route("POST", "/logout", access=AccessLevel.SESSION, openapi_extra=_ALL_SESSIONS)
async def logout(request: Request) -> JSONResponse:
    """End the session, with ``all=true`` every session of the user."""
    context, credential = context_of(request), _session_credential(request)
    actor = credential.actor
    if _flag(request, "all"):
        ended = await context.auth.end_sessions(credential.session.user, "logout")
        entry = audit_entry("logout", actor.name, {"sessions": ended}, "done")
    else:
        await context.auth.logout(credential.session)
        ended, entry = 1, audit_entry("logout", actor.name, outcome="done")
    await try_record(context.client, entry, actor)
    return _without_session_cookies(JSONResponse({"ended": ended}))


@router.route("POST", "/password", access=AccessLevel.SESSION, openapi_extra=body_schema(PasswordBody))
async def change_password(request: Request) -> JSONResponse:
    """Change one's own password; every other session of the user ends."""
    context, credential, body = context_of(request), _session_credential(request), parse_body(request, PasswordBody)
    changing = context.auth.change_password(credential.session, body.old, body.new)
    opened = await context.record_change("password", credential.session.user, {}, credential.actor, changing)
    session = SessionCredential(opened.session, context.auth.context)
    response = JSONResponse(_session_json(context.auth, session))
    return with_session_cookie(request, response, opened.secret)


def _session_credential(request: Request) -> SessionCredential:
    found = credential_of(request)
    assert isinstance(found, SessionCredential)  # the middleware lets nothing else through to these routes
    return found


def _flag(request: Request, name: str) -> bool:
    """Raises InvalidParameters for a query that is anything but ``name=true`` or ``name=false``."""
    query = request.query_params.multi_items()
    if unknown := [key for key, _ in query if key != name]:
        raise params_error(request.url.path, [param_fault(unknown[0], "", "unknown")])
    values = [value for _, value in query]
    if values not in ([], ["true"], ["false"]):
        raise params_error(request.url.path, [param_fault(name, values, "boolean")])
    return values == ["true"]


def _session_json(auth: AuthService, credential: Credential | None) -> Json:
    """Return the user, rights and CSRF token; ``setup`` is true while there is no administrator."""
    found: Json = {"setup": auth.needs_setup, "user": None, "rights": [], "csrf": None}
    if credential is None:
        return found
    actor = credential.actor
    found |= {"user": actor.name, "rights": sorted(actor.rights), "session": actor.session}
    if not isinstance(credential, SessionCredential):
        return found
    session, now = credential.session, auth.clock()
    return found | {
        "role": str(auth.database.user(session.user).role),
        "csrf": session.csrf,
        "idle": credential.is_idle,
        "idle_in_s": round(max(0.0, session.active + SESSION_IDLE_TIMEOUT_S - now), 1),
        "expires_in_s": round(max(0.0, session.opened + SESSION_LIFETIME_S - now), 1),
    }


async def _complete_login(request: Request, what: str, login: Awaitable[LoginResult], name: str = "") -> JSONResponse:
    """Run ``login``; its session replaces the one of the request. Raises AuthError, recorded as a denial."""
    context = context_of(request)
    auth = context.auth
    try:
        opened = await login
    except DrivebusError as error:
        recorded = "" if isinstance(error, TooManyAttempts) else name  # a flood of names must not flood the audit trail
        actor = Actor(recorded, frozenset(), "", address=client_address(request.scope))
        await context.denials.record_denial(what, recorded, error.key, actor)
        raise
    previous: Credential | None = request.state.credential
    if isinstance(previous, SessionCredential) and previous.session is not opened.session:
        previous.session.end("replaced")
        await auth.keep()
    credential = SessionCredential(opened.session, auth.context)
    await try_record(context.client, audit_entry(what, opened.session.user, outcome="done"), credential.actor)
    return with_session_cookie(request, JSONResponse(_session_json(auth, credential)), opened.secret)


def with_session_cookie(request: Request, response: JSONResponse, secret: str) -> JSONResponse:
    """Set the session cookie; over TLS (a reverse proxy's too, as the Origin shows) with the prefix ``__Host-``."""
    secure = request.url.scheme == "https" or request.headers.get("origin", "").startswith("https://")
    options: Any = {"path": "/", "httponly": True, "samesite": "strict"}
    response.set_cookie(
        COOKIE_NAMES[0 if secure else 1], secret, max_age=int(SESSION_LIFETIME_S), secure=secure, **options
    )
    return response


def _without_session_cookies(response: JSONResponse) -> JSONResponse:
    for name in COOKIE_NAMES:
        response.delete_cookie(name, path="/", httponly=True, samesite="strict", secure=name.startswith("__Host-"))
    return response
