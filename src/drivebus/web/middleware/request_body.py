"""Request body: read whole before a route runs, limited in size and time, and parsed once as strict JSON."""

from __future__ import annotations

import asyncio
import re
from typing import Any

from starlette.datastructures import Headers
from starlette.types import Receive

from drivebus.service.api.strict_json import MalformedJson, parse_json
from drivebus.web.errors import BodyTimeout, BodyTooLarge, MalformedBody, UnsupportedMediaType

MAX_BODY_BYTES = 1024 * 1024  # where a right is required; the worst JSON of this size takes 0.3 s to parse
MAX_PUBLIC_BODY_BYTES = 4 * 1024  # where none is; 1 ms
BODY_TIMEOUT_S = 10.0  # from the headers to the last byte

_LENGTH = re.compile("[0-9]{1,9}")


async def read_body(receive: Receive, headers: Headers, max_bytes: int = MAX_BODY_BYTES) -> Any:
    """Return the parsed body; an empty object where there is none.

    Raises BodyTooLarge, BodyTimeout, UnsupportedMediaType, MalformedBody.
    """
    declared = headers.get("content-length", "0")
    if not _LENGTH.fullmatch(declared) or int(declared) > max_bytes:
        raise BodyTooLarge("auth.too_large", largest=max_bytes)
    try:
        async with asyncio.timeout(BODY_TIMEOUT_S):
            body = await _read_all(receive, max_bytes)
    except TimeoutError:
        raise BodyTimeout("auth.too_slow", longest_s=BODY_TIMEOUT_S) from None
    if not body:
        return {}
    _check_type(headers)
    try:
        return parse_json(body)
    except MalformedJson as error:
        if error.duplicates:
            raise MalformedBody("auth.twice", names=tuple(error.duplicates)) from None
        raise MalformedBody("auth.malformed", problem=error.problem) from None


async def _read_all(receive: Receive, max_bytes: int) -> bytes:
    parts, size, more = [], 0, True
    while more:
        message = await receive()
        if message["type"] == "http.disconnect":
            raise MalformedBody("auth.malformed", problem="disconnected")
        parts.append(message.get("body", b""))
        size += len(parts[-1])
        if size > max_bytes:
            raise BodyTooLarge("auth.too_large", largest=max_bytes)
        more = message.get("more_body", False)
    return b"".join(parts)


def _check_type(headers: Headers) -> None:
    kind, _, rest = headers.get("content-type", "").partition(";")
    is_json = kind.strip().lower() == "application/json" and rest.strip().lower() in ("", "charset=utf-8")
    if not is_json or headers.get("content-encoding", "identity") != "identity":
        raise UnsupportedMediaType("auth.not_json", found=headers.get("content-type", ""))
