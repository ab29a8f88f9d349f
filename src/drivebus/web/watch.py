"""A long connection ends with the credential that opened it, within a second, whatever its route does (S04)."""

from __future__ import annotations

import asyncio
import contextlib
import json

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from drivebus.plant.access.visitor import Visitor
from drivebus.plant.failure import both

CODE = 4401


async def watched(app: ASGIApp, visitor: Visitor, scope: Scope, receive: Receive, send: Send) -> None:
    """Run ``app``; when the visitor's session or token ends, tell why, close, and give the route a disconnect."""
    line = _Line(receive, send)
    route = asyncio.ensure_future(app(scope, line.receive, line.send))
    ending = asyncio.create_task(visitor.ended())
    try:
        await asyncio.wait({route, ending}, return_when=asyncio.FIRST_COMPLETED)
        if not route.done():
            await line.close(ending.result())
        await route
    finally:
        for task in (route, ending):
            task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await ending


class _Line:
    """The connection as the route sees it."""

    def __init__(self, receive: Receive, send: Send) -> None:
        self._receive = receive
        self._send = send
        self._accepted = False
        self._over = asyncio.Event()

    async def receive(self) -> Message:
        if self._over.is_set():
            return _gone()
        coming, over = asyncio.ensure_future(self._receive()), asyncio.ensure_future(self._over.wait())
        try:
            await asyncio.wait({coming, over}, return_when=asyncio.FIRST_COMPLETED)
            return coming.result() if coming.done() else _gone()
        finally:
            for task in (coming, over):
                task.cancel()

    async def send(self, message: Message) -> None:
        if self._over.is_set():
            return
        self._accepted = self._accepted or message["type"] == "websocket.accept"
        await self._send(message)

    async def close(self, why: str) -> None:
        self._over.set()
        if self._accepted:
            told = {"type": "closed", "reason": why, "text": both(f"access.closed.{why}")}
            said = json.dumps(told, ensure_ascii=False)
            await self._send({"type": "websocket.send", "text": said})
        await self._send({"type": "websocket.close", "code": CODE, "reason": why})


def _gone() -> Message:
    return {"type": "websocket.disconnect", "code": CODE}
