"""Handlers of the operations on one's own account: set-up, login, logout, unlocking, password."""

from __future__ import annotations

from collections.abc import Awaitable
from typing import Any

from starlette.requests import Request
from starlette.responses import JSONResponse

from drivebus.errors import DrivebusError
from drivebus.service.api.audit_aggregator import try_record
from drivebus.service.api.errors import localized
from drivebus.service.api.handlers import handles
from drivebus.service.api.operations import Operation
from drivebus.service.api.operations.operation import NoParams
from drivebus.service.auth.actor import Actor
from drivebus.service.auth.credentials import Credential, SessionCredential
from drivebus.service.auth.devices import device_cookie_name
from drivebus.service.auth.errors import AccessDenied, TooManyAttempts
from drivebus.service.auth.rights import Right
from drivebus.service.auth.service import LoginResult
from drivebus.service.auth.sessions import SESSION_IDLE_TIMEOUT_S, SESSION_LIFETIME_S
from drivebus.service.live.views import text_json
from drivebus.types import Json
from drivebus.web.context import WebContext, audit_entry, context_of, credential_of
from drivebus.web.middleware.auth import COOKIE_NAMES, client_address, request_cookies, session_cookie
from drivebus.web.operations.account import (
    LOGIN,
    LOGIN_CODE,
    LOGOUT,
    PASSWORD,
    SESSION_ACTIVITY,
    SESSION_END,
    SESSION_GET,
    SESSIONS_LIST,
    SET_UP,
    UNLOCK,
    CodeLoginParams,
    LoginParams,
    LogoutParams,
    PasswordParams,
    SessionParams,
    SetUpParams,
    UnlockParams,
)

DEVICE_COOKIE_LIFETIME_S = 365 * 86_400


@handles(SESSION_GET)
async def get_session(request: Request, params: NoParams) -> Json:
    context, credential = context_of(request), request.state.credential
    content = _session_json(context, credential)
    secret = session_cookie(request.headers, uses_tls=request.state.uses_tls)
    if credential is None and secret and (reason := context.auth.sessions.end_reason(secret)):
        content["ended"] = localized(f"auth.closed.{reason}")
    return content


@handles(SESSION_ACTIVITY)
async def report_activity(request: Request, params: NoParams) -> Json:
    """Keep the session from becoming idle; the middleware has recorded the activity."""
    return _session_json(context_of(request), request.state.credential)


@handles(UNLOCK)
async def unlock(request: Request, params: UnlockParams) -> JSONResponse:
    """Give an idle session its rights back for the password; it gets a new cookie."""
    session = _session_credential(request).session
    unlocking = context_of(request).auth.unlock(session, params.password)
    return await _complete_login(request, UNLOCK, unlocking, session.user)


@handles(SET_UP)
async def set_up(request: Request, params: SetUpParams) -> JSONResponse:
    """Create the first administrator."""
    auth, address = context_of(request).auth, client_address(request.scope)
    creating = auth.create_first_administrator(params.secret, params.name, params.password, address)
    return await _complete_login(request, SET_UP, creating, params.name)


@handles(LOGIN)
async def login(request: Request, params: LoginParams) -> JSONResponse:
    cookie = _device_cookie(request, params.name)
    opening = context_of(request).auth.login(params.name, params.password, client_address(request.scope), cookie)
    return await _complete_login(request, LOGIN, opening, params.name)


@handles(LOGIN_CODE)
async def login_with_code(request: Request, params: CodeLoginParams) -> JSONResponse:
    opening = context_of(request).auth.login_with_code(params.code, client_address(request.scope))
    return await _complete_login(request, LOGIN_CODE, opening)


@handles(LOGOUT)
async def logout(request: Request, params: LogoutParams) -> JSONResponse:
    """End the session, with ``all`` every session of the user."""
    context, credential = context_of(request), _session_credential(request)
    actor = credential.actor
    if params.all:
        ended = await context.auth.end_sessions(credential.session.user, "logout")
        entry = audit_entry(LOGOUT.name, actor.name, {"sessions": ended}, outcome="done")
    else:
        await context.auth.logout(credential.session)
        ended, entry = 1, audit_entry(LOGOUT.name, actor.name, outcome="done")
    await try_record(context.client, entry, actor)
    return _without_session_cookies(JSONResponse({"ended": ended}))


@handles(PASSWORD)
async def change_password(request: Request, params: PasswordParams) -> JSONResponse:
    """Change one's own password; every other session of the user ends."""
    context, credential = context_of(request), _session_credential(request)
    changing = context.auth.change_password(credential.session, params.old, params.new)
    opened = await context.record_change(
        PASSWORD, credential.session.user, {}, credential.actor, changing, withdraws=True
    )
    session = SessionCredential(opened.session, context.auth.context)
    response = JSONResponse(_session_json(context, session))
    return _with_session_cookie(request, response, opened.secret)


@handles(SESSIONS_LIST)
async def list_sessions(request: Request, params: NoParams) -> Json:
    auth, own = context_of(request).auth, _session_credential(request).session
    now, now_ms = auth.clock(), auth.wall_ms()
    return {
        "sessions": [
            {
                "id": session.id,
                "address": session.address,
                "opened_ms": now_ms - round(1000 * (now - session.opened)),
                "active_ms": now_ms - round(1000 * (now - session.active)),
                "current": session is own,
            }
            for session in auth.sessions.open_sessions(own.user, now)
        ]
    }


