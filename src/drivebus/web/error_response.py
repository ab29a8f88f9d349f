"""Answers that are given before any route is reached, in the one shape of errors."""

from __future__ import annotations

import json
from typing import Any

from starlette.types import Send

from drivebus.errors import DrivebusError
from drivebus.service.auth.errors import AuthError
from drivebus.web.error_status import error_body, http_status

HeaderList = tuple[tuple[bytes, bytes], ...]


async def send_error(send: Send, error: AuthError, *more: tuple[bytes, bytes]) -> None:
    """``error`` as JSON with its own status; the connection closes, whatever of the request is still to come."""
    body = json.dumps({"error": error_body(error)}, ensure_ascii=False).encode()
    headers: HeaderList = (
        (b"content-type", b"application/json"),
        (b"content-length", str(len(body)).encode()),
        *allow_header(error),
        *more,
    )
    await send({"type": "http.response.start", "status": http_status(error), "headers": list(headers)})
    await send({"type": "http.response.body", "body": body})


def allow_header(error: DrivebusError) -> HeaderList:
    """The methods that the address has, where the one asked for is not among them (RFC 9110, 15.5.6)."""
    allowed: Any = error.params.get("allowed")
    return () if allowed is None else ((b"allow", str(allowed).encode()),)
