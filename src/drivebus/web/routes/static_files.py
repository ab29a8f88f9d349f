"""Files of the page, from ``static`` and ``vendor``, and the texts of a language; compressed, with an ETag."""

from __future__ import annotations

import gzip
import hashlib
import re
from functools import lru_cache
from pathlib import Path

from starlette.requests import Request
from starlette.responses import Response

from drivebus import i18n
from drivebus.service.auth.errors import ResourceNotFound
from drivebus.service.auth.rights import AccessLevel
from drivebus.web.route import AccessRouter

WEB_DIRECTORY = Path(__file__).resolve().parents[1]  # the paths that it is compared with are resolved
MEDIA_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".json": "application/json",
    ".svg": "image/svg+xml",
    ".txt": "text/plain; charset=utf-8",
}
"""Media type by file name extension, never by content; a file with another extension is not served."""

COMMAND_LINE_TEXTS = frozenset(
    {
        "acceptance",
        "alarms.motion",
        "alarms.remedy",
        "alarms.text",
        "alarms.title",
        "audit",
        "bus_stop",
        "capture",
        "cli",
        "comm_loss_test",
        "control",
        "decode",
        "demo",
        "dry",
        "explain",
        "expression",
        "grades",
        "help",
        "hint",
        "history",
        "hold_ramp",
        "jog",
        "live",
        "log",
        "metrics",
        "models",
        "monitor",
        "outcome",
        "params",
        "plant_check",
        "plant_config",
        "plant_init",
        "ports_command",
        "profile_new",
        "profiles.expected",
        "profiles.kind",
        "profiles.remedy",
        "profiles.toml",
        "profiles.type",
        "read",
        "record",
        "register_table",
        "release",
        "run",
        "scan",
        "serve",
        "service",
        "sim",
        "simulate",
        "status",
        "stop_all",
        "system",
        "user_command",
        "waive",
    }
)
"""Groups of texts that only the command line and the service use; the page does not load them, and gets the texts of an
alarm or a rejected file with it."""

FIRST_MODULES = ("static/js/app.js", "static/js/pages/fleet.js")
"""Scripts whose imports every visit needs before the first drive is shown."""
STATIC_IMPORT = re.compile(r"""(?:^|[;}])(?:import|export)\b[^;"'`()]*?["'](\.[^"'\n]+)["']""", re.MULTILINE)

router = AccessRouter()


@router.exempt("GET", "/", access=AccessLevel.PUBLIC)
async def page(request: Request) -> Response:
    index = WEB_DIRECTORY / "static" / "index.html"
    return _cached_response(request, _page_with_preloads(index, index.stat().st_mtime_ns), MEDIA_TYPES[".html"])


@lru_cache(maxsize=2)
def _page_with_preloads(index: Path, changed_ns: int) -> bytes:
    """Return the page with a ``modulepreload`` of every first script.

    Without it the browser finds each level of imports only after it has loaded the level before.
    """
    links = "".join(f'    <link rel="modulepreload" href="/{name}">\n' for name in first_modules())
    return _read_file(index, changed_ns).replace(b"  </head>", links.encode() + b"  </head>")


def first_modules() -> list[str]:
    """Return ``FIRST_MODULES`` and what they import statically, nearest first, as paths below the server's root."""
    modules = list(FIRST_MODULES)
    for name in modules:
        script = WEB_DIRECTORY / name
        for other in STATIC_IMPORT.findall(script.read_text("utf-8")):
            path = (script.parent / other).resolve().relative_to(WEB_DIRECTORY).as_posix()
            if path not in modules:
                modules.append(path)
    return modules


@router.exempt("GET", "/static/{path:path}", access=AccessLevel.PUBLIC)
async def static(request: Request, path: str) -> Response:
    return _file_response(request, WEB_DIRECTORY / "static", path)


@router.exempt("GET", "/vendor/{path:path}", access=AccessLevel.PUBLIC)
async def vendor(request: Request, path: str) -> Response:
    return _file_response(request, WEB_DIRECTORY / "vendor", path)


@router.exempt("GET", "/i18n/{language}.json", access=AccessLevel.PUBLIC)
async def texts(request: Request, language: str) -> Response:
    if language not in i18n.LANGUAGES:
        raise ResourceNotFound("auth.no_such_address")
    return _cached_response(request, i18n.catalogue_json(language, COMMAND_LINE_TEXTS), MEDIA_TYPES[".json"])


def _file_response(request: Request, folder: Path, name: str) -> Response:
    """Return a file of a folder. Raises ResourceNotFound for a path outside it or an unknown extension."""
    try:
        path = (folder / name).resolve()
        is_served = path.is_relative_to(folder) and path.is_file() and path.suffix in MEDIA_TYPES
    except (OSError, ValueError):
        is_served = False
    if not is_served:
        raise ResourceNotFound("auth.no_such_address")
    return _cached_response(request, _read_file(path, path.stat().st_mtime_ns), MEDIA_TYPES[path.suffix])


@lru_cache(maxsize=256)
def _read_file(path: Path, changed_ns: int) -> bytes:
    """Return the content of a file; ``changed_ns`` is part of the cache's key, so that a changed one is read again."""
    return path.read_bytes()


@lru_cache(maxsize=256)
def _compress(content: bytes) -> tuple[str, bytes]:
    """Return the ETag and the gzip form."""
    return '"' + hashlib.sha256(content).hexdigest()[:32] + '"', gzip.compress(content, 6, mtime=0)


def _cached_response(request: Request, content: bytes, media_type: str) -> Response:
    tag, compressed = _compress(content)
    headers = {"etag": tag, "vary": "accept-encoding"}
    if request.headers.get("if-none-match") == tag:
        return Response(status_code=304, headers=headers)
    if "gzip" in request.headers.get("accept-encoding", ""):
        return Response(compressed, headers=headers | {"content-encoding": "gzip"}, media_type=media_type)
    return Response(content, headers=headers, media_type=media_type)
