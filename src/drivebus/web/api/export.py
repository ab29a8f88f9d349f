"""``/history/export``: the parts that the plant hands out one after another, as one file."""

from __future__ import annotations

import base64
from collections.abc import AsyncIterator
from typing import Any

from starlette.responses import Response, StreamingResponse

from drivebus.service.auth.actor import Actor
from drivebus.service.ipc.service_client import ServiceClient

Json = dict[str, Any]

EXPORT_MEDIA_TYPES = {"csv": "text/csv; charset=utf-8", "parquet": "application/vnd.apache.parquet"}


async def export_response(plant: ServiceClient, params: Json, actor: Actor) -> Response:
    """The file, part by part, so that a year never stands in memory. What is wrong with the first part is an answer
    of its own; a later failure cuts the connection, so that a short file can't pass for a whole one.
    """
    first = await plant.call("history.export", params, actor)
    kind = EXPORT_MEDIA_TYPES[params.get("format", "csv")]
    name = {"Content-Disposition": f'attachment; filename="{first["file"]}"', "Cache-Control": "no-store"}
    return StreamingResponse(_file_parts(plant, params, actor, first), media_type=kind, headers=name)


async def _file_parts(plant: ServiceClient, params: Json, actor: Actor, part: Json) -> AsyncIterator[bytes]:
    yield _part_bytes(part)
    while part.get("next") is not None:
        part = await plant.call("history.export", params | {"cursor": part["next"]}, actor)
        yield _part_bytes(part)


def _part_bytes(part: Json) -> bytes:
    """CSV comes as text, Parquet as base64."""
    return base64.b64decode(part["base64"]) if "base64" in part else str(part["text"]).encode()
