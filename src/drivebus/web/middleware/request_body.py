"""A request's body, read whole before any route sees it: small, in time, JSON, and with one meaning only (S14, T19)."""

from __future__ import annotations

import asyncio
import json
import re
from typing import Any, NoReturn

from starlette.datastructures import Headers
from starlette.types import Message, Receive

from drivebus.web.error_status import RequestError

MAX_BODY_BYTES, MAX_PUBLIC_BODY_BYTES = 1024 * 1024, 4 * 1024
"""Octets: where a right is needed, and where none is. The worst JSON of so much takes 0.3 s and 1 ms to read (S14)."""
BODY_TIMEOUT_S = 10.0
"""From the headers to the last byte."""

_LENGTH = re.compile("[0-9]{1,9}")


class BodyTooLarge(RequestError):
    """More than is read of this visitor."""

    status = 413


class BodyTimeout(RequestError):
    """The body did not come in time."""

    status = 408


class UnsupportedMediaType(RequestError):
    """Another content type, or packed."""

    status = 415


class MalformedBody(RequestError):
    """Not one JSON document, or one that two readers could read in two ways."""

    status = 422


async def read_body(receive: Receive, headers: Headers, max_bytes: int = MAX_BODY_BYTES) -> bytes:
    """Read and check a body. Raises BodyTooLarge, BodyTimeout, UnsupportedMediaType, MalformedBody."""
    declared = headers.get("content-length", "0")
    if not _LENGTH.fullmatch(declared) or int(declared) > max_bytes:
        raise BodyTooLarge("access.too_large", largest=max_bytes)
    try:
        async with asyncio.timeout(BODY_TIMEOUT_S):
            body = await _read_all(receive, max_bytes)
    except TimeoutError:
        raise BodyTimeout("access.too_slow", longest_s=BODY_TIMEOUT_S) from None
    if body:
        _check_type(headers)
        _check(body)
    return body


def replay_body(body: bytes, receive: Receive) -> Receive:
    """A ``receive`` that gives the body once, then what really comes."""
    waiting = [body]

    async def again() -> Message:
        if waiting:
            return {"type": "http.request", "body": waiting.pop()}
        return await receive()

    return again


async def _read_all(receive: Receive, largest: int) -> bytes:
    parts, size, more = [], 0, True
    while more:
        message = await receive()
        if message["type"] == "http.disconnect":
            raise MalformedBody("access.malformed", problem="disconnected")
        parts.append(message.get("body", b""))
        size += len(parts[-1])
        if size > largest:
            raise BodyTooLarge("access.too_large", largest=largest)
        more = message.get("more_body", False)
    return b"".join(parts)


def _check_type(headers: Headers) -> None:
    kind, _, rest = headers.get("content-type", "").partition(";")
    fits = kind.strip().lower() == "application/json" and rest.strip().lower() in ("", "charset=utf-8")
    if not fits or headers.get("content-encoding", "identity") != "identity":
        raise UnsupportedMediaType("access.not_json", found=headers.get("content-type", ""))


def _check(body: bytes) -> None:
    try:
        json.loads(body.decode("utf-8"), object_pairs_hook=_reject_duplicate_keys, parse_constant=_reject_constant)
    except (ValueError, RecursionError) as error:
        raise MalformedBody("access.malformed", problem=type(error).__name__) from None


def _reject_duplicate_keys(pairs: list[tuple[str, Any]]) -> None:
    """Two values under one name: readers differ in which they take."""
    if len({name for name, _ in pairs}) != len(pairs):
        raise MalformedBody("access.twice", names=", ".join(sorted(name for name, _ in pairs)))


def _reject_constant(name: str) -> NoReturn:
    """NaN and Infinity are no JSON."""
    raise ValueError(name)
