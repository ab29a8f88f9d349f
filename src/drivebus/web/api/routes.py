"""Routes of the API, one for each operation: the service's are forwarded, those of this process have a handler here."""

from __future__ import annotations

import asyncio
import base64
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Iterable, Mapping
from typing import Any

from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse

from drivebus.service.api.operations import Operation
from drivebus.service.ipc.protocol import MAX_MOTION_WAIT_S, late_motion_error
from drivebus.types import Json
from drivebus.web.api.openapi import operation_options
from drivebus.web.api.params import request_params
from drivebus.web.context import actor_of, client_of, context_of
from drivebus.web.route import AccessRouter, Route

NO_STORE = {"Cache-Control": "no-store"}  # a cache must not present a past state as the present one
GatewayHandler = Callable[..., Awaitable[Json | Response]]
"""Handler of an operation of this process: request and validated parameters → JSON or response."""
EXPORT_MEDIA_TYPES = {"csv": "text/csv; charset=utf-8", "parquet": "application/vnd.apache.parquet"}


def service_router(operations: Iterable[Operation]) -> AccessRouter:
    """Return the routes of operations of the service, which forward them."""
    router = AccessRouter()
    for operation in operations:
        handler = _download_handler(operation) if operation.media_types else _forward(operation)
        router.add(Route.of(operation), handler, **operation_options(operation))
    return router


def gateway_router(operations: Iterable[Operation], handlers: Mapping[str, GatewayHandler]) -> AccessRouter:
    """Return the routes of operations of this process. Raises KeyError for one without handler."""
    router = AccessRouter()
    for operation in operations:
        handler = _answer(operation, handlers[operation.name])
        router.add(Route.of(operation), handler, **operation_options(operation))
    return router


def _answer(operation: Operation, handler: GatewayHandler) -> Callable[[Request], Awaitable[Response]]:
    async def handle(request: Request) -> Response:
        result = await handler(request, operation.validate(request_params(operation, request)))
        return result if isinstance(result, Response) else JSONResponse(result, headers=NO_STORE)

    return handle


def _forward(operation: Operation) -> Callable[[Request], Awaitable[Response]]:
    async def handle(request: Request) -> Response:
        """Forward the result of the service as it is. Raises Expired for a motion that may have waited too long."""
        if operation.moves_motors and (pause_s := context_of(request).pauses.recent_pause_s()) > MAX_MOTION_WAIT_S:
            raise late_motion_error(pause_s)
        params = request_params(operation, request)
        operation.validate(params)  # as the service does again: a rejected request never occupies its process
        call = client_of(request).call_json(operation.name, params, actor_of(request))
        payload = await (_until_disconnected(request, call) if operation.cancellable else call)
        return Response(payload, media_type="application/json", headers=NO_STORE)

    return handle


async def _until_disconnected(request: Request, call: Coroutine[Any, Any, bytes]) -> bytes:
    """Return the result of a call; it is cancelled, and nothing returned, when the client disconnects."""
    running, disconnected = asyncio.ensure_future(call), asyncio.ensure_future(_disconnected(request))
    try:
        await asyncio.wait({running, disconnected}, return_when=asyncio.FIRST_COMPLETED)
        return await running if running.done() else b""
    finally:
        running.cancel()
        disconnected.cancel()


async def _disconnected(request: Request) -> None:
    """Wait for the disconnect; the messages before it are the body of a request whose body is not read."""
    while (await request.receive())["type"] != "http.disconnect":
        pass


def _download_handler(operation: Operation) -> Callable[[Request], Awaitable[Response]]:
    async def handle(request: Request) -> Response:
        """Answer the parts one after another, so that a year is never held in memory.

        A failure after the first part cuts the connection: a short file must not pass for a complete one.
        """
        params = request_params(operation, request)
        operation.validate(params)  # as the service does again: a rejected request never occupies its process
        first = await client_of(request).call(operation.name, params, actor_of(request))
        headers = NO_STORE | {"Content-Disposition": f'attachment; filename="{first["file"]}"'}
        media_type = EXPORT_MEDIA_TYPES[params.get("format", "csv")]
        parts = _file_parts(request, operation.name, params, first)
        return StreamingResponse(parts, media_type=media_type, headers=headers)

    return handle


async def _file_parts(request: Request, operation: str, params: Json, part: Json) -> AsyncIterator[bytes]:
    """Yield all parts of a file; each is read with the rights that the user has then."""
    yield _part_bytes(part)
    while part.get("next") is not None:
        part = await client_of(request).call(operation, params | {"cursor": part["next"]}, actor_of(request))
        yield _part_bytes(part)


def _part_bytes(part: Json) -> bytes:
    """Decode a part of a file: CSV is text, Parquet is base64."""
    return base64.b64decode(part["base64"]) if "base64" in part else str(part["text"]).encode()
