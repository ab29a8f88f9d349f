"""``Historian``: what the plant keeps of the past. One thread writes, one reads, the loop never waits.

Declared loss when the power fails: what came in the last flush interval (1 s); what ``flush`` acknowledged, never.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import time
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

from drivebus.errors import ConfigurationError, NotFound, ParamsError, ServiceUnavailable
from drivebus.plant.historian import trend
from drivebus.plant.historian.cursors import cursor, place
from drivebus.plant.historian.export import Exports
from drivebus.plant.historian.intake import Intake
from drivebus.plant.historian.levels import GRAINS, Level
from drivebus.plant.historian.points import Points
from drivebus.plant.historian.reader import Reader
from drivebus.plant.historian.sql import SqlStore
from drivebus.plant.historian.sqlite import SqliteDoor
from drivebus.plant.historian.store import Document, EventRow, Store, StoreError, Tag, Window
from drivebus.plant.historian.writer import Writer
from drivebus.plant.model import HistorySetting
from drivebus.plant.operations import Export, Span, Trend
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


class Historian:
    """History of one plant. Use from one asyncio loop."""

    def __init__(
        self,
        setting: HistorySetting,
        directory: Path,
        *,
        flush_s: float = FLUSH_S,
        wall_ms: Callable[[], int] = lambda: time.time_ns() // 1_000_000,
        made: Callable[[HistorySetting, Path], tuple[Store, Store]] = stores,
    ) -> None:
        writing, reading = made(setting, directory)
        self._flush_s, self._wall_ms = flush_s, wall_ms
        self.intake = Intake()
        self.writer = Writer(writing, setting, self.intake, wall_ms=wall_ms)
        self._reader = Reader(reading, lambda: self.writer.unsealed)
        self._exports = Exports(self._reader)
        self._writing = ThreadPoolExecutor(1, "history-writer")
        self._reading = ThreadPoolExecutor(1, "history-reader")
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
        await self._write(self.writer.close)
        await self._read(self._reader.close)
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

    async def _read(self, work: Callable[[], T]) -> T:
        """Raises ServiceUnavailable; the connection that failed is made anew for the next one."""
        try:
            return await asyncio.get_running_loop().run_in_executor(self._reading, work)
        except StoreError as error:
            with contextlib.suppress(StoreError):
                await asyncio.get_running_loop().run_in_executor(self._reading, self._reader.close)
            raise ServiceUnavailable("history.unavailable", why=str(error)) from error

    # --- giving -------------------------------------------------------------------------------------------------

    @property
    def ok(self) -> bool:
        """Could the last batch be written?"""
        return self.writer.problem is None

    def status(self) -> Json:
        """``ok``, why not, and what was lost since the start."""
        return {
            "ok": self.ok, "problem": self.writer.problem, "queued": self.intake.queued,
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

    # --- asking -------------------------------------------------------------------------------------------------

    def tags(self) -> Json:
        """Every tag that has history, by name."""
        known = sorted(self.writer.tags.values(), key=lambda tag: tag.name)
        return {"tags": [_tag_json(tag) for tag in known]}

    def tag_ids(self, names: Sequence[str]) -> dict[str, int]:
        """Raises NotFound."""
        for name in names:
            if name not in self.writer.tags:
                raise NotFound("history.no_tag", tag=name)
        return {name: self.writer.tags[name].id for name in names}

    async def trend(self, asked: Trend) -> Json:
        """See ``history.trend``. Raises NotFound, ParamsError, ServiceUnavailable."""
        ids = self.tag_ids(asked.tags)
        in_order(asked.from_ms, asked.to_ms)
        return await self._read(lambda: self._trend(asked, ids))

    def _trend(self, asked: Trend, ids: Mapping[str, int]) -> Json:
        span = asked.from_ms, asked.to_ms

        def read(level: Level) -> dict[str, Points]:
            found = self._reader.rolled(level, list(ids.values()), *span)
            return {name: found[tag] for name, tag in ids.items()}

        level, found = trend.reaching(trend.level(*span, asked.points), *span, read)
        shown = {name: trend.thinned(points, level, *span, asked.points) for name, points in found.items()}
        return {"resolution": GRAINS[level].name, "series": {name: trend.series(one) for name, one in shown.items()}}

    async def markers(self, asked: Span) -> Json:
        """See ``history.markers``: newest first. Raises ParamsError, ServiceUnavailable."""
        in_order(asked.from_ms, asked.to_ms)
        last = None if asked.cursor is None else place(asked.cursor, 2)
        before = None if last is None else (last[0], last[1])
        window = Window(asked.from_ms, asked.to_ms, asked.drive, before, asked.limit + 1)
        rows = await self._read(lambda: self._reader.store.events(window))
        shown = rows[: asked.limit]
        more = cursor(shown[-1].time_ms, shown[-1].id) if len(rows) > len(shown) else None
        return {"items": [json.loads(row.data) for row in shown], "next": more}

    async def export(self, asked: Export) -> Json:
        """See ``history.export``. Raises NotFound, ParamsError, ConfigurationError, ServiceUnavailable."""
        self.tag_ids(asked.tags)
        in_order(asked.from_ms, asked.to_ms)
        tags = {name: self.writer.tags[name] for name in asked.tags}
        return await self._read(lambda: self._exports.part(asked, tags))

    async def documents(self, kind: str) -> dict[str, Any]:
        """Everything durable of a kind, by id. Raises ServiceUnavailable."""
        rows = await self._read(lambda: self._reader.store.documents(kind))
        return {row.id: json.loads(row.data) for row in rows if row.data is not None}

    def handlers(self) -> Mapping[str, Callable[[Any, Any], Awaitable[Json]]]:
        """The operations ``history.*``, called with their parameters and the actor."""

        async def tags(_params: Any, _actor: Any) -> Json:
            return self.tags()

        return {
            "history.tags": tags,
            "history.trend": lambda params, _actor: self.trend(params),
            "history.export": lambda params, _actor: self.export(params),
            "history.markers": lambda params, _actor: self.markers(params),
        }


def in_order(from_ms: int, to_ms: int) -> None:
    """Raises ParamsError."""
    if to_ms < from_ms:
        fault = {"path": "to_ms", "found": to_ms, "expected": f">= from_ms ({from_ms})"}
        raise ParamsError("plant.params", faults=[fault])


def _tag_json(tag: Tag) -> Json:
    drive, _, signal = tag.name.partition(".")
    return {"tag": tag.name, "drive": drive, "signal": signal, "unit": tag.unit, "text": {"en": tag.en, "zh": tag.zh}}
