"""What can be asked of the history: tags, trends, files, events, documents. The reader's thread answers."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Awaitable, Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from drivebus.errors import NotFound, ParamsError, ServiceUnavailable
from drivebus.plant.historian import trend
from drivebus.plant.historian.cursors import cursor, place
from drivebus.plant.historian.export import Exports
from drivebus.plant.historian.levels import GRAINS, Level
from drivebus.plant.historian.points import Points
from drivebus.plant.historian.reader import Reader
from drivebus.plant.historian.store import Store, StoreError, Tag, Window
from drivebus.plant.historian.writer import Writer
from drivebus.plant.operations import Export, Span, Trend
from drivebus.plant.params import fault

Json = dict[str, Any]
T = TypeVar("T")


class Past:
    """The reading half of a historian."""

    def __init__(self, writer: Writer, store: Store) -> None:
        self.writer = writer
        self._reader = Reader(store, lambda: writer.unsealed)
        self._exports = Exports(self._reader)
        self._reading = ThreadPoolExecutor(1, "history-reader")

    async def _read(self, work: Callable[[], T]) -> T:
        """Raises ServiceUnavailable; the connection that failed is made anew for the next one."""
        try:
            return await asyncio.get_running_loop().run_in_executor(self._reading, work)
        except StoreError as error:
            with contextlib.suppress(StoreError):
                await asyncio.get_running_loop().run_in_executor(self._reading, self._reader.close)
            raise ServiceUnavailable("history.unavailable", why=str(error)) from error

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
        names = {tag: name for name, tag in ids.items()}

        def read(level: Level) -> dict[str, Points]:
            found = self._reader.rolled(level, list(names), *span)
            return {names[tag]: trend.thinned(points, level, *span, asked.points) for tag, points in found}

        level, shown = trend.reaching(trend.level(*span, asked.points), *span, read)
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
        raise ParamsError("plant.params", faults=[fault("to_ms", to_ms, "in_order", from_ms=from_ms)])


def _tag_json(tag: Tag) -> Json:
    drive, _, signal = tag.name.partition(".")
    return {"tag": tag.name, "drive": drive, "signal": signal, "unit": tag.unit, "text": {"en": tag.en, "zh": tag.zh}}
