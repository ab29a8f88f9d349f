"""Queries of the history: tags, trends, events, exports, documents. They run on the reader's thread."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from drivebus.errors import InvalidParameters, NotFound, ServiceUnavailable
from drivebus.service.api.errors import param_fault
from drivebus.service.api.operations.history import ExportParams, TimeRangeParams, TrendParams
from drivebus.service.api.paging import decode_cursor, encode_cursor
from drivebus.service.api.strict_json import MalformedJson, parse_json
from drivebus.service.historian.export import HistoryExporter
from drivebus.service.historian.points import (
    RESOLUTIONS,
    Points,
    ResolutionLevel,
    coarsest_covering,
    coarsest_sufficient,
    downsample,
    series_json,
)
from drivebus.service.historian.reader import HistoryReader
from drivebus.service.historian.store import EventQuery, HistoryStore, StoreError, Tag
from drivebus.service.historian.writer import HistoryWriter
from drivebus.types import Json

T = TypeVar("T")


class HistoryQueries:
    """Queries over the durable history and the writer's open blocks."""

    def __init__(self, writer: HistoryWriter, store: HistoryStore) -> None:
        self._writer = writer
        self._reader = HistoryReader(store, lambda: writer.open_blocks)
        self._exports = HistoryExporter(self._reader)
        self._read_thread = ThreadPoolExecutor(1, "history-reader")

    async def _on_reader_thread(self, work: Callable[[], T]) -> T:
        """Run ``work`` on the reader's thread. After an error the next query opens a new connection.

        Raises ServiceUnavailable.
        """
        try:
            return await asyncio.get_running_loop().run_in_executor(self._read_thread, work)
        except StoreError as error:
            with contextlib.suppress(StoreError):
                await asyncio.get_running_loop().run_in_executor(self._read_thread, self._reader.close)
            raise ServiceUnavailable("history.unavailable", why=error.reason) from error

    async def close(self) -> None:
        """Close the reader's connection. One that the database has cut counts as closed: the service ends as usual."""
        with contextlib.suppress(ServiceUnavailable):
            await self._on_reader_thread(self._reader.close)
        self._read_thread.shutdown()

    def tags(self) -> Json:
        """Return every tag that has samples, by name."""
        known = sorted(self._writer.tags.values(), key=lambda tag: tag.name)
        return {"tags": [_tag_json(tag) for tag in known]}

    def tag_ids(self, names: Sequence[str]) -> dict[str, int]:
        """Return the ids of tags. Raises NotFound."""
        for name in names:
            if name not in self._writer.tags:
                raise NotFound("history.no_tag", tag=name)
        return {name: self._writer.tags[name].id for name in names}

    async def trend(self, params: TrendParams) -> Json:
        """Answer ``history.trend``. Raises NotFound, InvalidParameters, ServiceUnavailable."""
        ids = self.tag_ids(params.tags)
        check_time_order(params.from_ms, params.to_ms)
        return await self._on_reader_thread(lambda: self._trend(params, ids))

    def _trend(self, params: TrendParams, ids: Mapping[str, int]) -> Json:
        span = params.from_ms, params.to_ms
        names = {tag: name for name, tag in ids.items()}

        def read(level: ResolutionLevel) -> dict[str, Points]:
            stored = self._reader.points(level, list(names), *span)
            return {names[tag]: downsample(points, level, *span, params.points) for tag, points in stored}

        level, shown = coarsest_covering(coarsest_sufficient(*span, params.points), *span, read)
        return {
            "resolution": RESOLUTIONS[level].name,
            "series": {name: series_json(points) for name, points in shown.items()},
        }

    async def events(self, params: TimeRangeParams) -> Json:
        """Return a page of events, newest first. Raises InvalidParameters, ServiceUnavailable."""
        check_time_order(params.from_ms, params.to_ms)
        before = None
        if params.cursor is not None:
            time_ms, id = decode_cursor(params.cursor, 2)
            before = (time_ms, id)
        query = EventQuery(params.from_ms, params.to_ms, params.drive, before, params.limit + 1)
        rows = await self._on_reader_thread(lambda: self._reader.store.events(query))
        newest = rows[: params.limit]
        more = encode_cursor(newest[-1].time_ms, newest[-1].id) if len(rows) > len(newest) else None
        decoded = (_decoded(row.data) for row in newest)
        items = [event for event in decoded if isinstance(event, dict)]  # a damaged one hides no other
        return {"items": items, "next": more}

    async def export(self, params: ExportParams) -> Json:
        """Answer ``history.export``. Raises NotFound, InvalidParameters, ConfigurationError, ServiceUnavailable."""
        self.tag_ids(params.tags)
        check_time_order(params.from_ms, params.to_ms)
        tags = {name: self._writer.tags[name] for name in params.tags}
        return await self._on_reader_thread(lambda: self._exports.next_part(params, tags))

    async def documents(self, kind: str) -> dict[str, Any]:
        """Return all durable documents of a kind by id; the text of one that is no JSON. Raises ServiceUnavailable."""
        rows = await self._on_reader_thread(lambda: self._reader.store.documents(kind))
        return {row.id: _decoded(row.data) for row in rows if row.data is not None}


def check_time_order(from_ms: int, to_ms: int) -> None:
    """Raise InvalidParameters if a time range ends before it begins."""
    if to_ms < from_ms:
        raise InvalidParameters("plant.params", faults=[param_fault("to_ms", to_ms, "in_order", from_ms=from_ms)])


def _decoded(text: str) -> Any:
    """Return a stored JSON document; the text itself where it is damaged."""
    try:
        return parse_json(text)
    except MalformedJson:
        return text


def _tag_json(tag: Tag) -> Json:
    drive, _, signal = tag.name.partition(".")
    return {"tag": tag.name, "drive": drive, "signal": signal, "unit": tag.unit, "text": tag.text.by_language()}
