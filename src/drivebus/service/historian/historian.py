"""Historian of a plant: samples with rollups, events and documents. One thread writes, one reads; the event loop never
waits.

A power failure may lose the last flush interval (1 s), but nothing that ``flush`` has acknowledged.
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

from drivebus import clock, i18n
from drivebus.errors import ConfigurationError, ServiceUnavailable
from drivebus.service.config.model import HistoryConfig
from drivebus.service.historian.queries import HistoryQueries
from drivebus.service.historian.sqlite import SqliteConnection
from drivebus.service.historian.store import Document, EventRow, HistoryStore, StoreError
from drivebus.service.historian.writer import HistoryWriter, WriteQueue
from drivebus.service.live.views import Sample, text_json
from drivebus.types import Json
from drivebus.values import Text, bilingual_text

T = TypeVar("T")

LOG = logging.getLogger("drivebus.history")

HISTORY_FILE = "history.db"
FLUSH_INTERVAL_S = 1.0
DATABASE_OPEN_TIMEOUT_S = 1.0
"""A database server that does not answer delays the start of the service by this time at most."""
IMPORT_BATCH_SAMPLES = 20_000
"""Samples of an import that are in memory at a time."""


def open_stores(setting: HistoryConfig, directory: Path) -> tuple[HistoryStore, HistoryStore]:
    """Return the writer's and the reader's store of the configured database. Raises ConfigurationError."""
    if setting.url is None:
        path = directory / HISTORY_FILE
        return HistoryStore(SqliteConnection(path)), HistoryStore(SqliteConnection(path, reader=True), reader=True)
    try:
        from drivebus.service.historian.postgres import PostgresConnection
    except ImportError as error:
        raise ConfigurationError("history.no_asyncpg") from error
    writing = HistoryStore(PostgresConnection(setting.url))
    return writing, HistoryStore(PostgresConnection(setting.url, reader=True), reader=True)


class Historian:
    """History of one plant. Use it from one event loop."""

    def __init__(
        self,
        setting: HistoryConfig,
        directory: Path,
        *,
        flush_s: float = FLUSH_INTERVAL_S,
        wall_ms: Callable[[], int] = clock.wall_ms,
        open_stores: Callable[[HistoryConfig, Path], tuple[HistoryStore, HistoryStore]] = open_stores,
    ) -> None:
        writing, reading = open_stores(setting, directory)
        self._flush_s = flush_s
        self.queue = WriteQueue()
        self.writer = HistoryWriter(writing, setting, self.queue, wall_ms=wall_ms)
        self.queries = HistoryQueries(self.writer, reading)
        self._write_thread = ThreadPoolExecutor(1, "history-writer")
        self._task: asyncio.Task[None] | None = None

    async def open(self) -> None:
        """Start writing. A database that cannot be opened is tried again every flush interval; see ``ok``."""
        self._task = asyncio.create_task(self._flush_periodically(), name="history")
        first = asyncio.ensure_future(self._on_writer_thread(self.writer.run_cycle))
        await asyncio.wait({first}, timeout=DATABASE_OPEN_TIMEOUT_S)

    async def close(self) -> None:
        """Write what is queued, as far as the database accepts it, and close."""
        if self._task is not None:
            self._task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._task
        # The writer closes last: SQLite moves its WAL into the database file only on the last connection's close.
        await self.queries.close()
        await self._on_writer_thread(self.writer.close)
        self._write_thread.shutdown()

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
                # A defect must not end the task: report it and try again in the next interval.
                self.writer.problem = bilingual_text("history.defect", detail=repr(error))
                LOG.exception(i18n.preferred_text("log.history_failed"))

    def _on_writer_thread(self, work: Callable[[], T]) -> Awaitable[T]:
        return asyncio.get_running_loop().run_in_executor(self._write_thread, work)

    @property
    def ok(self) -> bool:
        """Whether the last batch was written."""
        return self.writer.problem is None

    @property
    def problem(self) -> Text | None:
        """Reason why the last batch could not be written; None where it was."""
        return self.writer.problem

    def status(self) -> Json:
        """Return ``ok``, the problem, and the numbers of accepted and lost items since the start."""
        return {
            "ok": self.ok,
            "problem": text_json(self.writer.problem),
            "queued": self.queue.queued,
            "samples": self.queue.samples,
            "lost_samples": self.queue.lost_samples,
            "lost_notes": self.queue.lost_notes,
        }

    def append(self, samples: Iterable[Sample]) -> None:
        """Queue samples without waiting. What a full queue cannot take is counted as lost and becomes a gap."""
        self.queue.append(samples)

    def put_event(self, event: Json) -> None:
        """Queue an event (``time_ms``, ``kind``, ``drive`` and more) without waiting."""
        data = json.dumps(event, ensure_ascii=False, separators=(",", ":"))
        self.queue.put_event(EventRow(0, int(event["time_ms"]), str(event["kind"]), event.get("drive"), data))

    def set_labels(self, labels: Mapping[str, tuple[str, Text]]) -> None:
        """Set unit and text of tags. A tag appears in queries only once it has a sample."""
        self.queue.set_labels(labels)

    def put_document(self, kind: str, id: str, value: Any) -> None:
        """Queue a JSON document under a kind and an id; ``None`` deletes it. Never waits."""
        data = None if value is None else json.dumps(value, ensure_ascii=False, separators=(",", ":"))
        self.queue.put_document(Document(kind, id, data))

    async def documents(self, kind: str) -> dict[str, Any]:
        """Return all durable documents of a kind by id; the text of one that is no JSON. Raises ServiceUnavailable."""
        return await self.queries.documents(kind)

    async def import_samples(self, samples: Iterable[Sample]) -> None:
        """Write any number of past samples durably. Raises ServiceUnavailable."""
        remaining = iter(samples)
        while batch := list(islice(remaining, IMPORT_BATCH_SAMPLES)):
            self.queue.append(batch)
            await self.flush()
            await self._on_writer_thread(self.writer.run_cycle)

    async def flush(self) -> None:
        """Make everything queued before the call durable. Raises ServiceUnavailable."""
        try:
            await self._on_writer_thread(self.writer.write)
        except StoreError as error:
            raise ServiceUnavailable("history.unavailable", why=error.reason) from error
