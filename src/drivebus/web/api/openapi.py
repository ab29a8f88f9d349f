"""The description of the whole API, ``/api/v1/openapi.json``: what FastAPI finds, and how one comes in."""

from __future__ import annotations

from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from drivebus.web.api.descriptions import STATUS_MEANINGS
from drivebus.web.api.table import API_PREFIX, API_ROUTES

Json = dict[str, Any]

API_TITLE = "drivebus"
API_VERSION = "1"
"""Of the API, not of the program: it changes when something that was promised goes away."""
COOKIE_SCHEME, TOKEN_SCHEME, CSRF_SCHEME = "session", "token", "csrf"

SECURITY_SCHEMES: Json = {
    COOKIE_SCHEME: {
        "type": "apiKey",
        "in": "cookie",
        "name": "drivebus_session",
        "description": "From POST /login. `__Host-drivebus` where the service speaks TLS.",
    },
    CSRF_SCHEME: {
        "type": "apiKey",
        "in": "header",
        "name": "X-Drivebus-CSRF",
        "description": "From GET /session; beside the cookie on everything but GET.",
    },
    TOKEN_SCHEME: {"type": "http", "scheme": "bearer", "description": "A token of this service, from POST /tokens."},
}


def openapi_document(app: FastAPI) -> Json:
    """The OpenAPI document of an app that has the routes."""
    found = get_openapi(
        title=API_TITLE, version=API_VERSION, routes=app.routes, summary="One plant of drives on many buses"
    )
    parts = found.setdefault("components", {})
    parts["securitySchemes"] = SECURITY_SCHEMES
    for name in _UNUSED_SCHEMAS:
        parts.get("schemas", {}).pop(name, None)
    known = {(API_PREFIX + route.path, route.method.lower()) for route in API_ROUTES}
    for path, operations in found["paths"].items():
        for method, operation in operations.items():
            operation["responses"] = operation["responses"] | _error_responses()
            operation["security"] = _security(method, by_token=(path, method) in known)
    return found


_UNUSED_SCHEMAS = ("HTTPValidationError", "ValidationError")
"""FastAPI's own shape of an error, which nobody gets here."""


def _error_responses() -> Json:
    content = {"application/json": {"schema": {"$ref": "#/components/schemas/Problem"}}}
    return {str(code): {"description": why, "content": content} for code, why in STATUS_MEANINGS.items()}


def _security(method: str, *, by_token: bool) -> list[Json]:
    """How one comes in: with a token, or with a cookie and, where something may change, the page's own header."""
    cookie: Json = {COOKIE_SCHEME: []} if method == "get" else {COOKIE_SCHEME: [], CSRF_SCHEME: []}
    return [{TOKEN_SCHEME: []}, cookie] if by_token else [cookie, {TOKEN_SCHEME: []}, {}]


def install_openapi(app: FastAPI) -> None:
    """Let the app tell the whole description; made once."""
    made: list[Json] = []

    def openapi() -> Json:
        if not made:
            made.append(openapi_document(app))
        return made[0]

    app.openapi = openapi  # type: ignore[method-assign]
