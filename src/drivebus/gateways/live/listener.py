"""One WebSocket: a bounded queue towards it, what it may say, and the many ways in which it ends."""

from __future__ import annotations

import asyncio
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from drivebus.errors import DrivebusError
from drivebus.gateways.door import visitor
from drivebus.gateways.live.asked import Asked, Budget, asked
from drivebus.gateways.live.channel import Channel, encoded
from drivebus.gateways.live.feed import Feed
from drivebus.plant.client import PlantClient
from drivebus.plant.failure import both, failure

Json = dict[str, Any]

CODES = {"slow": 4008, "message": 4400, "often": 4029, "plant": 1012, "shutdown": 1012}
"""Reason → close code. A logout or a role that is lost is the door's to tell (``web.watch``)."""
QUEUE = 32
"""Who leaves so many messages lying (8 s at the usual four a second) is closed."""
GOODBYE_S = 1.0
"""So long the last message may take; then the line is cut."""


class Listener:
    """Lives as long as its WebSocket."""

    def __init__(self, socket: WebSocket, plant: PlantClient, feed: Feed, interval_s: float) -> None:
        self._socket, self._plant, self._feed, self._interval_s = socket, plant, feed, interval_s
        self._visitor = visitor(socket)
        self._queue: asyncio.Queue[str] = asyncio.Queue(QUEUE)
        self._channel: Channel | None = None
        self._reason: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        self._budget = Budget()

    def offer(self, text: str) -> None:
        if self._queue.full():
            self.close("slow")
        else:
            self._queue.put_nowait(text)

    def close(self, reason: str) -> None:
        if not self._reason.done():
            self._reason.set_result(reason)

    async def run(self, patterns: tuple[str, ...]) -> None:
        """Until the client goes, or has to."""
        self._subscribe(patterns)
        works = [asyncio.ensure_future(work) for work in (self._send(), self._receive())]
        try:
            await asyncio.wait({self._reason, *works}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._unsubscribe()
            for work in works:
                work.cancel()
            await asyncio.gather(*works, return_exceptions=True)
        if self._reason.done():
            await self._say_goodbye(self._reason.result())

    def _subscribe(self, patterns: tuple[str, ...]) -> None:
        before, self._channel = self._channel, self._feed.join(self, patterns, self._interval_s)
        if before is not None and before is not self._channel:
            self._feed.leave(self, before)

    def _unsubscribe(self) -> None:
        if self._channel is not None:
            self._feed.leave(self, self._channel)

    async def _send(self) -> None:
        while True:
            await self._socket.send_text(await self._queue.get())

    async def _receive(self) -> None:
        clock = asyncio.get_running_loop().time
        while True:
            try:
                text = await self._socket.receive_text()
                wish = asked(text)
            except WebSocketDisconnect:
                return None
            except (KeyError, ValueError):  # bytes instead of text, or what nobody understands
                return self.close("message")
            if not self._budget.spend(clock()):
                return self.close("often")
            await self._do(wish)

    async def _do(self, wish: Asked) -> None:
        if wish.subscribe is not None:
            self._subscribe(wish.subscribe)
        for drive in wish.renew:
            self.offer(encoded(await self._renewed(drive)))

    async def _renewed(self, drive: str) -> Json:
        """Each ask renews once: no lease outlives the hand of its owner by more than its own time (6.6)."""
        told: Json = {"type": "lease", "drive": drive}
        try:
            return told | await self._plant.call("lease.renew", {"drive": drive}, self._visitor.actor)
        except DrivebusError as error:
            return told | {"error": failure(error)}

    async def _say_goodbye(self, reason: str) -> None:
        """Why, then the end; a client that takes nothing is not waited for."""
        last = encoded({"type": "closed", "reason": reason, "text": both(f"api.closed_{reason}")})
        try:
            async with asyncio.timeout(GOODBYE_S):
                if reason != "slow":
                    await self._socket.send_text(last)
                await self._socket.close(CODES[reason], reason)
        except (TimeoutError, RuntimeError, WebSocketDisconnect):
            return
