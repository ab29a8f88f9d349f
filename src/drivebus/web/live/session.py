"""WebSocket of live values: its subscription, the messages of its client, and its end."""

from __future__ import annotations

import asyncio

from starlette.websockets import WebSocket, WebSocketDisconnect

from drivebus.errors import DrivebusError
from drivebus.gateways.fanout import FanoutGroup, Subscriber, encode_message
from drivebus.gateways.upstream import UpstreamFeed
from drivebus.service.api.errors import error_to_json, localized
from drivebus.service.api.operations.control import LEASE_RENEW
from drivebus.service.ipc.service_client import ServiceClient
from drivebus.service.runtime.fairness import yield_to_loop
from drivebus.types import Json
from drivebus.web.context import credential_of
from drivebus.web.live.messages import ClientMessage, MessageRateLimit, parse_message

CLOSE_CODES = {
    "slow": 4008,
    "bad_message": 4400,
    "rate_limited": 4029,
    "upstream_lost": 1012,
    "shutdown": 1012,
    "many": 1013,
}
"""Reason → close code. The end of the login session closes the socket too, with codes of its own."""
CLOSE_TIMEOUT_S = 1.0  # a client that does not take the last message is disconnected


class WebSocketSession:
    """Session of one WebSocket; ``run`` ends with it."""

    def __init__(self, socket: WebSocket, service: ServiceClient, feed: UpstreamFeed, interval_s: float) -> None:
        self._socket, self._service, self._feed, self._interval_s = socket, service, feed, interval_s
        self._credential = credential_of(socket)
        self._subscriber = Subscriber()
        self._group: FanoutGroup | None = None
        self._rate_limit = MessageRateLimit()

    async def run(self, patterns: tuple[str, ...]) -> None:
        """Serve the client until it leaves or is closed."""
        self._subscribe(patterns)
        tasks = [asyncio.ensure_future(coroutine) for coroutine in (self._send(), self._receive())]
        try:
            await asyncio.wait({self._subscriber.reason, *tasks}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._unsubscribe()
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
        if self._subscriber.reason.done():
            await close_socket(self._socket, self._subscriber.reason.result())

    def _subscribe(self, patterns: tuple[str, ...]) -> None:
        before, self._group = self._group, self._feed.join(self._subscriber, patterns, self._interval_s)
        if before is not None and before is not self._group:
            self._feed.leave(self._subscriber, before)

    def _unsubscribe(self) -> None:
        if self._group is not None:
            self._feed.leave(self._subscriber, self._group)

    async def _send(self) -> None:
        while True:
            await self._socket.send_text(await self._subscriber.next())

    async def _receive(self) -> None:
        clock = asyncio.get_running_loop().time
        while True:
            try:
                text = await self._socket.receive_text()
                message = parse_message(text)
            except WebSocketDisconnect:
                return None
            except (KeyError, ValueError):  # bytes instead of text, or not a message of the protocol
                return self._subscriber.close("bad_message")
            if not self._rate_limit.spend(clock(), message.cost):
                return self._subscriber.close("rate_limited")
            await self._handle(message)

    async def _handle(self, message: ClientMessage) -> None:
        if message.subscribe is not None:
            await yield_to_loop()  # a snapshot of many drives takes 30 ms: one of all clients, then the others' stops
            self._subscribe(message.subscribe)
        if message.renew:
            answers = {drive: await self._renew_lease(drive) for drive in message.renew}
            self._subscriber.offer(encode_message({"type": "leases", "drives": answers}))

    async def _renew_lease(self, drive: str) -> Json:
        """Renew once: a lease never outlives its owner's last message by more than its own time."""
        try:
            return await self._service.call(LEASE_RENEW.name, {"drive": drive}, self._credential.actor)
        except DrivebusError as error:
            return {"error": error_to_json(error)}


async def close_socket(socket: WebSocket, reason: str) -> None:
    """Send the reason and close; a client that reads nothing is not waited for."""
    last = encode_message({"type": "closed", "reason": reason, "text": localized(f"api.closed_{reason}")})
    try:
        async with asyncio.timeout(CLOSE_TIMEOUT_S):
            if reason != "slow":
                await socket.send_text(last)
            await socket.close(CLOSE_CODES[reason], reason)
    except (TimeoutError, RuntimeError, WebSocketDisconnect):
        return
