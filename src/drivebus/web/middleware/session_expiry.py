"""End of a WebSocket with the credential that opened it, within a second, whatever its route does."""

from __future__ import annotations

import asyncio
import contextlib
import json

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from drivebus.service.api.errors import localized
from drivebus.service.auth.credentials import Credential

SESSION_ENDED_CODE = 4401  # close code: 4000 plus the HTTP status for a missing credential


async def run_until_credential_ends(
    app: ASGIApp, credential: Credential, scope: Scope, receive: Receive, send: Send
) -> None:
    """Run ``app``; when the session or token ends, send the reason, close, and give the route a disconnect."""
    connection = _GuardedConnection(receive, send)
    route = asyncio.ensure_future(app(scope, connection.receive, connection.send))
    ending = asyncio.create_task(credential.wait_ended())
    try:
        await asyncio.wait({route, ending}, return_when=asyncio.FIRST_COMPLETED)
        if not route.done():
            await connection.close(ending.result())
        await route
    finally:
        for task in (route, ending):
            task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await ending


class _GuardedConnection:
    """Connection of the route: after ``close`` it receives a disconnect and sends nothing."""

    def __init__(self, receive: Receive, send: Send) -> None:
        self._receive = receive
        self._send = send
        self._accepted = False
        self._ended = asyncio.Event()

    async def receive(self) -> Message:
        if self._ended.is_set():
            return _disconnect_message()
        coming, ended = asyncio.ensure_future(self._receive()), asyncio.ensure_future(self._ended.wait())
        try:
            await asyncio.wait({coming, ended}, return_when=asyncio.FIRST_COMPLETED)
            return coming.result() if coming.done() else _disconnect_message()
        finally:
            for task in (coming, ended):
                task.cancel()

    async def send(self, message: Message) -> None:
        if self._ended.is_set():
            return
        self._accepted = self._accepted or message["type"] == "websocket.accept"
        await self._send(message)

    async def close(self, reason: str) -> None:
        self._ended.set()
        if self._accepted:
            last = {"type": "closed", "reason": reason, "text": localized(f"auth.closed.{reason}")}
            await self._send({"type": "websocket.send", "text": json.dumps(last, ensure_ascii=False)})
        await self._send({"type": "websocket.close", "code": SESSION_ENDED_CODE, "reason": reason})


def _disconnect_message() -> Message:
    return {"type": "websocket.disconnect", "code": SESSION_ENDED_CODE}
