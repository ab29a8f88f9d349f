"""One WebSocket: a bounded queue towards it, what it may say, and the many ways in which it ends."""

from __future__ import annotations

import asyncio
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from drivebus.errors import DrivebusError
from drivebus.service.api.errors import error_to_json, localized
from drivebus.service.ipc.service_client import ServiceClient
from drivebus.web.context import credential_of
from drivebus.web.live.fanout import FanoutGroup, encode_message
from drivebus.web.live.messages import ClientMessage, MessageRateLimit, parse_message
from drivebus.web.live.upstream import UpstreamFeed

Json = dict[str, Any]

CLOSE_CODES = {"slow": 4008, "message": 4400, "often": 4029, "plant": 1012, "shutdown": 1012}
"""Reason → close code. A logout or a role that is lost is the door's to tell (``web.watch``)."""
MAX_QUEUED_MESSAGES = 32
"""Who leaves so many messages lying (8 s at the usual four a second) is closed."""
CLOSE_TIMEOUT_S = 1.0
"""So long the last message may take; then the line is cut."""


class WebSocketSession:
    """Lives as long as its WebSocket."""

    def __init__(self, socket: WebSocket, plant: ServiceClient, feed: UpstreamFeed, interval_s: float) -> None:
        self._socket, self._service, self._feed, self._interval_s = socket, plant, feed, interval_s
        self._credential = credential_of(socket)
        self._queue: asyncio.Queue[str] = asyncio.Queue(MAX_QUEUED_MESSAGES)
        self._group: FanoutGroup | None = None
        self._reason: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        self._budget = MessageRateLimit()

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
            await self._close_socket(self._reason.result())

    def _subscribe(self, patterns: tuple[str, ...]) -> None:
        before, self._group = self._group, self._feed.join(self, patterns, self._interval_s)
        if before is not None and before is not self._group:
            self._feed.leave(self, before)

    def _unsubscribe(self) -> None:
        if self._group is not None:
            self._feed.leave(self, self._group)

    async def _send(self) -> None:
        while True:
            await self._socket.send_text(await self._queue.get())

    async def _receive(self) -> None:
        clock = asyncio.get_running_loop().time
        while True:
            try:
                text = await self._socket.receive_text()
                wish = parse_message(text)
            except WebSocketDisconnect:
                return None
            except (KeyError, ValueError):  # bytes instead of text, or what nobody understands
                return self.close("message")
            if not self._budget.spend(clock()):
                return self.close("often")
            await self._handle(wish)

    async def _handle(self, wish: ClientMessage) -> None:
        if wish.subscribe is not None:
            self._subscribe(wish.subscribe)
        for drive in wish.renew:
            self.offer(encode_message(await self._renew_lease(drive)))

    async def _renew_lease(self, drive: str) -> Json:
        """Each ask renews once: no lease outlives the hand of its owner by more than its own time (6.6)."""
        told: Json = {"type": "lease", "drive": drive}
        try:
            return told | await self._service.call("lease.renew", {"drive": drive}, self._credential.actor)
        except DrivebusError as error:
            return told | {"error": error_to_json(error)}

    async def _close_socket(self, reason: str) -> None:
        """Why, then the end; a client that takes nothing is not waited for."""
        last = encode_message({"type": "closed", "reason": reason, "text": localized(f"api.closed_{reason}")})
        try:
            async with asyncio.timeout(CLOSE_TIMEOUT_S):
                if reason != "slow":
                    await self._socket.send_text(last)
                await self._socket.close(CLOSE_CODES[reason], reason)
        except (TimeoutError, RuntimeError, WebSocketDisconnect):
            return
