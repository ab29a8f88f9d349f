"""The description of the whole API, ``/api/v1/openapi.json``: what FastAPI finds, and how one comes in."""

from __future__ import annotations

from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from drivebus.gateways.rest.described import ERRORS
from drivebus.gateways.rest.table import PREFIX, ROUTES

Json = dict[str, Any]

TITLE = "drivebus"
VERSION = "1"
"""Of the API, not of the program: it changes when something that was promised goes away."""
COOKIE, TOKEN, CSRF = "session", "token", "csrf"

SCHEMES: Json = {
    COOKIE: {
        "type": "apiKey", "in": "cookie", "name": "drivebus_session",
        "description": "From POST /login. `__Host-drivebus` where the service speaks TLS.",
    },
    CSRF: {
        "type": "apiKey", "in": "header", "name": "X-Drivebus-CSRF",
        "description": "From GET /session; beside the cookie on everything but GET.",
    },
    TOKEN: {"type": "http", "scheme": "bearer", "description": "A token of this service, from POST /tokens."},
}  # fmt: skip


def describe(app: FastAPI) -> Json:
    """The OpenAPI document of an app that has the routes."""
    found = get_openapi(title=TITLE, version=VERSION, routes=app.routes, summary="One plant of drives on many buses")
    parts = found.setdefault("components", {})
    parts["securitySchemes"] = SCHEMES
    for name in _NOT_OURS:
        parts.get("schemas", {}).pop(name, None)
    known = {(PREFIX + route.path, route.method.lower()) for route in ROUTES}
    for path, operations in found["paths"].items():
        for method, operation in operations.items():
            operation["responses"] = operation["responses"] | _problems()
            operation["security"] = _ways(method, by_token=(path, method) in known)
    return found


_NOT_OURS = ("HTTPValidationError", "ValidationError")
"""FastAPI's own shape of an error, which nobody gets here."""


def _problems() -> Json:
    content = {"application/json": {"schema": {"$ref": "#/components/schemas/Problem"}}}
    return {str(code): {"description": why, "content": content} for code, why in ERRORS.items()}


def _ways(method: str, *, by_token: bool) -> list[Json]:
    """How one comes in: with a token, or with a cookie and, where something may change, the page's own header."""
    cookie: Json = {COOKIE: []} if method == "get" else {COOKIE: [], CSRF: []}
    return [{TOKEN: []}, cookie] if by_token else [cookie, {TOKEN: []}, {}]


def install(app: FastAPI) -> None:
    """Let the app tell the whole description; made once."""
    made: list[Json] = []

    def openapi() -> Json:
        if not made:
            made.append(describe(app))
        return made[0]

    app.openapi = openapi  # type: ignore[method-assign]
