"""The routes: one handler for each line of the table. The door found out who asks; what is asked is handed over."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response

from drivebus.gateways.door import actor
from drivebus.gateways.rest import described, export
from drivebus.gateways.rest.asked import params_of
from drivebus.gateways.rest.table import PREFIX, ROUTES, Route
from drivebus.plant.client import PlantClient
from drivebus.plant.turns import encoded


def rest_router(plant: PlantClient) -> APIRouter:
    """Every operation of the plant under ``/api/v1``; errors leave as exceptions (``problems`` answers them)."""
    router = APIRouter(prefix=PREFIX)
    for route in ROUTES:
        router.add_api_route(
            route.path,
            _handler(route, plant),
            methods=[route.method],
            name=route.name,
            operation_id=route.name.replace(".", "_"),
            **described.of(route),
        )
    return router


def _handler(route: Route, plant: PlantClient) -> Callable[[Request], Awaitable[Response]]:
    async def answer(request: Request) -> Response:
        params = await params_of(route, request)
        if route.name == "history.export":
            return await export.download(plant, params, actor(request))
        body = await encoded(await plant.call(route.name, params, actor(request)))
        return Response(body, media_type="application/json", headers=NEVER_STORED)

    return answer


NEVER_STORED = {"Cache-Control": "no-store"}
"""What a plant did a moment ago must not come out of a cache as what it does now (G17)."""
