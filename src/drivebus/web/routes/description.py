"""Handlers of the operations that describe the gateway and the plant to programs."""

from __future__ import annotations

import asyncio
from http import HTTPStatus

from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from drivebus.service.api.handlers import handles
from drivebus.service.api.operations.operation import NoParams
from drivebus.service.auth.rights import Right
from drivebus.types import Json
from drivebus.web.context import actor_of, client_of, context_of, credential_of
from drivebus.web.metrics import exposition, fetch_scrape_data, metric_points
from drivebus.web.operations.description import HEALTH_GET, METRICS_GET, OPENAPI_GET


@handles(HEALTH_GET)
async def get_health(request: Request, params: NoParams) -> Response:
    """Answer whether the service answers. A stranger on the network learns no name of a file."""
    write_failures = await context_of(request).health.write_failures()
    if write_failures is None:
        return JSONResponse({"ok": False}, HTTPStatus.SERVICE_UNAVAILABLE)
    answer = {"ok": True, "write_failure_count": len(write_failures)}
    credential = credential_of(request)
    may_view = credential is not None and credential.actor.may(Right.VIEW)
    return JSONResponse(answer | ({"write_failures": write_failures} if may_view else {}))


@handles(OPENAPI_GET)
async def get_openapi(request: Request, params: NoParams) -> Json:
    """Answer the description; its first one takes a second, so that it is made in a thread, beside any stop."""
    document: Json = await asyncio.to_thread(request.app.openapi)
    return document


@handles(METRICS_GET)
async def get_metrics(request: Request, params: NoParams) -> Response:
    """Answer a scrape. A service that does not answer is an error of the scrape: nothing old is shown."""
    data = await fetch_scrape_data(client_of(request), actor_of(request))
    accept = request.headers.get("accept", "")
    body, media_type = await asyncio.to_thread(lambda: exposition(metric_points(data), accept))
    return Response(body, headers={"Content-Type": media_type, "Cache-Control": "no-store"})