@handles(SESSION_END)
async def end_session(request: Request, params: SessionParams) -> Json:
    """End a session of the same user; another user's is answered as one that does not exist."""
    context, credential = context_of(request), _session_credential(request)
    try:
        await context.auth.end_session(credential.session, params.session, params.password)
    except (AccessDenied, TooManyAttempts) as error:
        await _record_denial(request, SESSION_END, error, credential.session.user)
        raise
    entry = audit_entry(SESSION_END.name, params.session, outcome="done")
    await try_record(context.client, entry, credential.actor)
    return {}


def _session_credential(request: Request) -> SessionCredential:
    credential = credential_of(request)
    assert isinstance(credential, SessionCredential)  # the middleware lets nothing else through to these routes
    return credential


def _session_json(context: WebContext, credential: Credential | None) -> Json:
    """Return the user, rights and CSRF token; ``setup`` is true while there is no administrator."""
    auth = context.auth
    missing = localized("auth.users_missing", {"file": auth.user_file.path.name}) if auth.users_missing else None
    content: Json = {"setup": auth.needs_setup, "users_missing": missing, "user": None, "rights": [], "csrf": None}
    if context.login_notice is not None:
        content["login_notice"] = text_json(context.login_notice)
    if credential is None:
        return content
    actor = credential.actor
    rights = [right for right in Right if right in actor.rights]  # in their order, from reading to administering
    content |= {"user": actor.name, "rights": rights, "session": actor.session}
    if not isinstance(credential, SessionCredential):
        return content
    session, now = credential.session, auth.clock()
    if session.failed_logins:
        content["failed_logins"] = session.failed_logins
    return content | {
        "role": str(auth.database.user(session.user).role),
        "csrf": session.csrf,
        "idle": credential.is_idle,
        "idle_in_s": round(max(0.0, session.active + SESSION_IDLE_TIMEOUT_S - now), 1),
        "expires_in_s": round(max(0.0, session.opened + SESSION_LIFETIME_S - now), 1),
    }


async def _complete_login(
    request: Request, operation: Operation, login: Awaitable[LoginResult], name: str = ""
) -> JSONResponse:
    """Run ``login``; its session replaces the one of the request. Raises AuthError, recorded as a denial."""
    context = context_of(request)
    auth = context.auth
    try:
        opened = await login
    except DrivebusError as error:
        await _record_denial(request, operation, error, name)
        raise
    previous: Credential | None = request.state.credential
    if isinstance(previous, SessionCredential) and previous.session is not opened.session:
        previous.session.end("replaced")
        await auth.save_sessions()
    credential = SessionCredential(opened.session, auth.context)
    await try_record(context.client, audit_entry(operation.name, opened.session.user, outcome="done"), credential.actor)
    response = _with_session_cookie(request, JSONResponse(_session_json(context, credential)), opened.secret)
    return _with_device_cookie(request, response, opened.session.user)


async def _record_denial(request: Request, operation: Operation, error: DrivebusError, name: str) -> None:
    """Record a denial under the name of the account; a flood of other names must not flood the audit trail."""
    context = context_of(request)
    recorded = "" if isinstance(error, TooManyAttempts) else name
    user = context.auth.database.find(recorded)
    actor = Actor("" if user is None else user.name, frozenset(), "", address=client_address(request.scope))
    await context.aggregator.record_denial(operation.name, recorded, error.key, actor)


def _with_session_cookie(request: Request, response: JSONResponse, secret: str) -> JSONResponse:
    """Set the session cookie; over TLS with the prefix ``__Host-``."""
    _set_cookie(request, response, COOKIE_NAMES[0 if request.state.uses_tls else 1], secret, int(SESSION_LIFETIME_S))
    return response


def _with_device_cookie(request: Request, response: JSONResponse, user: str) -> JSONResponse:
    """Set the device cookie of a user who has just logged in; over TLS with the prefix ``__Host-``."""
    cookie = context_of(request).auth.devices.issue(user, _device_cookie(request, user))
    _set_cookie(request, response, _device_cookie_name(request, user), cookie, DEVICE_COOKIE_LIFETIME_S)
    return response


def _device_cookie(request: Request, user: str) -> str:
    return request_cookies(request.headers).get(_device_cookie_name(request, user), "")


def _device_cookie_name(request: Request, user: str) -> str:
    return ("__Host-" if request.state.uses_tls else "") + device_cookie_name(user)


def _set_cookie(request: Request, response: JSONResponse, name: str, value: str, lifetime_s: int) -> None:
    options: Any = {"path": "/", "httponly": True, "samesite": "strict", "secure": request.state.uses_tls}
    response.set_cookie(name, value, max_age=lifetime_s, **options)


def _without_session_cookies(response: JSONResponse) -> JSONResponse:
    for name in COOKIE_NAMES:
        response.delete_cookie(name, path="/", httponly=True, samesite="strict", secure=name.startswith("__Host-"))
    return response
