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
from drivebus.plant.access.refusals import retry_after
from drivebus.plant.failure import failure, told
from drivebus.plant.params import of_pydantic, refusal

Json = dict[str, Any]

_log = logging.getLogger(__name__)

_KNOWN = {404: "api.no_such_address", 405: "api.method", 413: "api.too_large", 415: "api.media_type"}


def install(app: FastAPI) -> None:
    """Let errors of the plant, of the framework, and those that nobody foresaw be answered in the one shape."""
    app.add_exception_handler(DrivebusError, _of_plant)
    app.add_exception_handler(HTTPException, _of_framework)
    app.add_exception_handler(RequestValidationError, _wrong_body)
    app.add_exception_handler(Exception, _unforeseen)


async def _of_plant(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, DrivebusError)
    return _answer(failure(error), {"Cache-Control": "no-store"} | retry_after(error))


def _answer(found: Json, headers: Mapping[str, str] | None = None) -> JSONResponse:
    return JSONResponse({"error": found}, found["status"], headers=headers)


async def _wrong_body(request: Request, error: Exception) -> JSONResponse:
    """Of a route that lets FastAPI check: told as the plant tells wrong parameters."""
    assert isinstance(error, RequestValidationError)
    return await _of_plant(request, refusal(request.url.path, of_pydantic(error.errors(), skipped=1)))


async def _of_framework(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, HTTPException)
    code = _KNOWN.get(error.status_code, "api.refused")
    params = {"method": request.method, "path": request.url.path}
    return _answer(told(code, "HttpError", params, error.status_code), error.headers)


async def _unforeseen(request: Request, error: Exception) -> JSONResponse:
    """Nothing of the inside is shown; the log has it."""
    _log.error("%s %s", request.method, request.url.path, exc_info=error)
    return _answer(told("api.unforeseen", "InternalError", {}, 500))
