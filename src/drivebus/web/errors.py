"""Errors as HTTP responses: one JSON shape, the status of each kind, and the headers that belong to it."""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping

from fastapi import FastAPI
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import Send

from drivebus import errors
from drivebus.errors import DrivebusError
from drivebus.service.api.errors import build_error_json, error_to_json
from drivebus.service.auth import errors as auth_errors
from drivebus.service.ipc.service_client import ServiceErrorReply
from drivebus.types import Json

LOG = logging.getLogger(__name__)


class RequestError(DrivebusError):
    """A request that HTTP itself rejects. ``key`` is a sentence of the catalogue ``auth``."""


class BodyTooLarge(RequestError):
    """The body is larger than this route reads."""


class BodyTimeout(RequestError):
    """The body did not arrive in time."""


class UnsupportedMediaType(RequestError):
    """Not ``application/json``, or compressed."""


class MalformedBody(RequestError):
    """Not one JSON document, or one that two parsers could read differently."""


class MethodNotAllowed(RequestError):
    """The path exists, the method does not."""


HTTP_STATUS: tuple[tuple[type[DrivebusError], int], ...] = (
    (BodyTooLarge, 413),
    (BodyTimeout, 408),
    (UnsupportedMediaType, 415),
    (MalformedBody, 422),
    (MethodNotAllowed, 405),
    (auth_errors.NotAuthenticated, 401),
    (auth_errors.Conflict, 409),
    (auth_errors.ResourceNotFound, 404),
    (auth_errors.InvalidInput, 422),
    (auth_errors.TooManyAttempts, 429),
    (auth_errors.AuthUnavailable, 503),
    (auth_errors.AuthError, 403),
    (errors.NotFound, 404),
    (errors.InvalidParameters, 422),
    (errors.PermissionDenied, 403),
    (errors.TooManyCommands, 429),
    (errors.AuditUnavailable, 503),
    (errors.ServiceUnavailable, 503),
    (errors.ServiceError, 409),
    (errors.ConfigurationError, 422),
    (errors.LimitError, 422),
    (errors.CapabilityError, 422),
    (errors.OutcomeUnknown, 504),
    (errors.StopUnconfirmed, 504),
    (errors.DriveRejected, 502),
    (errors.TargetNotReached, 502),
    (errors.DriveError, 409),
    (errors.Expired, 409),
    (errors.Superseded, 409),
    (errors.NotPermitted, 409),
)
"""Status by class, first match wins. The others (protocol, no reply, port) are ``BUS_FAILURE_STATUS``."""
BUS_FAILURE_STATUS = 502

_FRAMEWORK_CODES = {404: "api.no_such_address", 405: "api.method", 413: "api.too_large", 415: "api.media_type"}


def http_status(kind: type[DrivebusError]) -> int:
    """Return the HTTP status of an error class."""
    return next((status for known, status in HTTP_STATUS if issubclass(kind, known)), BUS_FAILURE_STATUS)


def _status_by_name(name: str) -> int:
    kind = getattr(errors, name, errors.ServiceError)
    known = isinstance(kind, type) and issubclass(kind, DrivebusError)
    return http_status(kind if known else errors.ServiceError)


def error_headers(error: DrivebusError) -> dict[str, str]:
    """Return ``Allow`` (RFC 9110, 15.5.6) and ``Retry-After`` in whole seconds, where the error has them."""
    headers = {"Allow": ", ".join(error.params["allowed"])} if "allowed" in error.params else {}
    return headers | _retry_header(error.params)


def _retry_header(params: Json) -> dict[str, str]:
    return {} if params.get("retry_s") is None else {"Retry-After": str(int(params["retry_s"]) + 1)}


async def send_error(send: Send, error: DrivebusError) -> None:
    """Send ``error`` as the response of a request that reaches no route, and close the connection."""
    response = error_response(error)
    response.headers["Connection"] = "close"
    await send({"type": "http.response.start", "status": response.status_code, "headers": response.raw_headers})
    await send({"type": "http.response.body", "body": response.body})


def error_response(error: DrivebusError) -> Response:
    """Return the response to an error of this process; a lone surrogate that it names is escaped, as JSON allows."""
    payload = json.dumps(error_to_json(error), ensure_ascii=False).encode("utf-8", "backslashreplace")
    return _response(payload, http_status(type(error)), error_headers(error))


def _response(payload: bytes, status: int, headers: Mapping[str, str] | None = None) -> Response:
    return Response(b'{"error":' + payload + b"}", status, headers=headers, media_type="application/json")


def install_error_handlers(app: FastAPI) -> None:
    """Answer errors of the service, of this process and of the framework in the one shape."""
    app.add_exception_handler(ServiceErrorReply, _forward_service_error)
    app.add_exception_handler(DrivebusError, _drivebus_error)
    app.add_exception_handler(HTTPException, _framework_error)
    app.add_exception_handler(Exception, _internal_error)


async def _forward_service_error(request: Request, error: Exception) -> Response:
    assert isinstance(error, ServiceErrorReply)
    headers = {"Cache-Control": "no-store", **_retry_header(error.params)}
    return _response(error.payload, _status_by_name(error.kind), headers)


async def _drivebus_error(request: Request, error: Exception) -> Response:
    assert isinstance(error, DrivebusError)
    response = error_response(error)
    response.headers["Cache-Control"] = "no-store"
    return response


async def _framework_error(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    code = _FRAMEWORK_CODES.get(error.status_code, "api.refused")
    body = build_error_json(code, "HttpError", {"method": request.method, "path": request.url.path})
    return _response(json.dumps(body, ensure_ascii=False).encode(), error.status_code, error.headers)


async def _internal_error(request: Request, error: Exception) -> Response:
    """Answer without internals; they are in the log."""
    LOG.error("%s %s", request.method, request.url.path, exc_info=error)
    body = build_error_json("api.unforeseen", "InternalError", {})
    return _response(json.dumps(body, ensure_ascii=False).encode(), 500)
