"""Request body: read whole before a route runs, limited in size and time, and parsed once as strict JSON."""

from __future__ import annotations

import asyncio
import json
import math
import re
from typing import Any

from starlette.datastructures import Headers
from starlette.types import Receive

from drivebus.types import Json
from drivebus.web.errors import BodyTimeout, BodyTooLarge, MalformedBody, UnsupportedMediaType

MAX_BODY_BYTES = 1024 * 1024  # where a right is required; the worst JSON of this size takes 0.3 s to parse
MAX_PUBLIC_BODY_BYTES = 4 * 1024  # where none is; 1 ms
BODY_TIMEOUT_S = 10.0  # from the headers to the last byte

_LENGTH = re.compile("[0-9]{1,9}")
_MAX_EXACT_INTEGER = 2**53  # a double holds every whole number below it


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
    return parse_json(body)


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


def parse_json(body: bytes) -> Any:
    """Parse one JSON document in UTF-8 (RFC 8259): no name twice in an object, no NaN, no float beyond a double.

    JSON has one kind of number, so 60.0 is the integer 60. Raises MalformedBody.
    """
    try:
        return json.loads(
            body.decode("utf-8"),
            object_pairs_hook=_object,
            parse_constant=_reject_number,
            parse_float=_parse_float,
        )
    except (ValueError, RecursionError) as error:
        raise MalformedBody("auth.malformed", problem=type(error).__name__) from None


def _object(pairs: list[tuple[str, Any]]) -> Json:
    found = dict(pairs)
    if len(found) != len(pairs):
        raise MalformedBody("auth.twice", names=", ".join(sorted(name for name, _ in pairs)))
    return found


def _reject_number(text: str) -> float:
    raise MalformedBody("auth.malformed", problem=text[:40])


def _parse_float(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        return _reject_number(text)
    return int(value) if value.is_integer() and abs(value) < _MAX_EXACT_INTEGER else value
