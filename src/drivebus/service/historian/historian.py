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

from drivebus import clock
from drivebus.errors import ConfigurationError, ServiceUnavailable
from drivebus.profiles.model import Text
from drivebus.service.config.model import HistoryConfig
from drivebus.service.historian.queries import HistoryQueries
from drivebus.service.historian.sqlite import SqliteConnection
from drivebus.service.historian.store import Document, EventRow, HistoryStore, SqlStore, StoreError
from drivebus.service.historian.writer import HistoryWriter, WriteQueue
from drivebus.service.live.views import Sample

Json = dict[str, Any]
T = TypeVar("T")

log = logging.getLogger("drivebus.history")

HISTORY_FILE = "history.db"
FLUSH_INTERVAL_S = 1.0
DATABASE_OPEN_TIMEOUT_S = 1.0
"""A server that does not answer delays the start of the plant by so much."""
LOAD_BATCH_SAMPLES = 20_000
"""Samples at a time of a past that is loaded."""


def open_stores(setting: HistoryConfig, directory: Path) -> tuple[HistoryStore, HistoryStore]:
    """The writer's and the reader's way to the setting's database. Raises ConfigurationError."""
    if setting.url is None:
        path = directory / HISTORY_FILE
        return SqlStore(SqliteConnection(path)), SqlStore(SqliteConnection(path, reader=True), reader=True)
    try:
        from drivebus.service.historian.postgres import PostgresConnection
    except ImportError as error:
        raise ConfigurationError("history.no_asyncpg") from error
    return SqlStore(PostgresConnection(setting.url)), SqlStore(
        PostgresConnection(setting.url, reader=True), reader=True
    )


class Historian(HistoryQueries):
    """History of one plant. Use from one asyncio loop."""

    def __init__(
        self,
        setting: HistoryConfig,
        directory: Path,
        *,
        flush_s: float = FLUSH_INTERVAL_S,
        wall_ms: Callable[[], int] = clock.wall_ms,
        made: Callable[[HistoryConfig, Path], tuple[HistoryStore, HistoryStore]] = open_stores,
    ) -> None:
        writing, reading = made(setting, directory)
        self._flush_s = flush_s
        self.queue = WriteQueue()
        super().__init__(HistoryWriter(writing, setting, self.queue, wall_ms=wall_ms), reading)
        self._write_thread = ThreadPoolExecutor(1, "history-writer")
        self._task: asyncio.Task[None] | None = None

    # --- life ---------------------------------------------------------------------------------------------------

    async def open(self) -> None:
        """Begin to write. A database that can't be opened is tried again each second: see ``ok``."""
        self._task = asyncio.create_task(self._flush_periodically(), name="history")
        first = asyncio.ensure_future(self._on_writer_thread(self.writer.run_cycle))
        await asyncio.wait({first}, timeout=DATABASE_OPEN_TIMEOUT_S)

    async def close(self) -> None:
        """Write what is left, as far as the database takes it."""
        if self._task is not None:
            self._task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._task
        # The writer goes last: SQLite puts the newest into the file itself only when nobody else has it open.
        await self._on_reader_thread(self._reader.close)
        await self._on_writer_thread(self.writer.close)
        self._write_thread.shutdown()
        self._read_thread.shutdown()

    async def __aenter__(self) -> Historian:
        await self.open()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def _flush_periodically(self) -> None:
        while True:
            await asyncio.sleep(self._flush_s)
            try:
                await self._on_writer_thread(self.writer.run_cycle)
            except Exception as error:
                # A mistake of ours: the next round tries again, and everybody sees that this one did not work.
                self.writer.problem = repr(error)
                log.exception("history can't be written")

    def _on_writer_thread(self, work: Callable[[], T]) -> Awaitable[T]:
        return asyncio.get_running_loop().run_in_executor(self._write_thread, work)

    # --- giving -------------------------------------------------------------------------------------------------

    @property
    def ok(self) -> bool:
        """Could the last batch be written?"""
        return self.writer.problem is None

    def status(self) -> Json:
        """``ok``, why not, and what was taken in and lost since the start."""
        return {
            "ok": self.ok,
            "problem": self.writer.problem,
            "queued": self.queue.queued,
            "samples": self.queue.samples,
            "lost_samples": self.queue.lost_samples,
            "lost_notes": self.queue.lost_notes,
        }

    def append(self, samples: Iterable[Sample]) -> None:
        """Never waits. What a full queue can't take is counted as lost and becomes a gap."""
        self.queue.append(samples)

    def put_event(self, event: Json) -> None:
        """An Event of the contract (``time_ms``, ``kind``, ``drive`` and more): a marker. Never waits."""
        data = json.dumps(event, ensure_ascii=False, separators=(",", ":"))
        self.queue.put_event(EventRow(0, int(event["time_ms"]), str(event["kind"]), event.get("drive"), data))

    def set_labels(self, labels: Mapping[str, tuple[str, Text]]) -> None:
        """Tag → unit and what it is, for ``tags``; one that never has a sample is no tag."""
        self.queue.set_labels(labels)

    def put_document(self, kind: str, id: str, value: Any) -> None:
        """Keep somebody's state under a kind and an id; ``None`` forgets it."""
        data = None if value is None else json.dumps(value, ensure_ascii=False, separators=(",", ":"))
        self.queue.put_document(Document(kind, id, data))

    async def import_samples(self, samples: Iterable[Sample]) -> None:
        """A past that this plant did not live through (a demo's shift): any number, durable on return.

        Raises ServiceUnavailable.
        """
        given = iter(samples)
        while piece := list(islice(given, LOAD_BATCH_SAMPLES)):
            self.queue.append(piece)
            await self.flush()
            await self._on_writer_thread(self.writer.run_cycle)

    async def flush(self) -> None:
        """Whatever was given before is durable on return. Raises ServiceUnavailable where it can't be."""
        try:
            await self._on_writer_thread(self.writer.write)
        except StoreError as error:
            raise ServiceUnavailable("history.unavailable", why=str(error)) from error
