"""A request's body, read whole before any route sees it: small, in time, JSON, and with one meaning only (S14, T19)."""

from __future__ import annotations

import asyncio
import json
import re
from typing import Any, NoReturn

from starlette.datastructures import Headers
from starlette.types import Message, Receive

from drivebus.plant.access.refusals import AccessError

LARGEST, OF_ANYBODY = 1024 * 1024, 4 * 1024
"""Octets: where a right is needed, and where none is. The worst JSON of so much takes 0.3 s and 1 ms to read (S14)."""
LONGEST_S = 10.0
"""From the headers to the last byte."""

_LENGTH = re.compile("[0-9]{1,9}")


class TooLarge(AccessError):
    """More than is read of this visitor."""

    status = 413


class TooSlow(AccessError):
    """The body did not come in time."""

    status = 408


class NotJson(AccessError):
    """Another content type, or packed."""

    status = 415


class Malformed(AccessError):
    """Not one JSON document, or one that two readers could read in two ways."""

    status = 422


async def read(receive: Receive, headers: Headers, largest: int = LARGEST) -> bytes:
    """The body of at most so many octets, checked. Raises TooLarge, TooSlow, NotJson, Malformed."""
    declared = headers.get("content-length", "0")
    if not _LENGTH.fullmatch(declared) or int(declared) > largest:
        raise TooLarge("access.too_large", largest=largest)
    try:
        async with asyncio.timeout(LONGEST_S):
            body = await _whole(receive, largest)
    except TimeoutError:
        raise TooSlow("access.too_slow", longest_s=LONGEST_S) from None
    if body:
        _check_type(headers)
        _check(body)
    return body


def replayed(body: bytes, receive: Receive) -> Receive:
    """A ``receive`` that gives the body once, then what really comes."""
    waiting = [body]

    async def again() -> Message:
        if waiting:
            return {"type": "http.request", "body": waiting.pop()}
        return await receive()

    return again


async def _whole(receive: Receive, largest: int) -> bytes:
    parts, size, more = [], 0, True
    while more:
        message = await receive()
        if message["type"] == "http.disconnect":
            raise Malformed("access.malformed", problem="disconnected")
        parts.append(message.get("body", b""))
        size += len(parts[-1])
        if size > largest:
            raise TooLarge("access.too_large", largest=largest)
        more = message.get("more_body", False)
    return b"".join(parts)


def _check_type(headers: Headers) -> None:
    kind, _, rest = headers.get("content-type", "").partition(";")
    fits = kind.strip().lower() == "application/json" and rest.strip().lower() in ("", "charset=utf-8")
    if not fits or headers.get("content-encoding", "identity") != "identity":
        raise NotJson("access.not_json", found=headers.get("content-type", ""))


def _check(body: bytes) -> None:
    try:
        json.loads(body.decode("utf-8"), object_pairs_hook=_once, parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise Malformed("access.malformed", problem=type(error).__name__) from None


def _once(pairs: list[tuple[str, Any]]) -> None:
    """Two values under one name: readers differ in which they take."""
    if len({name for name, _ in pairs}) != len(pairs):
        raise Malformed("access.twice", names=", ".join(sorted(name for name, _ in pairs)))


def _no_constant(name: str) -> NoReturn:
    """NaN and Infinity are no JSON."""
    raise ValueError(name)
