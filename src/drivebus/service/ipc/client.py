"""``ServiceClient`` over the service's socket.

It connects with the first request, and again with the next one after the service was away.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
from collections.abc import AsyncIterator
from pathlib import Path

from drivebus.errors import ServiceUnavailable
from drivebus.service.api.errors import error_from_json
from drivebus.service.auth.actor import Actor
from drivebus.service.ipc.protocol import MAX_MESSAGE_BYTES, short_socket_path, split_reply
from drivebus.service.ipc.service_client import ServiceErrorReply
from drivebus.service.live.hub import closed_message
from drivebus.types import Json

Reply = tuple[str, bytes]
"""Kind of a reply and its JSON text."""
CONNECTION_LOST: Reply = ("lost", b"")
MAX_UNREAD_LIVE_BYTES = 16 * 1024 * 1024
"""A reader of live messages that leaves more unread is closed as slow.

In bytes, because a message holds one drive (about 2 kB) or all of them: 300 drives need about 1 MB a second.
"""


PING_INTERVAL_S = 1.0  # between pings while a request waits
SILENCE_LIMIT_S = 5.0
"""A service that sends nothing for so long while something is due hangs; a long operation alone does not."""


class ReplyQueue:
    """Unread replies to one request."""

    def __init__(self) -> None:
        self._replies: asyncio.Queue[Reply] = asyncio.Queue()
        self.unread_bytes = 0

    def put(self, reply: Reply) -> None:
        self._replies.put_nowait(reply)
        self.unread_bytes += len(reply[1])

    async def get(self) -> Reply:
        reply = await self._replies.get()
        self.unread_bytes -= len(reply[1])
        return reply

    def replace(self, last: Reply) -> None:
        """Leave ``last`` as the only reply."""
        while not self._replies.empty():
            self._replies.get_nowait()
        self.unread_bytes = 0
        self.put(last)


class SocketClient:
    """Client with one connection for all its requests. Belongs to one event loop."""

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self._writer: asyncio.StreamWriter | None = None
        self._reading: asyncio.Task[None] | None = None
        self._numbers = itertools.count(1)
        self._pending: dict[int, ReplyQueue] = {}
        self._connecting = asyncio.Lock()
        self._due_since: float | None = None
        """Time of the first message since the service has sent anything."""

    async def call(self, operation: str, params: Json, actor: Actor) -> Json:
        """See ``ServiceClient.call``. Raises ServiceUnavailable where the service does not answer."""
        try:
            result: Json = json.loads(await self.call_json(operation, params, actor))
        except ServiceErrorReply as error:
            raise error_from_json(json.loads(error.payload)) from None
        return result

    async def call_json(self, operation: str, params: Json, actor: Actor) -> bytes:
        """See ``ServiceClient.call_json``. Raises ServiceUnavailable where the service does not answer.

        Cancelled, it ends a cancellable operation; any other is done.
        """
        called_at = asyncio.get_running_loop().time()
        return await self._request(
            {"op": operation, "params": params, "actor": actor.as_json(), "called_at": called_at}
        )

    async def record(self, entry: Json, actor: Actor) -> None:
        """See ``ServiceClient.record``."""
        await self._notify({"record": entry}, actor)

    async def end_control(self, reason: str, actor: Actor) -> None:
        """See ``ServiceClient.end_control``."""
        # an older service, which knows no "end_control", answers the unknown operation and stays connected
        await self._notify({"end_control": reason, "op": "end_control"}, actor)

    async def _notify(self, message: Json, actor: Actor) -> None:
        """Send a message that has no result. Raises ServiceUnavailable, AuditUnavailable."""
        try:
            await self._request(message | {"actor": actor.as_json()})
        except ServiceErrorReply as error:
            raise error_from_json(json.loads(error.payload)) from None

    async def live(self, stream: str, actor: Actor) -> AsyncIterator[Json]:
        """See ``ServiceClient.live``. Raises ServiceUnavailable where the service does not answer, or ends.

        A reader that leaves more than ``MAX_UNREAD_LIVE_BYTES`` unread gets nothing but a ``closed`` message with the
        reason ``slow``.
        """
        number, replies = await self._send({"live": stream, "actor": actor.as_json()})
        try:
            while True:
                message: Json = json.loads(_payload(await replies.get()))
                yield message
                if message["type"] == "closed":
                    return
        except ServiceErrorReply as error:
            raise error_from_json(json.loads(error.payload)) from None
        finally:
            self._pending.pop(number, None)
            self._write({"id": number, "end": True})

    async def close(self) -> None:
        """Close the connection; pending requests raise ServiceUnavailable. Idempotent."""
        reading, self._reading = self._reading, None
        if reading is not None:
            reading.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await reading

    async def _request(self, message: Json) -> bytes:
        number, replies = await self._send(message)
        try:
            return _payload(await self._first_reply(replies))
        except asyncio.CancelledError:
            self._write({"id": number, "end": True})
            raise
        finally:
            self._pending.pop(number, None)

    async def _first_reply(self, replies: ReplyQueue) -> Reply:
        """Wait for a reply as long as the service answers pings. Raises ServiceUnavailable once it does not."""
        clock = asyncio.get_running_loop().time
        started_at = clock()
        while True:
            try:
                async with asyncio.timeout(PING_INTERVAL_S):
                    return await replies.get()
            except TimeoutError:
                silent_s = 0.0 if self._due_since is None else clock() - max(started_at, self._due_since)
            if silent_s >= SILENCE_LIMIT_S:
                raise ServiceUnavailable("plant.hangs", silent_s=round(silent_s))
            self._write({"id": next(self._numbers), "ping": True})

    async def _send(self, message: Json) -> tuple[int, ReplyQueue]:
        async with self._connecting:
            if self._writer is None:
                await self._connect()
        number = next(self._numbers)
        replies = self._pending[number] = ReplyQueue()
        self._write({"id": number, **message})
        return number, replies

    def _write(self, message: Json) -> None:
        if self._writer is not None:
            if self._due_since is None:
                self._due_since = asyncio.get_running_loop().time()
            self._writer.write(json.dumps(message).encode() + b"\n")

    async def _connect(self) -> None:
        try:
            with short_socket_path(self.path) as short:
                reader, self._writer = await asyncio.open_unix_connection(short, limit=MAX_MESSAGE_BYTES)
        except OSError as error:
            raise ServiceUnavailable("plant.not_there", socket=str(self.path)) from error
        self._reading = asyncio.create_task(self._read(reader, self._writer), name="service socket")

    async def _read(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while line := await reader.readline():
                self._due_since = None
                number, kind, payload = split_reply(line)
                self._dispatch(number, kind, payload)
                if kind == "live":
                    await asyncio.sleep(0)  # let the reader take this message before the next one arrives
        except (OSError, ValueError):
            pass
        finally:
            self._writer = self._due_since = None
            writer.close()
            for replies in self._pending.values():
                replies.replace(CONNECTION_LOST)

    def _dispatch(self, number: int, kind: str, payload: bytes) -> None:
        """Queue a reply. A slow reader of live messages is closed, so that it fills no memory."""
        replies = self._pending.get(number)
        if replies is None:
            return
        if replies.unread_bytes + len(payload) > MAX_UNREAD_LIVE_BYTES:
            self._pending.pop(number)
            replies.replace(("live", json.dumps(closed_message("slow")).encode()))
            self._write({"id": number, "end": True})
        else:
            replies.put((kind, payload))


def _payload(reply: Reply) -> bytes:
    """Return the JSON text of a result or live message. Raises ServiceErrorReply, ServiceUnavailable."""
    if reply is CONNECTION_LOST:
        raise ServiceUnavailable("plant.gone")
    kind, payload = reply
    if kind == "error":
        raise ServiceErrorReply(payload)
    return payload
