"""A whole app in this process over a plant that only counts: what came through the door, and what was recorded."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import httpx
from argon2 import PasswordHasher
from fastapi import FastAPI

from drivebus.plant.access.access import Access
from drivebus.plant.access.passwords import Passwords
from drivebus.plant.access.register import Register, User
from drivebus.plant.access.rights import Role
from drivebus.plant.actor import Actor
from drivebus.plant.client import PlantClient
from drivebus.plant.model import WebSetting
from drivebus.web.app import make_app
from drivebus.web.refused import Refusals

Json = dict[str, Any]
BASE = "http://127.0.0.1:8080"
PASSWORD = "correct horse battery"
QUICK = PasswordHasher(time_cost=1, memory_cost=8, parallelism=1)
"""As argon2, but a thousand times quicker: these tests are about who is asked, not about guessing offline."""


USERS = Register(tuple(User(str(role), role, QUICK.hash(PASSWORD), 0) for role in Role))


@dataclass
class Plant:
    """Counts. ``deaf`` makes its record fail, as with a full disk."""

    calls: list[tuple[str, Json, Actor]] = field(default_factory=list)
    records: list[tuple[Json, Actor]] = field(default_factory=list)
    deaf: bool = False

    async def call(self, operation: str, params: Json, actor: Actor) -> Json:
        self.calls.append((operation, params, actor))
        return {}

    async def live(self, patterns: Sequence[str], actor: Actor, interval_s: float = 0.25) -> AsyncIterator[Json]:
        self.calls.append(("live", {"patterns": list(patterns)}, actor))
        yield {"type": "snapshot", "seq": 1, "time_ms": 0, "topics": {}}
        await asyncio.Event().wait()

    async def record(self, entry: Json, actor: Actor) -> None:
        if self.deaf:
            raise OSError(28, "No space left on device")
        self.records.append((entry, actor))


@dataclass
class Clock:
    """Monotonic seconds and UTC milliseconds that only a test moves."""

    now: float = 1000.0

    def __call__(self) -> float:
        return self.now

    def wall_ms(self) -> int:
        return 1_800_000_000_000 + round(self.now * 1000)


@cache
def app_of(web: WebSetting) -> tuple[FastAPI, Plant, Access]:
    """An app costs a quarter of a second to make: one for all, with everything that it remembers taken away."""
    plant, access = Plant(), Access(Path("/nonexistent"), passwords=Passwords(QUICK))
    return make_app(plant, access, web), plant, access


class Wire:
    """A WebSocket of the app without a socket. ``sent`` is what the app said; ``end`` how it ended."""

    def __init__(self, app: FastAPI, headers: dict[str, str]) -> None:
        self.sent: list[Any] = []
        self._coming: asyncio.Queue[Any] = asyncio.Queue()
        self._coming.put_nowait({"type": "websocket.connect"})
        pairs = [(name.lower().encode(), value.encode()) for name, value in headers.items()]
        scope = {
            "type": "websocket", "asgi": {"version": "3.0"}, "scheme": "ws", "http_version": "1.1",
            "path": "/api/v1/live", "raw_path": b"/api/v1/live", "query_string": b"", "root_path": "",
            "headers": pairs, "client": ("127.0.0.1", 50000), "server": ("127.0.0.1", 8080), "subprotocols": [],
        }  # fmt: skip
        self.route = asyncio.create_task(app(scope, self._coming.get, self._send))

    async def _send(self, message: Any) -> None:
        self.sent.append(message)

    @property
    def is_open(self) -> bool:
        kinds = [message["type"] for message in self.sent]
        return "websocket.accept" in kinds and "websocket.close" not in kinds

    @property
    def end(self) -> int | None:
        """The code it was closed with."""
        return next((message["code"] for message in self.sent if message["type"] == "websocket.close"), None)

    async def leave(self) -> None:
        self._coming.put_nowait({"type": "websocket.disconnect", "code": 1000})
        await self.route


class House:
    """An app, its plant, its users: one of each role, all with the same password. Only the newest one works."""

    def __init__(
        self, directory: Path, *, users: bool = True, web: WebSetting | None = None, plant: PlantClient | None = None
    ) -> None:
        """``plant`` is a real one, in the place of the one that counts."""
        self.clock = Clock()
        self.app, self.plant, self.access = app_of(web or WebSetting())
        if plant is not None:
            self.app = make_app(plant, self.access, web or WebSetting())
        self.plant.__init__()  # type: ignore[misc]
        self.access.__init__(  # type: ignore[misc]
            directory, passwords=self.access.passwords, clock=self.clock, wall=self.clock.wall_ms
        )
        self.refusals.__init__(self.plant, self.clock)  # type: ignore[misc]
        if users:
            self.access.file.change(lambda _: USERS)

    @property
    def refusals(self) -> Refusals:
        """Those of the app's door."""
        found: Refusals = self.app.user_middleware[0].kwargs["refusals"]
        return found

    def client(self, base: str = BASE, **headers: str) -> httpx.AsyncClient:
        transport = httpx.ASGITransport(app=self.app, raise_app_exceptions=False, client=("127.0.0.1", 50000))
        return httpx.AsyncClient(transport=transport, base_url=base, headers=headers)

    async def logged_in(self, role: str) -> httpx.AsyncClient:
        """A client with the session cookie and the CSRF header of a user of that role."""
        client = self.client()
        answer = await client.post("/api/v1/login", json={"name": role, "password": PASSWORD})
        assert answer.status_code == 200, answer.text
        client.headers["X-Drivebus-CSRF"] = answer.json()["csrf"]
        return client

    async def token(self, role: str, *rights: str) -> str:
        """A token's secret."""
        client = await self.logged_in(role)
        answer = await client.post("/api/v1/tokens", json={"name": "t", "rights": list(rights), "days": 1})
        assert answer.status_code == 200, answer.text
        return str(answer.json()["secret"])
