"""``unauthorized``: requests without valid credentials at every path of the service.

The app is the real one; the service behind it only counts calls. A trial is one request, or one WebSocket handshake
with a message after it.
"""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Any

from drivebus.errors import ServiceUnavailable
from drivebus.service.api.operations.plant import PLANT_GET
from drivebus.service.auth.actor import Actor
from drivebus.service.auth.rights import AccessLevel, Right, Role
from drivebus.service.auth.service import AuthService
from drivebus.service.auth.sessions import SESSION_LIFETIME_S, secret_digest
from drivebus.service.auth.users import Token
from drivebus.testing.virtual_time import run
from drivebus.types import Json
from drivebus.web.app import declared_routes, make_app
from drivebus.web.gateway import WebConfig
from drivebus.web.route import WEBSOCKET, RouteTable
from drivebus.web.service_health import HEALTH_ACTOR
from verification.campaign import Campaign, CampaignRun

# --- requests ---------------------------------------------------------------------------------------------------------

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
    {"values": {"F0.1": 1.0}, "save": True, "force": True},
    {"maximum_hz": 999.0},
    {"reason": "because"},
    {"text": "[plant]"},
    {"name": "eve", "role": "administrator", "password": "correct horse battery"},
    {"role": "administrator"},
    {"name": "administrator", "password": "administrator"},
    {"secret": "x", "name": "eve", "password": "long enough 1"},
    {"code": "x"},
    {"name": "t", "rights": ["view", "stop", "operate"], "days": 1},
    {"old": "x", "new": "long enough 1"},
    {"disabled": False, "end_sessions": True},
    [],
    None,
    "x",
    1,
)


@dataclass(frozen=True, slots=True)
class StolenCredentials:
    """Credentials of an existing user that an attacker may hold."""

    cookie: str
    """Cookie of a valid session, which a browser sends with requests of any page."""
    ended: tuple[str, ...]
    """Cookies of ended and expired sessions."""
    expired: str
    """Expired API token."""


@dataclass(frozen=True, slots=True, kw_only=True)
class UnauthorizedRequest:
    """HTTP request or WebSocket handshake."""

    method: str
    path: str
    headers: tuple[tuple[str, str], ...]
    body: bytes
    client: str
    credential: str
    """Kind of credential, for the report."""

    @property
    def scope(self) -> dict[str, Any]:
        """The ASGI scope of the request."""
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
    """Return a request with a random target, credential, header and body."""
    method, path = _target(rng)
    kind, more = _credential(rng, credentials)
    headers = {"host": "127.0.0.1:8080", **more, **_misleading_headers(rng)}
    body = _body(rng)
    if method != WEBSOCKET:
        headers["content-type"] = rng.choice(CONTENT_TYPES) if rng.random() < 0.3 else CONTENT_TYPES[0]
    if rng.random() < 0.1:
        headers["host"] = rng.choice(FOREIGN_HOSTS)
    return UnauthorizedRequest(
        method=method,
        path=path,
        headers=tuple(headers.items()),
        body=body,
        client=rng.choice(CLIENT_ADDRESSES),
        credential=kind,
    )


def _target(rng: Random) -> tuple[str, str]:
    entry = rng.choice(ROUTES)
    path = entry.path
    for parameter in re.findall(r"\{[^}]+\}", path):
        path = path.replace(parameter, rng.choice(("fan-1", "fans", "administrator", "1", "..", "%2e%2e", "a" * 300)))
    method = entry.method if rng.random() < 0.7 else rng.choice((*HTTP_METHODS, WEBSOCKET))
    return method, _malformed_path(rng, path) if rng.random() < 0.2 else path


def _malformed_path(rng: Random, path: str) -> str:
    """Return a path that resembles the given one."""
    at = rng.randrange(len(path) + 1)
    insertions = ("/", "//", "/./", "/../", ";x=1", "?frequency_hz=50", "%00", "\x00", "％", "\n", "#", "?method=POST")
    return rng.choice((path[:at] + rng.choice(insertions) + path[at:], path.upper(), path + "/", "/api/v1" + path))


def _credential(rng: Random, credentials: StolenCredentials) -> tuple[str, dict[str, str]]:
    """Return the kind of a credential and its headers.

    A valid cookie comes without the CSRF token, which another page cannot read, or from a foreign origin.
    """
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
    """Return a header that some servers and proxies trust."""
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


# --- campaign ---------------------------------------------------------------------------------------------------------

REQUEST_INTERVAL_S = 0.02
"""Virtual time between two requests, in seconds: the login throttle covers an hour of them."""
TEST_PASSWORD = "a pass phrase for the campaign"


class CallCountingService:
    """Service that executes nothing and counts the calls that reach it."""

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.refused = 0
        """Refusals that were recorded in the audit trail."""

    async def call(self, operation: str, params: Json, actor: Actor) -> Json:
        self.calls.append(operation)
        raise ServiceUnavailable("plant.gone")

    async def call_json(self, operation: str, params: Json, actor: Actor) -> bytes:
        if (operation, actor) != (PLANT_GET.name, HEALTH_ACTOR):  # the gateway's own request behind the health check
            self.calls.append(operation)
        return b"{}"

    async def live(self, patterns: Sequence[str], actor: Actor, interval_s: float = 0.25) -> AsyncIterator[Json]:
        self.calls.append("live")
        yield {"type": "snapshot", "seq": 1, "time_ms": 0, "topics": {}}

    async def record(self, entry: Json, actor: Actor) -> None:
        self.refused += entry["params"].get("times", 0)

    async def end_control(self, reason: str, actor: Actor) -> None:
        return


