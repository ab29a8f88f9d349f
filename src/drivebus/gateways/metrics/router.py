"""The address ``/metrics``."""

from __future__ import annotations

import asyncio

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response

from drivebus.gateways.door import actor
from drivebus.gateways.metrics.exposition import text
from drivebus.gateways.metrics.points import Told, points
from drivebus.plant.actor import Actor
from drivebus.plant.client import PlantClient

PATH = "/metrics"


def metrics_router(plant: PlantClient) -> APIRouter:
    """``GET /metrics``. A plant that does not answer is an error of the scrape: nothing old is shown (G17)."""
    router = APIRouter()

    async def metrics(request: Request) -> Response:
        told = await asked(plant, actor(request))
        accept = request.headers.get("accept", "")
        body, media_type = await asyncio.to_thread(lambda: text(points(told), accept))
        return Response(body, headers={"Content-Type": media_type, "Cache-Control": "no-store"})

    router.add_api_route(PATH, metrics, name="metrics", include_in_schema=False)
    return router


async def asked(plant: PlantClient, who: Actor) -> Told:
    """The plant now. Raises whatever the plant raises."""
    names = ("plant.get", "plant.statistics", "drives.list", "buses.list", "alarms.list")
    whole, statistics, drives, buses, alarms = await asyncio.gather(*(plant.call(name, {}, who) for name in names))
    return Told(whole, statistics, drives["drives"], buses["buses"], alarms["active"])
