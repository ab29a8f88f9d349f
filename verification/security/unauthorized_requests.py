"""Requests as strangers send them: every address of the service and many that are none, every method, with credentials
that are missing, forged, spent, or good but sent by another page. None of them may do anything.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from random import Random
from typing import Any

from drivebus.web.app import declared_routes
from drivebus.web.route import WEBSOCKET

ROUTES = declared_routes()
OWN_ORIGIN = "http://127.0.0.1:8080"
HTTP_METHODS = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS", "TRACE", "CONNECT", "BREW")
FOREIGN_ORIGINS = (
    "http://evil.example",
    "null",
    "",
    f"{OWN_ORIGIN}.evil.example",
    "https://127.0.0.1:8080",
    "http://127.0.0.1",
    "http://127.0.0.1:8080@evil.example",
    "file://",
)
FOREIGN_HOSTS = ("evil.example", "127.0.0.1.evil.example", "", "localhost.evil.example:8080")
CONTENT_TYPES = (
    "application/json",
    "application/json; charset=utf-8",
    "text/plain",
    "application/x-www-form-urlencoded",
    "",
    "multipart/form-data; boundary=x",
    "application/json; charset=utf-16",
    "application/xml",
    "image/png",
)
CLIENT_ADDRESSES = ("127.0.0.1", "10.0.0.9", "fe80::1")
BODIES: tuple[Any, ...] = (
    {},
    {"frequency_hz": 50.0},
    {"frequency_hz": 50.0, "arm_token": "x"},
    {"drive": "fan-1"},
    {"how": "stop"},
    {"values": {"F0.1": 1.0}, "save": True},
    {"maximum_hz": 999.0},
    {"reason": "because"},
    {"text": "[plant]"},
    {"name": "eve", "role": "administrator", "password": "correct horse battery"},
    {"role": "administrator"},
    {"name": "administrator", "password": "administrator"},
    {"secret": "x", "name": "eve", "password": "long enough 1"},
    {"code": "x"},
    {"name": "t", "rights": ["view", "operate"], "days": 1},
    {"old": "x", "new": "long enough 1"},
    {"disabled": False, "end_sessions": True},
    [],
    None,
    "x",
    1,
)


@dataclass(frozen=True, slots=True)
class StolenCredentials:
    """Of users who exist: what a stranger may have found or planted."""

    cookie: str
    """A good one: the browser sends it along, whoever made it ask."""
    ended: tuple[str, ...]
    """Of sessions that ended."""
    expired: str
    """A token that was good."""


@dataclass(frozen=True, slots=True)
class UnauthorizedRequest:
    """One request, or handshake."""

    method: str
    path: str
    headers: tuple[tuple[str, str], ...]
    body: bytes
    client: str
    credential: str
    """Which kind, for the report."""

    @property
    def scope(self) -> dict[str, Any]:
        """For the app."""
        is_socket = self.method == WEBSOCKET
        path, _, query = self.path.partition("?")
        return {
            "type": "websocket" if is_socket else "http",
            "asgi": {"version": "3.0"},
            "http_version": "1.1",
            "method": self.method,
            "scheme": "ws" if is_socket else "http",
            "path": path,
            "root_path": "",
            "raw_path": path.encode("utf-8", "replace"),
            "query_string": query.encode(),
            "subprotocols": [],
            "headers": [(name.encode(), value.encode("latin-1", "replace")) for name, value in self.headers],
            "client": (self.client, 40000),
            "server": ("127.0.0.1", 8080),
        }


def random_request(rng: Random, credentials: StolenCredentials) -> UnauthorizedRequest:
    """The next one."""
    method, path = _target(rng)
    kind, more = _credential(rng, credentials)
    headers = {"host": "127.0.0.1:8080", **more, **_misleading_headers(rng)}
    body = _body(rng)
    if method != WEBSOCKET:
        headers["content-type"] = rng.choice(CONTENT_TYPES) if rng.random() < 0.3 else CONTENT_TYPES[0]
    if rng.random() < 0.1:
        headers["host"] = rng.choice(FOREIGN_HOSTS)
    return UnauthorizedRequest(method, path, tuple(headers.items()), body, rng.choice(CLIENT_ADDRESSES), kind)


def _target(rng: Random) -> tuple[str, str]:
    entry = rng.choice(ROUTES)
    path = entry.path
    for place in ("{drive}", "{group}", "{bus}", "{alarm}", "{case}", "{user}", "{token}", "{language}", "{path:path}"):
        path = path.replace(place, rng.choice(("fan-1", "fans", "administrator", "1", "..", "%2e%2e", "a" * 300)))
    method = entry.method if rng.random() < 0.7 else rng.choice((*HTTP_METHODS, WEBSOCKET))
    return method, _malformed_path(rng, path) if rng.random() < 0.2 else path


def _malformed_path(rng: Random, path: str) -> str:
    """An address that looks like one."""
    at = rng.randrange(len(path) + 1)
    bends = ("/", "//", "/./", "/../", ";x=1", "?frequency_hz=50", "%00", "\x00", "％", "\n", "#", "?method=POST")
    return rng.choice((path[:at] + rng.choice(bends) + path[at:], path.upper(), path + "/", "/api/v1" + path))


def _credential(rng: Random, credentials: StolenCredentials) -> tuple[str, dict[str, str]]:
    """A cookie that is good comes with nothing that another page could know, or from an origin that is another's."""
    forged = rng.randbytes(32).hex()
    csrf = {"x-drivebus-csrf": rng.randbytes(24).hex()}
    match rng.randrange(6):
        case 0:
            return "nothing", {}
        case 1:
            return "forged cookie", {"cookie": f"drivebus_session={forged}"} | csrf
        case 2:
            return "forged token", {"authorization": f"Bearer dbt_{forged}"}
        case 3:
            return "spent cookie", {"cookie": f"drivebus_session={rng.choice(credentials.ended)}"} | csrf
        case 4:
            return "expired token", {"authorization": f"Bearer {credentials.expired}"}
    origin = {"origin": rng.choice(FOREIGN_ORIGINS)} if rng.random() < 0.7 else {}
    return "another page", {"cookie": f"drivebus_session={credentials.cookie}"} | origin


def _misleading_headers(rng: Random) -> dict[str, str]:
    """What some servers believe."""
    claims: tuple[dict[str, str], ...] = (
        {},
        {},
        {},
        {"x-forwarded-for": "127.0.0.1"},
        {"x-http-method-override": "POST"},
        {"x-user": "administrator"},
        {"x-original-url": "/api/v1/stop"},
        {"x-forwarded-host": "127.0.0.1:8080"},
        {"content-encoding": "gzip"},
        {"upgrade": "websocket"},
        {"transfer-encoding": "chunked"},
        {"x-remote-user": "administrator"},
    )
    return rng.choice(claims)


def _body(rng: Random) -> bytes:
    match rng.randrange(8):
        case 0:
            return b""
        case 1:
            return rng.randbytes(rng.randrange(200))
        case 2:
            return b"frequency_hz=50&arm_token=x"
        case 3:
            return b"[" * rng.choice((10, 10_000))
    return json.dumps(rng.choice(BODIES)).encode()