class UnauthorizedClient:
    """The web app with one administrator, and a client that has no valid credentials."""

    def __init__(self, campaign_run: CampaignRun, folder: Path) -> None:
        self.campaign_run = campaign_run
        self.now = 0.0
        self.service = CallCountingService()
        self.auth = AuthService(folder, clock=lambda: self.now, wall_ms=lambda: round(self.now * 1000))
        self.app = make_app(self.service, self.auth, WebConfig())

    async def send_requests(self) -> None:
        """Send random requests until the budget is spent."""
        credentials = await self._create_users()
        database, session_ids = self.auth.database, self._session_ids()
        rng = self.campaign_run.rng("requests")
        while self.campaign_run.remaining:
            request = random_request(rng, credentials)
            self.now += REQUEST_INTERVAL_S
            await self._send(request)
            if (self.auth.database, self._session_ids()) != (database, session_ids):
                self.campaign_run.violation(f"{request} changed users, tokens or sessions")
            self.campaign_run.add_trials()
        self.campaign_run.figures["refusals recorded or counted"] = self.service.refused > 0

    async def _create_users(self) -> StolenCredentials:
        """Create an administrator with a valid, an ended and an expired session, and an expired token."""
        user = await self.auth.new_user("administrator", Role.ADMINISTRATOR, TEST_PASSWORD)
        token = Token(
            id="t",
            name="old",
            user=user.name,
            rights=tuple(Right),
            digest=secret_digest("dbt_old"),
            created_ms=0,
            expires_ms=1,
        )
        await self.auth.change_database(lambda register: register.with_user(user).with_token(token))
        expired = await self.auth.login(user.name, TEST_PASSWORD, "local")
        self.now += SESSION_LIFETIME_S
        ended = await self.auth.login(user.name, TEST_PASSWORD, "local")
        await self.auth.logout(ended.session)
        valid = await self.auth.login(user.name, TEST_PASSWORD, "local")
        return StolenCredentials(valid.secret, (expired.secret, ended.secret), "dbt_old")

    def _session_ids(self) -> set[str]:
        return {session.id for session in self.auth.sessions.stored()}

    async def _send(self, request: UnauthorizedRequest) -> None:
        try:
            status = await _send_to_app(self.app, request)
        except Exception as error:
            self.campaign_run.violation(f"{request} broke the app: {error!r}")
            return
        self.campaign_run.trace(f"{request.method} {request.path!r} {request.credential} {len(request.body)}: {status}")
        self.campaign_run.count(f"{request.credential}, answered {status}")
        if request.method == WEBSOCKET:
            self.campaign_run.count("handshakes")
        if self.service.calls and not _is_cross_origin_read(request):
            self.campaign_run.violation(f"{request} reached {self.service.calls}")
        self.service.calls.clear()
        routes = RouteTable(ROUTES).match(request.path.partition("?")[0])
        method = "GET" if request.method == "HEAD" else request.method
        public = any(route.access is AccessLevel.PUBLIC and route.method == method for route in routes)
        if status in (101, 200, 204) and not public and not _is_cross_origin_read(request):
            self.campaign_run.violation(f"{request} was answered {status}")


def _is_cross_origin_read(request: UnauthorizedRequest) -> bool:
    """Return whether a page of another origin reads with the user's cookie.

    The browser keeps the response from that page (no CORS header), and GET and HEAD change nothing.
    """
    return request.credential == "another page" and request.method in ("GET", "HEAD")


async def _send_to_app(app: Any, request: UnauthorizedRequest) -> int:
    """Return the status of the response; for a handshake 101 or 403."""
    incoming: list[Any] = [{"type": "http.request", "body": request.body, "more_body": False}]
    if request.scope["type"] == "websocket":
        text = request.body.decode("latin-1")
        incoming = [{"type": "websocket.connect"}, {"type": "websocket.receive", "text": text}]
    statuses: list[int] = []

    async def receive() -> Any:
        if incoming:
            return incoming.pop(0)
        await asyncio.sleep(0.01)
        return {"type": request.scope["type"] + ".disconnect", "code": 1000}

    async def send(message: Any) -> None:
        handshake = {"websocket.accept": 101, "websocket.close": 403}
        statuses.append(message.get("status", handshake.get(message["type"], 0)))

    await app(request.scope, receive, send)
    return statuses[0]


def send_all(campaign_run: CampaignRun) -> None:
    """Send every request of the budget to one app."""
    with TemporaryDirectory() as folder:
        run(UnauthorizedClient(campaign_run, Path(folder)).send_requests())


CAMPAIGN = Campaign(
    name="unauthorized",
    summary={
        "en": "Requests without valid credentials at every path of the service.",
        "zh": "在服务的每个路径上发送没有有效凭据的请求。",
    },
    unit="requests",
    evidence_for=(),
    full_budget=120_000,
    ci_budget=1_000,
    run=send_all,
)
