"""``make_app``: the page, the API and the door in front of them, as one ASGI app over a ``PlantClient``."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager

from fastapi import APIRouter, FastAPI
from starlette.middleware import Middleware
from starlette.types import ASGIApp

from drivebus.gateways import problems
from drivebus.gateways.live.endpoint import live_router
from drivebus.gateways.metrics.router import metrics_router
from drivebus.gateways.rest import openapi
from drivebus.gateways.rest.router import rest_router
from drivebus.plant.access.access import Access
from drivebus.plant.client import PlantClient
from drivebus.plant.model import WebSetting
from drivebus.web.account import account_router
from drivebus.web.desk import Desk
from drivebus.web.door import Guard
from drivebus.web.files import files_router
from drivebus.web.headers import Headers
from drivebus.web.hosts import Hosts
from drivebus.web.people import people_router
from drivebus.web.refused import Refusals


class _App(FastAPI):
    """With the headers also on answers to errors that nobody foresaw."""

    def build_middleware_stack(self) -> ASGIApp:
        return Headers(super().build_middleware_stack())


def make_app(client: PlantClient, access: Access, web: WebSetting, routers: Sequence[APIRouter] = ()) -> FastAPI:
    """``routers`` are further ones of gateways; each of their routes needs its line in ``web.rights``."""
    refusals = Refusals(client, access.clock)

    @asynccontextmanager
    async def life(_: FastAPI) -> AsyncIterator[None]:
        yield
        await refusals.flush()

    app = _App(
        docs_url=None,
        redoc_url=None,
        openapi_url="/api/v1/openapi.json",
        redirect_slashes=False,
        lifespan=life,
        middleware=[
            Middleware(Guard, access=access, hosts=Hosts(web), refusals=refusals),
        ],
    )
    problems.install(app)
    desk = Desk(access, client, refusals)
    for router in (
        account_router(desk),
        people_router(desk),
        files_router(),
        rest_router(client),
        live_router(client),
        metrics_router(client),
        *routers,
    ):
        app.include_router(router)
    openapi.install(app)
    return app
