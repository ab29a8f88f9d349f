"""The page's files, from ``static`` and ``vendor``, and the sentences of a language; packed, with an ETag."""

from __future__ import annotations

import gzip
import hashlib
import json
from functools import lru_cache
from pathlib import Path

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response

from drivebus import i18n
from drivebus.service.auth.errors import ResourceNotFound

WEB_DIRECTORY = Path(__file__).parents[1]
MEDIA_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".mjs": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".json": "application/json",
    ".svg": "image/svg+xml",
    ".png": "image/png",
    ".woff2": "font/woff2",
    ".txt": "text/plain; charset=utf-8",
}
"""Told by the ending, never guessed; what is not here is not served."""


def static_router() -> APIRouter:
    """``/``, ``/static``, ``/vendor``, ``/i18n``."""
    router = APIRouter(include_in_schema=False)

    @router.get("/")
    async def page(request: Request) -> Response:
        return _file_response(request, WEB_DIRECTORY / "static", "index.html")

    @router.get("/static/{path:path}")
    async def static(request: Request, path: str) -> Response:
        return _file_response(request, WEB_DIRECTORY / "static", path)

    @router.get("/vendor/{path:path}")
    async def vendor(request: Request, path: str) -> Response:
        return _file_response(request, WEB_DIRECTORY / "vendor", path)

    @router.get("/i18n/{language}.json")
    async def sentences(request: Request, language: str) -> Response:
        if language not in i18n.LANGUAGES:
            raise ResourceNotFound("access.no_such_address")
        return _cached_response(request, _catalogue_json(language), MEDIA_TYPES[".json"])

    return router


@lru_cache
def _catalogue_json(language: str) -> bytes:
    return json.dumps(i18n.catalogue(language), ensure_ascii=False, separators=(",", ":")).encode()


def _file_response(request: Request, folder: Path, name: str) -> Response:
    """Raises ResourceNotFound for what is not below ``folder`` or of no known kind."""
    try:
        path = (folder / name).resolve()
        fits = path.is_relative_to(folder) and path.is_file() and path.suffix in MEDIA_TYPES
    except (OSError, ValueError):
        fits = False
    if not fits:
        raise ResourceNotFound("access.no_such_address")
    return _cached_response(request, _read_file(path, path.stat().st_mtime_ns), MEDIA_TYPES[path.suffix])


@lru_cache(maxsize=256)
def _read_file(path: Path, changed_ns: int) -> bytes:
    """``changed_ns`` so that a changed file is read again."""
    return path.read_bytes()


@lru_cache(maxsize=256)
def _compress(content: bytes) -> tuple[str, bytes]:
    """ETag and gzip form."""
    return '"' + hashlib.sha256(content).hexdigest()[:32] + '"', gzip.compress(content, 6, mtime=0)


def _cached_response(request: Request, content: bytes, kind: str) -> Response:
    tag, packed = _compress(content)
    headers = {"etag": tag, "vary": "accept-encoding"}
    if request.headers.get("if-none-match") == tag:
        return Response(status_code=304, headers=headers)
    if "gzip" in request.headers.get("accept-encoding", ""):
        return Response(packed, headers=headers | {"content-encoding": "gzip"}, media_type=kind)
    return Response(content, headers=headers, media_type=kind)
