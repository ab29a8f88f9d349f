"""``Historian``: what the plant keeps of the past. One thread writes, one reads, the loop never waits.

Declared loss when the power fails: what came in the last flush interval (1 s); what ``flush`` acknowledged, never.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
from collections.abc import Awaitable, Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

from drivebus import seams
from drivebus.errors import ConfigurationError, ServiceUnavailable
from drivebus.plant.historian.intake import Intake
from drivebus.plant.historian.past import Past
from drivebus.plant.historian.sql import SqlStore
from drivebus.plant.historian.sqlite import SqliteDoor
from drivebus.plant.historian.store import Document, EventRow, Store, StoreError
from drivebus.plant.historian.writer import Writer
from drivebus.plant.model import HistorySetting
from drivebus.plant.view import Sample
from drivebus.profiles.model import Text

Json = dict[str, Any]
T = TypeVar("T")

log = logging.getLogger("drivebus.history")

FILE = "history.db"
FLUSH_S = 1.0
OPEN_S = 1.0
"""A server that does not answer delays the start of the plant by so much."""
PIECE = 20_000
"""Samples at a time of a past that is loaded."""


def stores(setting: HistorySetting, directory: Path) -> tuple[Store, Store]:
    """The writer's and the reader's way to the setting's database. Raises ConfigurationError."""
    if setting.url is None:
        path = directory / FILE
        return SqlStore(SqliteDoor(path)), SqlStore(SqliteDoor(path, reader=True), reader=True)
    try:
        from drivebus.plant.historian.postgres import PostgresDoor
    except ImportError as error:
        raise ConfigurationError("history.no_asyncpg") from error
    return SqlStore(PostgresDoor(setting.url)), SqlStore(PostgresDoor(setting.url, reader=True), reader=True)


class Historian(Past):
    """History of one plant. Use from one asyncio loop."""

    def __init__(
        self,
        setting: HistorySetting,
        directory: Path,
        *,
        flush_s: float = FLUSH_S,
        wall_ms: Callable[[], int] = seams.wall_ms,
        made: Callable[[HistorySetting, Path], tuple[Store, Store]] = stores,
    ) -> None:
        writing, reading = made(setting, directory)
        self._flush_s = flush_s
        self.intake = Intake()
        super().__init__(Writer(writing, setting, self.intake, wall_ms=wall_ms), reading)
        self._writing = ThreadPoolExecutor(1, "history-writer")
        self._task: asyncio.Task[None] | None = None

    # --- life ---------------------------------------------------------------------------------------------------

    async def open(self) -> None:
        """Begin to write. A database that can't be opened is tried again each second: see ``ok``."""
        self._task = asyncio.create_task(self._run(), name="history")
        first = asyncio.ensure_future(self._write(self.writer.round))
        await asyncio.wait({first}, timeout=OPEN_S)

    async def close(self) -> None:
        """Write what is left, as far as the database takes it."""
        if self._task is not None:
            self._task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._task
        # The writer goes last: SQLite puts the newest into the file itself only when nobody else has it open.
        await self._read(self._reader.close)
        await self._write(self.writer.close)
        self._writing.shutdown()
        self._reading.shutdown()

    async def __aenter__(self) -> Historian:
        await self.open()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def _run(self) -> None:
        while True:
            await asyncio.sleep(self._flush_s)
            try:
                await self._write(self.writer.round)
            except Exception as error:
                # A mistake of ours: the next round tries again, and everybody sees that this one did not work.
                self.writer.problem = repr(error)
                log.exception("history can't be written")

    def _write(self, work: Callable[[], T]) -> Awaitable[T]:
        return asyncio.get_running_loop().run_in_executor(self._writing, work)

    # --- giving -------------------------------------------------------------------------------------------------

    @property
    def ok(self) -> bool:
        """Could the last batch be written?"""
        return self.writer.problem is None

    def status(self) -> Json:
        """``ok``, why not, and what was taken in and lost since the start."""
        return {
            "ok": self.ok, "problem": self.writer.problem, "queued": self.intake.queued, "samples": self.intake.samples,
            "lost_samples": self.intake.lost_samples, "lost_notes": self.intake.lost_notes,
        }  # fmt: skip

    def append(self, samples: Iterable[Sample]) -> None:
        """Never waits. What a full queue can't take is counted as lost and becomes a gap."""
        self.intake.append(samples)

    def put_event(self, event: Json) -> None:
        """An Event of the contract (``time_ms``, ``kind``, ``drive`` and more): a marker. Never waits."""
        data = json.dumps(event, ensure_ascii=False, separators=(",", ":"))
        self.intake.put_event(EventRow(0, int(event["time_ms"]), str(event["kind"]), event.get("drive"), data))

    def label(self, labels: Mapping[str, tuple[str, Text]]) -> None:
        """Tag → unit and what it is, for ``tags``; one that never has a sample is no tag."""
        self.intake.label(labels)

    def put_document(self, kind: str, id: str, value: Any) -> None:
        """Keep somebody's state under a kind and an id; ``None`` forgets it."""
        data = None if value is None else json.dumps(value, ensure_ascii=False, separators=(",", ":"))
        self.intake.put_document(Document(kind, id, data))

    async def load(self, samples: Iterable[Sample]) -> None:
        """A past that this plant did not live through (a demo's shift): any number, durable on return.

        Raises ServiceUnavailable.
        """
        given = iter(samples)
        while piece := list(islice(given, PIECE)):
            self.intake.append(piece)
            await self.flush()
            await self._write(self.writer.round)

    async def flush(self) -> None:
        """Whatever was given before is durable on return. Raises ServiceUnavailable where it can't be."""
        try:
            await self._write(self.writer.write)
        except StoreError as error:
            raise ServiceUnavailable("history.unavailable", why=str(error)) from error
