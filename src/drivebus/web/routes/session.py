"""Logging in and out, the first set-up, one's own password."""

from __future__ import annotations

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import JSONResponse

from drivebus.service.auth.credentials import SessionCredential
from drivebus.web.dependencies import credential_of
from drivebus.web.middleware.auth import client_address
from drivebus.web.middleware.denial_log import try_record
from drivebus.web.routes import schemas
from drivebus.web.routes.context import RouteContext, audit_entry, clear_session_cookies, set_session_cookie


def session_router(desk: RouteContext) -> APIRouter:
    """Under ``/api/v1``."""
    router = APIRouter(prefix="/api/v1", tags=["account"])
    access = desk.access

    @router.get("/health")
    async def health() -> dict[str, bool]:
        return {"ok": True}

    @router.get("/session")
    async def session(request: Request) -> JSONResponse:
        return JSONResponse(desk.session_json(request.state.visitor))

    @router.post("/session/active")
    async def active(request: Request) -> JSONResponse:
        """The page tells that somebody is there (the door has noted it)."""
        return JSONResponse(desk.session_json(request.state.visitor))

    @router.post("/session/wake")
    async def wake(request: Request, body: schemas.UnlockBody) -> JSONResponse:
        """The password again after idle minutes: the same session, with a new cookie."""
        mine = _session_credential(request)
        return await desk.complete_login(request, "wake", access.unlock(mine.session, body.password), mine.session.user)

    @router.post("/setup")
    async def setup(request: Request, body: schemas.SetupBody) -> JSONResponse:
        opening = access.create_first_administrator(
            body.secret, body.name, body.password, client_address(request.scope)
        )
        return await desk.complete_login(request, "set-up", opening, body.name)

    @router.post("/login")
    async def login(request: Request, body: schemas.LoginBody) -> JSONResponse:
        opening = access.login(body.name, body.password, client_address(request.scope))
        return await desk.complete_login(request, "login", opening, body.name)

    @router.post("/login-once")
    async def login_once(request: Request, body: schemas.CodeLoginBody) -> JSONResponse:
        return await desk.complete_login(
            request, "login-once", access.login_with_code(body.code, client_address(request.scope))
        )

    @router.post("/logout")
    async def logout(request: Request) -> JSONResponse:
        mine = _session_credential(request)
        actor = mine.actor
        await access.logout(mine.session)
        await try_record(desk.client, audit_entry("logout", actor.name, outcome="done"), actor)
        return clear_session_cookies(JSONResponse({}))

    @router.post("/logout-everywhere")
    async def logout_everywhere(request: Request) -> JSONResponse:
        mine = _session_credential(request)
        actor = mine.actor
        ended = await access.end_sessions(mine.session.user, "logout")
        await try_record(desk.client, audit_entry("logout", actor.name, {"sessions": ended}, "done"), actor)
        return clear_session_cookies(JSONResponse({"ended": ended}))

    @router.post("/password")
    async def password(request: Request, body: schemas.PasswordBody) -> JSONResponse:
        mine = _session_credential(request)
        changing = access.change_password(mine.session, body.old, body.new)
        opened = await desk.record_change("password", mine.session.user, {}, mine.actor, changing)
        session = SessionCredential(opened.session, access.context)
        return set_session_cookie(request, JSONResponse(desk.session_json(session)), opened.secret)

    return router


def _session_credential(request: Request) -> SessionCredential:
    found = credential_of(request)
    assert isinstance(found, SessionCredential)  # the door lets only sessions through to these routes
    return found
