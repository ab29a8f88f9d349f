"""``make_app``: the page, the API and the door in front of them, as one ASGI app over a ``ServiceClient``."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager

from fastapi import APIRouter, FastAPI
from starlette.middleware import Middleware
from starlette.types import ASGIApp

from drivebus.service.auth.service import AuthService
from drivebus.service.config.model import WebConfig
from drivebus.service.ipc.service_client import ServiceClient
from drivebus.web import error_handlers
from drivebus.web.api import openapi
from drivebus.web.api.routes import api_router
from drivebus.web.live.endpoint import live_router
from drivebus.web.metrics import metrics_router
from drivebus.web.middleware.auth import AuthMiddleware
from drivebus.web.middleware.denial_log import DenialLog
from drivebus.web.middleware.host_check import HostCheck
from drivebus.web.middleware.security_headers import SecurityHeadersMiddleware
from drivebus.web.routes.context import RouteContext
from drivebus.web.routes.session import session_router
from drivebus.web.routes.static_files import static_router
from drivebus.web.routes.users import users_router


class _WebApp(FastAPI):
    """With the headers also on answers to errors that nobody foresaw."""

    def build_middleware_stack(self) -> ASGIApp:
        return SecurityHeadersMiddleware(super().build_middleware_stack())


def make_app(client: ServiceClient, access: AuthService, web: WebConfig, routers: Sequence[APIRouter] = ()) -> FastAPI:
    """``routers`` are further ones of gateways; each of their routes needs its line in ``web.rights``."""
    refusals = DenialLog(client, access.clock)

    @asynccontextmanager
    async def life(_: FastAPI) -> AsyncIterator[None]:
        yield
        await refusals.flush()

    app = _WebApp(
        docs_url=None,
        redoc_url=None,
        openapi_url="/api/v1/openapi.json",
        redirect_slashes=False,
        lifespan=life,
        middleware=[
            Middleware(AuthMiddleware, access=access, hosts=HostCheck(web), refusals=refusals),
        ],
    )
    error_handlers.install_error_handlers(app)
    desk = RouteContext(access, client, refusals)
    for router in (
        session_router(desk),
        users_router(desk),
        static_router(),
        api_router(client),
        live_router(client),
        metrics_router(client),
        *routers,
    ):
        app.include_router(router)
    openapi.install_openapi(app)
    return app
