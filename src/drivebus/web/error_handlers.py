"""Every way in which a request can end badly, told in one shape: ``{"error": {code, kind, text, params, …}}``."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

from fastapi import FastAPI
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse

from drivebus.errors import DrivebusError
from drivebus.service.api.errors import build_error_json
from drivebus.service.api.param_errors import params_error, pydantic_faults
from drivebus.web.error_status import error_body, retry_after_header

Json = dict[str, Any]

_log = logging.getLogger(__name__)

_MESSAGE_KEYS = {404: "api.no_such_address", 405: "api.method", 413: "api.too_large", 415: "api.media_type"}


def install_error_handlers(app: FastAPI) -> None:
    """Let errors of the plant, of the framework, and those that nobody foresaw be answered in the one shape."""
    app.add_exception_handler(DrivebusError, _service_error)
    app.add_exception_handler(HTTPException, _http_error)
    app.add_exception_handler(RequestValidationError, _validation_error)
    app.add_exception_handler(Exception, _internal_error)


async def _service_error(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, DrivebusError)
    return _error_response(error_body(error), {"Cache-Control": "no-store"} | retry_after_header(error))


def _error_response(found: Json, headers: Mapping[str, str] | None = None) -> JSONResponse:
    return JSONResponse({"error": found}, found["status"], headers=headers)


async def _validation_error(request: Request, error: Exception) -> JSONResponse:
    """Of a route that lets FastAPI check: told as the plant tells wrong parameters."""
    assert isinstance(error, RequestValidationError)
    return await _service_error(request, params_error(request.url.path, pydantic_faults(error.errors(), skipped=1)))


async def _http_error(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, HTTPException)
    code = _MESSAGE_KEYS.get(error.status_code, "api.refused")
    params = {"method": request.method, "path": request.url.path}
    found = build_error_json(code, "HttpError", params) | {"status": error.status_code}
    return _error_response(found, error.headers)


async def _internal_error(request: Request, error: Exception) -> JSONResponse:
    """Nothing of the inside is shown; the log has it."""
    _log.error("%s %s", request.method, request.url.path, exc_info=error)
    return _error_response(build_error_json("api.unforeseen", "InternalError", {}) | {"status": 500})
