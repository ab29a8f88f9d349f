"""``doors``: strangers at every address of the service; nothing of what they send may do anything.

The app is the real one with its door; behind it stands a plant that only counts. A trial is one request, or one
WebSocket handshake with a message after it.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from drivebus.errors import ServiceUnavailable
from drivebus.service.auth.actor import Actor
from drivebus.testing.virtual_time import run
from drivebus.types import Json
from verification.campaign import Campaign, CampaignRun

if TYPE_CHECKING:
    from drivebus.service.auth.service import AuthService
    from verification.security.unauthorized_requests import StolenCredentials, UnauthorizedRequest

STEP_S = 0.02
"""Between two requests: the throttle sees an hour of them."""
TEST_PASSWORD = "a pass phrase of the laboratory"


class CountingService:
    """A plant that does nothing but count what came through the door."""

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.refused = 0

    async def call(self, operation: str, params: Json, actor: Actor) -> Json:
        self.calls.append(operation)
        raise ServiceUnavailable("plant.gone")

    async def call_json(self, operation: str, params: Json, actor: Actor) -> bytes:
        self.calls.append(operation)
        return b"{}"

    async def live(self, patterns: Sequence[str], actor: Actor, interval_s: float = 0.25) -> AsyncIterator[Json]:
        """The page's one subscription would be heard; no stranger ever begins one."""
        self.calls.append("live")
        yield {"type": "snapshot", "seq": 1, "time_ms": 0, "topics": {}}

    async def record(self, entry: Json, actor: Actor) -> None:
        self.refused += entry["params"].get("times", 0)


class UnauthorizedClients:
    """The app, and who stands before it."""

    def __init__(self, session: CampaignRun, folder: Path) -> None:
        from drivebus.service.auth.service import AuthService
        from drivebus.web.app import make_app
        from drivebus.web.gateway import WebConfig

        self.session = session
        self.now = 0.0
        self.plant = CountingService()
        self.access: AuthService = AuthService(folder, clock=lambda: self.now, wall_ms=lambda: round(self.now * 1000))
        self.app = make_app(self.plant, self.access, WebConfig())

    async def send_requests(self) -> None:
        """Strangers, until the budget is spent."""
        from verification.security.unauthorized_requests import random_request

        credentials = await self._create_users()
        before = self.access.database, self.access.sessions.stored()
        rng = self.session.rng("strangers")
        while self.session.remaining:
            stranger = random_request(rng, credentials)
            self.now += STEP_S
            await self._send(stranger, before)
            self.session.add_trials()
        self.session.figures["refusals told to the audit trail or counted"] = self.plant.refused > 0

    async def _create_users(self) -> StolenCredentials:
        """An administrator, with a session that is good, one that was ended, one too old, and a token too old."""
        from drivebus.service.auth.rights import Right, Role
        from drivebus.service.auth.sessions import SESSION_LIFETIME_S, secret_digest
        from drivebus.service.auth.users import Token
        from verification.security.unauthorized_requests import StolenCredentials

        user = await self.access.new_user("administrator", Role.ADMINISTRATOR, TEST_PASSWORD)
        token = Token("t", "old", user.name, tuple(Right), secret_digest("dbt_old"), 0, 1)
        await self.access.change(lambda register: register.with_user(user).with_token(token))
        old = await self.access.login(user.name, TEST_PASSWORD, "local")
        self.now += SESSION_LIFETIME_S
        ended = await self.access.login(user.name, TEST_PASSWORD, "local")
        await self.access.logout(ended.session)
        good = await self.access.login(user.name, TEST_PASSWORD, "local")
        return StolenCredentials(good.secret, (old.secret, ended.secret), "dbt_old")

    async def _send(self, stranger: UnauthorizedRequest, before: tuple[Any, Any]) -> None:
        from drivebus.web.route import WEBSOCKET, AccessLevel, RouteTable
        from verification.security.unauthorized_requests import ROUTES

        try:
            answer = await _send_to_app(self.app, stranger)
        except Exception as error:  # whatever it is: a stranger must not be able to
            self.session.violation(f"{stranger} broke the app: {error!r}")
            return
        self.session.trace(f"{stranger.method} {stranger.path!r} {stranger.credential} {len(stranger.body)}: {answer}")
        self.session.count(f"{stranger.credential}, answered {answer}")
        if stranger.method == WEBSOCKET:
            self.session.count("handshakes")
        if self.plant.calls and not _is_cross_origin_read(stranger):
            self.session.violation(f"{stranger} reached {self.plant.calls}")
        self.plant.calls.clear()
        known = RouteTable(ROUTES).match(stranger.path.partition("?")[0])
        public = any(one.access is AccessLevel.PUBLIC and one.method == stranger.method for one in known)
        if answer in (101, 200, 204) and not public and not _is_cross_origin_read(stranger):
            self.session.violation(f"{stranger} was answered {answer}")
        if (self.access.database, _access_snapshot(self.access)) != (before[0], {one.id for one in before[1]}):
            self.session.violation(f"{stranger} changed users, tokens or sessions")


def _access_snapshot(access: AuthService) -> set[str]:
    return {one.id for one in access.sessions.stored()}


def _is_cross_origin_read(stranger: UnauthorizedRequest) -> bool:
    """A browser lets another page ask for what GET shows, and keeps the answer from it (no CORS header): no effect."""
    return stranger.credential == "another page" and stranger.method == "GET"


async def _send_to_app(app: Any, stranger: UnauthorizedRequest) -> int:
    """The status; of a handshake 101 or 403."""
    coming: list[Any] = [{"type": "http.request", "body": stranger.body, "more_body": False}]
    if stranger.scope["type"] == "websocket":
        report = stranger.body.decode("latin-1")
        coming = [{"type": "websocket.connect"}, {"type": "websocket.receive", "text": report}]
    statuses: list[int] = []

    async def receive() -> Any:
        if coming:
            return coming.pop(0)
        await asyncio.sleep(0.01)
        return {"type": stranger.scope["type"] + ".disconnect", "code": 1000}

    async def send(message: Any) -> None:
        kinds = {"websocket.accept": 101, "websocket.close": 403}
        statuses.append(message.get("status", kinds.get(message["type"], 0)))

    await app(stranger.scope, receive, send)
    return statuses[0]


def perform(session: CampaignRun) -> None:
    """Every request of the budget, in one app."""
    with TemporaryDirectory() as folder:
        run(UnauthorizedClients(session, Path(folder)).send_requests())


CAMPAIGN = Campaign(
    name="doors",
    summary={
        "en": "Requests without valid credentials at every path of the service.",
        "zh": "在服务的每个路径上发送没有有效凭据的请求。",
    },
    unit="requests",
    evidence_for=(),
    full_budget=120_000,
    ci_budget=1_000,
    run=perform,
)
