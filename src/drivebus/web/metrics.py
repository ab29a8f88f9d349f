"""The address ``/metrics``."""

from __future__ import annotations

import asyncio

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response

from drivebus.service.auth.actor import Actor
from drivebus.service.ipc.service_client import ServiceClient
from drivebus.web.dependencies import actor_of
from drivebus.web.metrics_exposition import exposition
from drivebus.web.metrics_points import ScrapeData, metric_points

METRICS_PATH = "/metrics"


def metrics_router(plant: ServiceClient) -> APIRouter:
    """``GET /metrics``. A plant that does not answer is an error of the scrape: nothing old is shown (G17)."""
    router = APIRouter()

    async def metrics(request: Request) -> Response:
        told = await fetch_scrape_data(plant, actor_of(request))
        accept = request.headers.get("accept", "")
        body, media_type = await asyncio.to_thread(lambda: exposition(metric_points(told), accept))
        return Response(body, headers={"Content-Type": media_type, "Cache-Control": "no-store"})

    router.add_api_route(METRICS_PATH, metrics, name="metrics", include_in_schema=False)
    return router


async def fetch_scrape_data(plant: ServiceClient, who: Actor) -> ScrapeData:
    """The plant now. Raises whatever the plant raises."""
    names = ("plant.get", "plant.statistics", "drives.list", "buses.list", "alarms.list")
    whole, statistics, drives, buses, alarms = await asyncio.gather(*(plant.call(name, {}, who) for name in names))
    return ScrapeData(whole, statistics, drives["drives"], buses["buses"], alarms["active"])
