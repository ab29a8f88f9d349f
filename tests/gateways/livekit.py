"""A client of the live gateway without a socket, and messages as the plant sends them."""

from __future__ import annotations

import asyncio
import json
from types import SimpleNamespace
from typing import Any

from starlette.websockets import WebSocketDisconnect

from drivebus.plant.actor import Actor
from gateways.apikit import OPERATOR

Json = dict[str, Any]


def signal(value: float | None, quality: str = "good", age_s: float | None = 0.0) -> Json:
    return {"value": value, "unit": "Hz", "quality": quality, "reason": None, "age_s": age_s}


def snapshot(**topics: Any) -> Json:
    return {
        "type": "snapshot",
        "seq": 1,
        "time_ms": 1,
        "topics": {name.replace("__", "/"): one for name, one in topics.items()},
    }


def delta(topics: Json | None = None, **more: Any) -> Json:
    return {"type": "delta", "seq": 2, "time_ms": 2, "topics": topics or {}, **more}


class Ear:
    """A client as a channel sees it: keeps what it is told, with the loop's time."""

    def __init__(self) -> None:
        self.texts: list[str] = []
        self.at: list[float] = []
        self.reason: str | None = None

    def offer(self, text: str) -> None:
        self.texts.append(text)
        self.at.append(asyncio.get_running_loop().time())

    def close(self, reason: str) -> None:
        self.reason = reason

    @property
    def heard(self) -> list[Json]:
        return [json.loads(text) for text in self.texts]

    def topics(self) -> list[Json]:
        return [message["topics"] for message in self.heard]


class Socket:
    """A WebSocket: ``says`` come from the client; ``takes`` False is a client that reads nothing."""

    def __init__(self, actor: Actor = OPERATOR, *, takes: bool = True) -> None:
        self.state = SimpleNamespace(visitor=SimpleNamespace(actor=actor))
        self.query_params: dict[str, str] = {}
        self.says: asyncio.Queue[str | None] = asyncio.Queue()
        self.takes = takes
        self.sent: list[Json] = []
        self.closed: tuple[int, str] | None = None

    async def accept(self) -> None:
        return

    async def receive_text(self) -> str:
        said = await self.says.get()
        if said is None:
            raise WebSocketDisconnect(1001)
        return said

    async def send_text(self, text: str) -> None:
        if not self.takes:
            await asyncio.Event().wait()
        self.sent.append(json.loads(text))

    async def close(self, code: int, reason: str) -> None:
        self.closed = code, reason
