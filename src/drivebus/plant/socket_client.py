"""``PlantClient`` over the plant's socket. Connects when first asked, and again when the plant was away meanwhile."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
from collections.abc import AsyncIterator, Sequence
from pathlib import Path
from typing import Any

from drivebus.errors import ServiceUnavailable
from drivebus.plant.actor import Actor
from drivebus.plant.failure import raised
from drivebus.plant.socket_paths import LONGEST_LINE, reachable
from drivebus.plant.topics import closed

Json = dict[str, Any]
GONE: Json = {"gone": True}
WAITING = 64
"""A reader that leaves so many live messages lying is closed."""


class SocketClient:
    """One connection for everything. Belongs to one event loop."""

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self._writer: asyncio.StreamWriter | None = None
        self._reading: asyncio.Task[None] | None = None
        self._numbers = itertools.count(1)
        self._waiting: dict[int, asyncio.Queue[Json]] = {}
        self._connecting = asyncio.Lock()

    async def call(self, operation: str, params: Json, actor: Actor) -> Json:
        """See ``PlantClient.call``. Raises ServiceUnavailable where the plant does not answer."""
        result: Json = await self._ask({"op": operation, "params": params, "actor": actor.as_json()})
        return result

    async def record(self, entry: Json, actor: Actor) -> None:
        """See ``PlantClient.record``."""
        await self._ask({"record": entry, "actor": actor.as_json()})

    async def live(self, patterns: Sequence[str], actor: Actor, interval_s: float = 0.25) -> AsyncIterator[Json]:
        """See ``PlantClient.live``. Raises ServiceUnavailable where the plant does not answer, or goes."""
        asked = {"live": list(patterns), "interval_s": interval_s, "actor": actor.as_json()}
        number, answers = await self._send(asked, WAITING)
        try:
            while True:
                message = _checked(await answers.get())["live"]
                yield message
                if message["type"] == "closed":
                    return
        finally:
            self._waiting.pop(number, None)
            self._write({"id": number, "end": True})

    async def close(self) -> None:
        """No more. Idempotent."""
        reading, self._reading = self._reading, None
        if reading is not None:
            reading.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await reading

    async def _ask(self, message: Json) -> Any:
        number, answers = await self._send(message, 1)
        try:
            return _checked(await answers.get())["result"]
        finally:
            self._waiting.pop(number, None)

    async def _send(self, message: Json, waiting: int) -> tuple[int, asyncio.Queue[Json]]:
        async with self._connecting:
            if self._writer is None:
                await self._connect()
        number = next(self._numbers)
        answers = self._waiting[number] = asyncio.Queue(waiting)
        self._write({"id": number, **message})
        return number, answers

    def _write(self, message: Json) -> None:
        if self._writer is not None:
            self._writer.write(json.dumps(message, ensure_ascii=False).encode() + b"\n")

    async def _connect(self) -> None:
        try:
            with reachable(self.path) as short:
                reader, self._writer = await asyncio.open_unix_connection(short, limit=LONGEST_LINE)
        except OSError as error:
            raise ServiceUnavailable("plant.not_there", socket=str(self.path)) from error
        self._reading = asyncio.create_task(self._read(reader, self._writer), name="plant socket")

    async def _read(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while line := await reader.readline():
                self._heard(json.loads(line))
        except (OSError, ValueError):
            pass
        finally:
            self._writer = None
            writer.close()
            for answers in self._waiting.values():
                _instead(answers, GONE)

    def _heard(self, message: Json) -> None:
        """A reader of live messages that hangs must not keep this connection from anybody's stop: it is closed."""
        number = message["id"]
        answers = self._waiting.get(number)
        if answers is None:
            return
        if answers.full():
            self._waiting.pop(number)
            _instead(answers, {"live": closed("slow")})
            self._write({"id": number, "end": True})
        else:
            answers.put_nowait(message)


def _instead(answers: asyncio.Queue[Json], message: Json) -> None:
    """The last thing its reader hears."""
    while not answers.empty():
        answers.get_nowait()
    answers.put_nowait(message)


def _checked(message: Json) -> Json:
    if message is GONE:
        raise ServiceUnavailable("plant.gone")
    if "error" in message:
        raise raised(message["error"])
    return message
