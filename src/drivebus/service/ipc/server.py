"""Sockets of the service: JSON lines for its clients, and one that accepts nothing but "stop all".

A client (the user that runs the service; mode 0600) is trusted to name the actor. Each request is a task of its own, so
that none delays another client's stop.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from drivebus import i18n
from drivebus.errors import DrivebusError, InvalidParameters, ServiceUnavailable
from drivebus.service.api.errors import error_to_json
from drivebus.service.api.operations import OPERATIONS
from drivebus.service.api.operations.plant import PLANT_STOP
from drivebus.service.api.strict_json import parse_json
from drivebus.service.auth.actor import STOP_ALL_NAME, Actor, local_actor
from drivebus.service.ipc.protocol import (
    MAX_MESSAGE_BYTES,
    MAX_MOTION_WAIT_S,
    STOP_RECEIVED,
    STOP_REQUEST,
    late_motion_error,
    short_socket_path,
)
from drivebus.service.ipc.service_client import ServiceClient
from drivebus.service.runtime.fairness import COMPACT_ENCODER, encode_json_cooperatively, yield_to_loop
from drivebus.types import Json

MAX_CONCURRENT_REQUESTS = 1000  # on one connection; stops do not count
MAX_UNSENT_BYTES = 16 * 1024 * 1024
"""A client that leaves more unread is disconnected, because it hangs."""
LOG = logging.getLogger("drivebus.service")


class SocketServer:
    """Server of ``plant.sock``."""

    def __init__(self, service: ServiceClient, path: Path) -> None:
        self._service, self.path = service, path
        self._server: asyncio.Server | None = None
        self._connections: set[asyncio.Task[None]] = set()

    async def open(self) -> None:
        """Listen, also again where the socket was removed; connections that are open go on. Raises OSError."""
        self._server = await reopen_server(self._server, self.path, self._connected)

    async def close(self) -> None:
        """Disconnect every client; pending requests are cancelled."""
        await close_server(self._server, self.path)
        for task in self._connections:
            task.cancel()
        await asyncio.gather(*self._connections, return_exceptions=True)

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._connections.add(task)
        try:
            await _ClientConnection(self._service, reader, writer).run()
        except asyncio.CancelledError:
            pass  # by ``close``; Python 3.11 reports a connection's task that ends as cancelled as an error
        finally:
            self._connections.discard(task)


_INVALID_REQUEST = (ValueError, OverflowError, KeyError, TypeError)
"""Errors of a line that is too long, no JSON or no request."""


class _ClientConnection:
    """Connection of one client."""

    def __init__(self, service: ServiceClient, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._service, self._reader, self._writer = service, reader, writer
        self._request_tasks: set[asyncio.Task[None]] = set()
        self._ending_tasks: dict[Any, asyncio.Task[None]] = {}
        """Live streams and requests that end with their client, by id."""

    async def run(self) -> None:
        """Serve until the client disconnects or sends an invalid request.

        Its commands continue: a stop is not revoked, and each is recorded with its outcome. Live streams and
        cancellable requests end.
        """
        try:
            while line := await self._reader.readline():
                self._handle(parse_json(line))
        except (*_INVALID_REQUEST, ConnectionError) as error:
            LOG.warning(i18n.preferred_text("log.client_disconnected", reason=type(error).__name__))
        finally:
            ending = tuple(self._ending_tasks.values())
            for task in ending:
                task.cancel()
            await asyncio.gather(*self._request_tasks, *ending, return_exceptions=True)
            self._writer.close()
            with contextlib.suppress(OSError):
                await self._writer.wait_closed()

    def _handle(self, message: Json) -> None:
        id = message["id"]
        if message.get("ping"):
            self._writer.write(COMPACT_ENCODER.encode({"id": id, "result": {}}).encode() + b"\n")
            return
        if message.get("end"):
            if (running := self._ending_tasks.get(id)) is not None:
                running.cancel()
            return
        actor = Actor.from_json(message["actor"])
        if "live" in message:
            task = asyncio.create_task(self._live(id, str(message["live"]), actor), name=f"live {id}")
            self._end_with_client(id, task)
        else:
            task = asyncio.create_task(self._answer(id, self._dispatch(message, actor)), name=f"request {id}")
            self._request_tasks.add(task)
            task.add_done_callback(self._request_tasks.discard)
            operation = OPERATIONS.get(str(message.get("op")))
            if operation is not None and operation.cancellable:
                self._end_with_client(id, task)

    def _end_with_client(self, id: Any, task: asyncio.Task[None]) -> None:
        self._ending_tasks[id] = task
        task.add_done_callback(lambda _: self._ending_tasks.pop(id, None))

    def _dispatch(self, message: Json, actor: Actor) -> Awaitable[Json]:
        if "record" in message:
            return _without_result(self._service.record(message["record"], actor))
        if "end_control" in message:
            return _without_result(self._service.end_control(str(message["end_control"]), actor))
        operation = str(message["op"])
        if len(self._request_tasks) >= MAX_CONCURRENT_REQUESTS and not _is_stop(operation):
            return _too_busy()
        declared = OPERATIONS.get(operation)
        if declared is not None and declared.moves_motors and "called_at" in message:
            called_at = message["called_at"]
            if type(called_at) not in (int, float):  # float() would read "nan", which is never too long ago
                raise TypeError("called_at is not a number")
            waited_s = asyncio.get_running_loop().time() - float(called_at)
            if waited_s > MAX_MOTION_WAIT_S:
                return _refuse_late_motion(waited_s)
        return self._call(operation, message.get("params") or {}, actor)

    async def _call(self, operation: str, params: Json, actor: Actor) -> Json:
        declared = OPERATIONS.get(operation)
        if declared is None or declared.yields:
            await yield_to_loop()
        return await self._service.call(operation, params, actor)

    async def _answer(self, id: Any, work: Awaitable[Json]) -> None:
        try:
            await self._send({"id": id, "result": await work})
        except DrivebusError as error:
            await self._send({"id": id, "error": error_to_json(error)})
        except Exception:
            LOG.exception(i18n.preferred_text("log.request_failed"))
            await self._send({"id": id, "error": error_to_json(ServiceUnavailable("plant.internal"))})

    async def _live(self, id: Any, stream: str, actor: Actor) -> None:
        try:
            async for message in self._service.live(stream, actor):
                await self._send({"id": id, "live": message})
                await self._writer.drain()
        except DrivebusError as error:
            await self._send({"id": id, "error": error_to_json(error)})
        except ConnectionError:
            return

    async def _send(self, message: Json) -> None:
        if self._writer.transport.get_write_buffer_size() > MAX_UNSENT_BYTES:
            self._writer.transport.abort()
            return
        data = await encode_json_cooperatively(message, internal="live" in message)
        if len(data) >= MAX_MESSAGE_BYTES:
            data = json.dumps(
                {"id": message["id"], "error": error_to_json(InvalidParameters("plant.too_long"))}
            ).encode()
        self._writer.write(data + b"\n")


def _is_stop(operation: str) -> bool:
    declared = OPERATIONS.get(operation)
    return declared is not None and declared.is_stop


async def _without_result(work: Awaitable[None]) -> Json:
    await work
    return {}


async def _too_busy() -> Json:
    raise ServiceUnavailable("plant.too_busy")


async def _refuse_late_motion(waited_s: float) -> Json:
    raise late_motion_error(waited_s)


class StopServer:
    """Server of ``stop.sock``: the answer is an acknowledgement at once, then the outcome."""

    def __init__(self, service: ServiceClient, path: Path) -> None:
        self._service, self.path = service, path
        self._server: asyncio.Server | None = None
        self._stops = 0

    async def open(self) -> None:
        """Listen, also again where the socket was removed; connections that are open go on. Raises OSError."""
        self._server = await reopen_server(self._server, self.path, self._connected)

    async def close(self) -> None:
        await close_server(self._server, self.path)

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            if await reader.readline() == STOP_REQUEST:
                self._stops += 1
                writer.write(STOP_RECEIVED)
                outcomes = await self._service.call(
                    PLANT_STOP.name, {}, local_actor(STOP_ALL_NAME, f"stop-{self._stops}")
                )
                writer.write(json.dumps(outcomes, ensure_ascii=False).encode() + b"\n")
                await writer.drain()
        except (ValueError, ConnectionError, DrivebusError):
            return  # without an outcome the client reports an unconfirmed stop
        finally:
            writer.close()


ConnectionHandler = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


async def reopen_server(earlier: asyncio.Server | None, path: Path, connected: ConnectionHandler) -> asyncio.Server:
    """Listen at a path that only this user may open, in place of an earlier server; its open connections go on.

    The socket that a killed service left there is removed. Raises OSError; then the earlier server goes on.
    """
    with short_socket_path(path) as short:
        _unlink(short)
        umask = os.umask(0o177)
        try:
            server = await asyncio.start_unix_server(connected, short, limit=MAX_MESSAGE_BYTES)
        finally:
            os.umask(umask)
    if earlier is not None:
        earlier.close()
    return server


def _unlink(path: str | Path) -> None:
    with contextlib.suppress(FileNotFoundError):
        os.unlink(path)  # noqa: PTH108  it may be a short way to a deep place


async def close_server(server: asyncio.Server | None, path: Path) -> None:
    if server is not None:
        server.close()
        with contextlib.suppress(OSError):  # the directory may have become read-only meanwhile
            _unlink(path)
