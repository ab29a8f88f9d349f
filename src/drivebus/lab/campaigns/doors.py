"""``doors`` (G21): strangers at every address of the service; nothing of what they send may do anything.

The app is the real one with its door; behind it stands a plant that only counts. A trial is one request, or one
WebSocket handshake with a message after it.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from drivebus.lab.campaign import Campaign, Session
from drivebus.plant.actor import Actor
from drivebus.plant.client import Json
from drivebus.testing.virtual import run

if TYPE_CHECKING:
    from drivebus.lab.outside.strangers import Credentials, Stranger
    from drivebus.plant.access.access import Access

STEP_S = 0.02
"""Between two requests: the throttle sees an hour of them."""
PASSWORD = "a pass phrase of the laboratory"


class Counting:
    """A plant that does nothing but count what came through the door."""

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.refused = 0

    async def call(self, operation: str, params: Json, actor: Actor) -> Json:
        self.calls.append(operation)
        return {"file": "x.csv", "text": "", "next": None} if operation == "history.export" else {}

    async def live(self, patterns: Sequence[str], actor: Actor, interval_s: float = 0.25) -> AsyncIterator[Json]:
        """The page's one subscription would be heard; no stranger ever begins one."""
        self.calls.append("live")
        yield {"type": "snapshot", "seq": 1, "time_ms": 0, "topics": {}}

    async def record(self, entry: Json, actor: Actor) -> None:
        self.refused += entry["params"].get("times", 0)


class Street:
    """The app, and who stands before it."""

    def __init__(self, session: Session, folder: Path) -> None:
        from drivebus.plant.access.access import Access
        from drivebus.plant.model import WebSetting
        from drivebus.web.app import make_app

        self.session = session
        self.now = 0.0
        self.plant = Counting()
        self.access: Access = Access(folder, clock=lambda: self.now, wall=lambda: round(self.now * 1000))
        self.app = make_app(self.plant, self.access, WebSetting())

    async def walk(self) -> None:
        """Strangers, until the budget is spent."""
        from drivebus.lab.outside.strangers import made

        credentials = await self._settle()
        before = self.access.register, self.access.sessions.kept()
        rng = self.session.rng("strangers")
        while self.session.left:
            stranger = made(rng, credentials)
            self.now += STEP_S
            await self._meet(stranger, before)
            self.session.did()
        self.session.figures["refusals told to the audit trail or counted"] = self.plant.refused > 0

    async def _settle(self) -> Credentials:
        """An administrator, with a session that is good, one that was ended, one too old, and a token too old."""
        from drivebus.lab.outside.strangers import Credentials
        from drivebus.plant.access.register import Token
        from drivebus.plant.access.rights import Right, Role
        from drivebus.plant.access.sessions import ABSOLUTE_S, digest

        user = await self.access.made("administrator", Role.ADMINISTRATOR, PASSWORD)
        token = Token("t", "old", user.name, tuple(Right), digest("dbt_old"), 0, 1)
        await self.access.change(lambda register: register.added(user).with_token(token))
        old = await self.access.login(user.name, PASSWORD, "local")
        self.now += ABSOLUTE_S
        ended = await self.access.login(user.name, PASSWORD, "local")
        await self.access.log_out(ended.session)
        good = await self.access.login(user.name, PASSWORD, "local")
        return Credentials(good.secret, (old.secret, ended.secret), "dbt_old")

    async def _meet(self, stranger: Stranger, before: tuple[Any, Any]) -> None:
        from drivebus.web.rights import WEBSOCKET, Door, entries_for

        try:
            answer = await _ask(self.app, stranger)
        except Exception as error:  # whatever it is: a stranger must not be able to
            self.session.violation(f"{stranger} broke the app: {error!r}")
            return
        self.session.line(f"{stranger.method} {stranger.path!r} {stranger.credential} {len(stranger.body)}: {answer}")
        self.session.count(f"{stranger.credential}, answered {answer}")
        if stranger.method == WEBSOCKET:
            self.session.count("handshakes")
        if self.plant.calls and not _reads(stranger):
            self.session.violation(f"{stranger} reached {self.plant.calls}")
        self.plant.calls.clear()
        known = entries_for(stranger.path.partition("?")[0])
        public = any(one.need is Door.PUBLIC and one.method == stranger.method for one in known)
        if answer in (101, 200, 204) and not public and not _reads(stranger):
            self.session.violation(f"{stranger} was answered {answer}")
        if (self.access.register, _still(self.access)) != (before[0], {one.id for one in before[1]}):
            self.session.violation(f"{stranger} changed users, tokens or sessions")


def _still(access: Access) -> set[str]:
    return {one.id for one in access.sessions.kept()}


def _reads(stranger: Stranger) -> bool:
    """A browser lets another page ask for what GET shows, and keeps the answer from it (no CORS header): no effect."""
    return stranger.credential == "another page" and stranger.method == "GET"


async def _ask(app: Any, stranger: Stranger) -> int:
    """The status; of a handshake 101 or 403."""
    coming: list[Any] = [{"type": "http.request", "body": stranger.body, "more_body": False}]
    if stranger.scope["type"] == "websocket":
        told = stranger.body.decode("latin-1")
        coming = [{"type": "websocket.connect"}, {"type": "websocket.receive", "text": told}]
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


def perform(session: Session) -> None:
    """Every request of the budget, in one app."""
    with TemporaryDirectory() as folder:
        run(Street(session, Path(folder)).walk())


CAMPAIGN = Campaign("doors", "requests", ("G21", "S01", "S03", "S04"), 120_000, 1_000, perform)
