"""``make_app``: the page, the API and the middleware in front of them, as one ASGI app over a ``ServiceClient``."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import cache

from fastapi import FastAPI
from starlette.middleware import Middleware
from starlette.types import ASGIApp

from drivebus.service.api.audit_aggregator import AuditAggregator
from drivebus.service.api.handlers import bound_handlers
from drivebus.service.api.operations import OPERATIONS
from drivebus.service.auth.service import AuthService
from drivebus.service.ipc.service_client import ServiceClient
from drivebus.web.api.openapi import install_openapi
from drivebus.web.api.routes import gateway_router, service_router
from drivebus.web.context import WebContext
from drivebus.web.errors import install_error_handlers
from drivebus.web.gateway import WebConfig
from drivebus.web.live import endpoint as live
from drivebus.web.live.endpoint import LiveEndpoint
from drivebus.web.loop_pauses import LoopPauses
from drivebus.web.middleware.auth import AuthMiddleware
from drivebus.web.middleware.head import HeadMiddleware
from drivebus.web.middleware.host_check import HostCheck
from drivebus.web.middleware.security_headers import SecurityHeadersMiddleware
from drivebus.web.middleware.trusted_proxies import TrustedProxies
from drivebus.web.operations import WEB_OPERATIONS
from drivebus.web.route import AccessRouter, Route, RouteTable
from drivebus.web.routes import description, session, static_files, users
from drivebus.web.service_health import ServiceHealth
from drivebus.web.session_end import SessionEndWatch


class _WebApp(FastAPI):
    """FastAPI app with the security headers, and HEAD without body, also on responses to unexpected errors."""

    def build_middleware_stack(self) -> ASGIApp:
        return SecurityHeadersMiddleware(HeadMiddleware(super().build_middleware_stack()))


EXEMPT_ROUTERS = (static_files.router, live.router)
"""Routers of the routes that are no operations: files of the page, and the WebSocket."""
HANDLERS = bound_handlers((description, session, users))
"""Handlers of the operations of this process."""


@cache
def routers() -> tuple[AccessRouter, ...]:
    """Return the routers of every app; making the models of all operations takes about 0.3 s."""
    return (
        *EXEMPT_ROUTERS,
        gateway_router(WEB_OPERATIONS.values(), HANDLERS),
        service_router(OPERATIONS.values()),
    )


def declared_routes() -> list[Route]:
    """Return every route of the app with the access that it requires."""
    return [route for router in routers() for route in router.routes]


def make_app(client: ServiceClient, auth: AuthService, web: WebConfig) -> FastAPI:
    """Return the app of the page and the API."""
    aggregator = AuditAggregator(client, auth.clock)
    end_watch = SessionEndWatch(client)
    pauses = LoopPauses()

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        measuring = asyncio.create_task(pauses.run(), name="loop pauses")
        yield
        measuring.cancel()
        await end_watch.close()
        await aggregator.close()

    table = RouteTable(declared_routes())
    app = _WebApp(
        routes=[route for router in routers() for route in router.fastapi.routes],
        docs_url=None,
        redoc_url=None,
        openapi_url=None,
        redirect_slashes=False,
        lifespan=lifespan,
        middleware=[
            Middleware(
                AuthMiddleware,
                auth=auth,
                hosts=HostCheck(web),
                proxies=TrustedProxies(web.trusted_proxies),
                aggregator=aggregator,
                routes=table,
                end_watch=end_watch,
            )
        ],
    )
    app.state.context = WebContext(
        auth=auth,
        client=client,
        aggregator=aggregator,
        health=ServiceHealth(client),
        pauses=pauses,
        login_notice=web.login_notice,
    )
    app.state.live = LiveEndpoint(client)
    install_error_handlers(app)
    install_openapi(app)
    return app
