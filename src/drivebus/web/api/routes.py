"""Routes of the API: one for each operation of the service, and the description of all."""

from __future__ import annotations

import base64
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable

from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse

from drivebus.service.api.operations import API_PREFIX, Operation
from drivebus.service.auth.actor import Actor
from drivebus.service.auth.rights import Right
from drivebus.service.ipc.service_client import ServiceClient
from drivebus.types import Json
from drivebus.web.api.openapi import operation_options
from drivebus.web.api.params import request_params
from drivebus.web.context import actor_of, client_of
from drivebus.web.route import AccessRouter

NO_STORE = {"Cache-Control": "no-store"}  # a cache must not present a past state as the present one
EXPORT_MEDIA_TYPES = {"csv": "text/csv; charset=utf-8", "parquet": "application/vnd.apache.parquet"}


def api_router(operations: Iterable[Operation]) -> AccessRouter:
    """Return the routes of the operations under ``/api/v1``."""
    router = AccessRouter(API_PREFIX)
    for operation in operations:
        router.add(
            operation.method,
            operation.path,
            _download_handler(operation) if operation.download else _handler(operation),
            access=operation.right,
            background=operation.background,
            name=operation.name,
            **operation_options(operation),
        )
    router.add("GET", "/openapi.json", _openapi, access=Right.VIEW, include_in_schema=False)
    return router


def _handler(operation: Operation) -> Callable[[Request], Awaitable[Response]]:
    async def handle(request: Request) -> Response:
        """Forward the result of the service as it is."""
        params = request_params(operation, request)
        payload = await client_of(request).call_json(operation.name, params, actor_of(request))
        return Response(payload, media_type="application/json", headers=NO_STORE)

    return handle


def _download_handler(operation: Operation) -> Callable[[Request], Awaitable[Response]]:
    async def handle(request: Request) -> Response:
        """Answer the parts one after another, so that a year is never held in memory. A failure after the first part
        cuts the connection: a short file must not pass for a complete one.
        """
        params = request_params(operation, request)
        client, actor = client_of(request), actor_of(request)
        first = await client.call(operation.name, params, actor)
        headers = NO_STORE | {"Content-Disposition": f'attachment; filename="{first["file"]}"'}
        media_type = EXPORT_MEDIA_TYPES[params.get("format", "csv")]
        parts = _file_parts(client, operation.name, params, actor, first)
        return StreamingResponse(parts, media_type=media_type, headers=headers)

    return handle


async def _file_parts(
    client: ServiceClient, operation: str, params: Json, actor: Actor, part: Json
) -> AsyncIterator[bytes]:
    yield _part_bytes(part)
    while part.get("next") is not None:
        part = await client.call(operation, params | {"cursor": part["next"]}, actor)
        yield _part_bytes(part)


def _part_bytes(part: Json) -> bytes:
    """Decode a part of a file: CSV is text, Parquet is base64."""
    return base64.b64decode(part["base64"]) if "base64" in part else str(part["text"]).encode()


async def _openapi(request: Request) -> Response:
    return JSONResponse(request.app.openapi(), headers=NO_STORE)
