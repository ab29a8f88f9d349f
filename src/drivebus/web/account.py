"""Logging in and out, the first set-up, one's own password."""

from __future__ import annotations

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import JSONResponse

from drivebus.gateways.door import visitor
from drivebus.plant.access.visitor import BySession
from drivebus.web import given
from drivebus.web.desk import Desk, entry, with_cookie, without_cookie
from drivebus.web.door import address
from drivebus.web.refused import tell


def account_router(desk: Desk) -> APIRouter:
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
    async def wake(request: Request, body: given.Wake) -> JSONResponse:
        """The password again after idle minutes: the same session, with a new cookie."""
        mine = _mine(request)
        return await desk.let_in(request, "wake", access.wake(mine.session, body.password), mine.session.user)

    @router.post("/setup")
    async def setup(request: Request, body: given.SetUp) -> JSONResponse:
        opening = access.set_up(body.secret, body.name, body.password, address(request.scope))
        return await desk.let_in(request, "set-up", opening, body.name)

    @router.post("/login")
    async def login(request: Request, body: given.Login) -> JSONResponse:
        opening = access.login(body.name, body.password, address(request.scope))
        return await desk.let_in(request, "login", opening, body.name)

    @router.post("/login-once")
    async def login_once(request: Request, body: given.LoginOnce) -> JSONResponse:
        return await desk.let_in(request, "login-once", access.login_once(body.code, address(request.scope)))

    @router.post("/logout")
    async def logout(request: Request) -> JSONResponse:
        mine = _mine(request)
        actor = mine.actor
        await access.log_out(mine.session)
        await tell(desk.client, entry("logout", actor.name, outcome="done"), actor)
        return without_cookie(JSONResponse({}))

    @router.post("/logout-everywhere")
    async def logout_everywhere(request: Request) -> JSONResponse:
        mine = _mine(request)
        actor = mine.actor
        ended = await access.end_all(mine.session.user, "logout")
        await tell(desk.client, entry("logout", actor.name, {"sessions": ended}, "done"), actor)
        return without_cookie(JSONResponse({"ended": ended}))

    @router.post("/password")
    async def password(request: Request, body: given.NewPassword) -> JSONResponse:
        mine = _mine(request)
        changing = access.new_password(mine.session, body.old, body.new)
        opened = await desk.change("password", mine.session.user, {}, mine.actor, changing)
        session = BySession(opened.session, access.around)
        return with_cookie(request, JSONResponse(desk.session_json(session)), opened.secret)

    return router


def _mine(request: Request) -> BySession:
    found = visitor(request)
    assert isinstance(found, BySession)  # the door lets only sessions through to these routes
    return found
