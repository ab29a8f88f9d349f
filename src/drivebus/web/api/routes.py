"""The routes: one handler for each line of the table. The door found out who asks; what is asked is handed over."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response

from drivebus.service.ipc.service_client import ServiceClient
from drivebus.service.runtime.fairness import encode_json_cooperatively
from drivebus.web.api import descriptions, export
from drivebus.web.api.params import request_params
from drivebus.web.api.table import API_PREFIX, API_ROUTES, ApiRoute
from drivebus.web.dependencies import actor_of


def api_router(plant: ServiceClient) -> APIRouter:
    """Every operation of the plant under ``/api/v1``; errors leave as exceptions (``problems`` answers them)."""
    router = APIRouter(prefix=API_PREFIX)
    for route in API_ROUTES:
        router.add_api_route(
            route.path,
            _handler(route, plant),
            methods=[route.method],
            name=route.name,
            operation_id=route.name.replace(".", "_"),
            **descriptions.route_options(route),
        )
    return router


def _handler(route: ApiRoute, plant: ServiceClient) -> Callable[[Request], Awaitable[Response]]:
    async def answer(request: Request) -> Response:
        params = await request_params(route, request)
        if route.name == "history.export":
            return await export.export_response(plant, params, actor_of(request))
        body = await encode_json_cooperatively(await plant.call(route.name, params, actor_of(request)))
        return Response(body, media_type="application/json", headers=NO_STORE)

    return answer


NO_STORE = {"Cache-Control": "no-store"}
"""What a plant did a moment ago must not come out of a cache as what it does now (G17)."""
