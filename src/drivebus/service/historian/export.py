"""Export of the history as CSV or Parquet, in parts that each fit one line of the service's socket."""

from __future__ import annotations

import csv
import io
from base64 import b64encode
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from typing import Any
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from drivebus.errors import ConfigurationError, InvalidParameters
from drivebus.service.api.errors import param_fault
from drivebus.service.api.operations.history import UTC as UTC_NAME
from drivebus.service.api.operations.history import ExportParams
from drivebus.service.api.paging import decode_cursor, encode_cursor
from drivebus.service.historian.points import LEVEL_BY_NAME, QUALITY_BY_CODE, RESOLUTIONS, ResolutionLevel
from drivebus.service.historian.reader import HistoryReader
from drivebus.service.historian.store import Tag
from drivebus.types import Json
from drivebus.values import Quality

ExportRow = tuple[Any, ...]

CSV_ROWS_PER_PART = 20_000
"""Rows of one CSV part: about 1.5 MB."""
MAX_PARQUET_EXPORTS = 4
"""Concurrent Parquet exports; each holds a part in memory. A further one ends the oldest."""

SAMPLE_COLUMNS = ("time", "tag", "value", "unit", "quality", "number")
"""Columns of raw samples; ``number``: order of arrival."""
ROLLUP_COLUMNS = ("time", "tag", "minimum", "mean", "maximum", "unit", "quality", "values")
"""Columns of rollups; ``values``: number of values."""

_FORMULA_PREFIXES = ("=", "+", "-", "@", "\t", "\r", "\n", "＝", "＋", "－", "＠")


def escape_formula(text: str) -> str:
    """Return text that no spreadsheet evaluates as a formula (CSV injection)."""
    return f"'{text}" if text.startswith(_FORMULA_PREFIXES) else text


def iso_time(time_ms: int) -> str:
    return datetime.fromtimestamp(time_ms / 1000, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def local_time(time_ms: int, zone: ZoneInfo) -> str:
    """Return a time as spreadsheets read it, without offset: the heading names the zone."""
    return datetime.fromtimestamp(time_ms / 1000, zone).replace(tzinfo=None).isoformat(" ", "milliseconds")


def time_format(timezone: str) -> Callable[[int], str]:
    """Return the function that writes a time. Raises InvalidParameters for a zone that this computer does not have."""
    if timezone == UTC_NAME:
        return iso_time
    try:
        return partial(local_time, zone=ZoneInfo(timezone))
    except (ValueError, OSError, ZoneInfoNotFoundError) as error:
        raise InvalidParameters(
            "plant.params", faults=[param_fault("timezone", timezone, "unknown_timezone")]
        ) from error


def wide_rows(rows: Sequence[ExportRow], names: Sequence[str], *, is_raw: bool) -> list[ExportRow]:
    """Return one row for each time with a column for each tag, empty where it has no value of this time.

    Of two samples of one time the later one counts.
    """
    columns = SAMPLE_COLUMNS if is_raw else ROLLUP_COLUMNS
    value_at, quality_at = columns.index("value" if is_raw else "mean"), columns.index("quality")
    place = {name: at for at, name in enumerate(names, 1)}
    by_time: dict[int, list[Any]] = {}
    for row in rows:
        time_ms, name = row[:2]
        is_bad = is_raw and row[quality_at] == str(Quality.BAD)
        by_time.setdefault(time_ms, [time_ms, *[None] * len(names)])[place[name]] = None if is_bad else row[value_at]
    return [tuple(line) for line in by_time.values()]


def export_columns(params: ExportParams) -> tuple[str, ...]:
    """Return the columns of the rows of an export."""
    return SAMPLE_COLUMNS if params.resolution == "raw" else ROLLUP_COLUMNS


def csv_heading(params: ExportParams, tags: Mapping[str, Tag]) -> list[str]:
    time = "time" if params.timezone == UTC_NAME else f"time ({params.timezone})"
    if params.layout == "wide":
        units = {name: f" [{tag.unit}]" if tag.unit else "" for name, tag in tags.items()}
        return [time, *(escape_formula(name + units[name]) for name in tags)]
    return [time, *export_columns(params)[1:]]


def export_windows(
    reader: HistoryReader, params: ExportParams, tags: Mapping[str, Tag], from_ms: int
) -> Iterator[tuple[int, list[ExportRow]]]:
    """Yield the start (ms) and the sorted rows of each partition, from the one that contains ``from_ms``."""
    level = LEVEL_BY_NAME[params.resolution]
    ids = [tag.id for tag in tags.values()]
    length = RESOLUTIONS[level].partition_ms
    start = reader.next_partition(level, ids, from_ms // length * length)
    while start is not None and start <= params.to_ms:
        first, last = max(start, params.from_ms), min(start + length - 1, params.to_ms)
        rows = (
            _sample_rows(reader, tags, first, last)
            if level is ResolutionLevel.RAW
            else _point_rows(reader, level, tags, first, last)
        )
        yield start, rows
        start = reader.next_partition(level, ids, start + length)


def _sample_rows(reader: HistoryReader, tags: Mapping[str, Tag], first: int, last: int) -> list[ExportRow]:
    samples = reader.samples([tag.id for tag in tags.values()], first, last)
    rows = [
        (time, name, None if value != value else value, tag.unit, str(QUALITY_BY_CODE[code]), number)
        for name, tag in tags.items()
        for number, time, value, code in zip(samples[tag.id].number, *samples[tag.id].samples, strict=True)
    ]
    return sorted(rows, key=lambda row: (row[0], row[1], row[5]))


def _point_rows(
    reader: HistoryReader, level: ResolutionLevel, tags: Mapping[str, Tag], first: int, last: int
) -> list[ExportRow]:
    points = dict(reader.points(level, [tag.id for tag in tags.values()], first, last))
    rows = [
        (time, name, *((low, mean, high) if n else (None, None, None)), tag.unit, str(QUALITY_BY_CODE[code]), n)
        for name, tag in tags.items()
        for time, n, low, mean, high, code in zip(*points[tag.id].columns(), strict=True)
    ]
    return sorted(rows, key=lambda row: row[:2])


@dataclass(slots=True)
class ParquetExport:
    """Parquet export that is under way."""

    parts: Iterator[bytes]
    sent: int = 0
    """Number of parts that the client has."""


class HistoryExporter:
    """Exports of one reader. All methods run on the reader's thread."""

    def __init__(self, reader: HistoryReader) -> None:
        self._reader = reader
        self._parquet_exports: dict[int, ParquetExport] = {}
        self._last_id = 0

    def next_part(self, params: ExportParams, tags: Mapping[str, Tag]) -> Json:
        """Return one part; ``next`` is None in the last. Raises InvalidParameters, ConfigurationError, StoreError."""
        if params.format != "csv" and (params.layout, params.timezone) != ("long", UTC_NAME):
            raise InvalidParameters("plant.params", faults=[param_fault("format", params.format, "csv_only")])
        wide = "-wide" if params.layout == "wide" else ""
        name = f"history-{params.resolution}{wide}-{iso_time(params.from_ms)[:10]}.{params.format}"
        part = self._csv(params, tags) if params.format == "csv" else self._parquet(params, tags)
        return {"file": name, **part}

    def _csv(self, params: ExportParams, tags: Mapping[str, Tag]) -> Json:
        """Return a part of a CSV file. The cursor holds the partition and the row in it, so that no state is needed."""
        text = io.StringIO()
        writer = csv.writer(text)
        at, skip = (params.from_ms, 0) if params.cursor is None else decode_cursor(params.cursor, 2)
        shown_time, is_raw = time_format(params.timezone), params.resolution == "raw"
        if params.cursor is None:
            writer.writerow(csv_heading(params, tags))
        rows_left = CSV_ROWS_PER_PART
        for start, samples in export_windows(self._reader, params, tags, at):
            rows = wide_rows(samples, [*tags], is_raw=is_raw) if params.layout == "wide" else samples
            part = rows[skip : skip + rows_left]
            writer.writerows([shown_time(row[0]), *map(_csv_cell, row[1:])] for row in part)
            rows_left -= len(part)
            if skip + len(part) < len(rows):
                return {"text": text.getvalue(), "next": encode_cursor(start, skip + len(part))}
            skip = 0
        return {"text": text.getvalue(), "next": None}

    def _parquet(self, params: ExportParams, tags: Mapping[str, Tag]) -> Json:
        """Return a part of a Parquet file. The cursor holds the number of the export and of the parts sent."""
        try:
            from drivebus.service.historian.parquet import parquet_parts
        except ImportError as error:
            raise ConfigurationError("history.no_pyarrow") from error
        if params.cursor is None:
            self._last_id, id, sent = self._last_id + 1, self._last_id + 1, 0
            rows = (rows for _, rows in export_windows(self._reader, params, tags, params.from_ms))
            self._parquet_exports[id] = ParquetExport(parquet_parts(rows, export_columns(params)))
            if len(self._parquet_exports) > MAX_PARQUET_EXPORTS:
                del self._parquet_exports[min(self._parquet_exports)]
        else:
            id, sent = decode_cursor(params.cursor, 2)
        export = self._parquet_exports.get(id)
        if export is None or export.sent != sent:
            raise InvalidParameters("plant.params", faults=[param_fault("cursor", params.cursor, "export_over")])
        data = next(export.parts, None)
        if data is None:
            del self._parquet_exports[id]
            return {"base64": "", "next": None}
        export.sent += 1
        return {"base64": b64encode(data).decode(), "next": encode_cursor(id, export.sent)}


def _csv_cell(value: Any) -> Any:
    if value is None:
        return ""
    return escape_formula(value) if isinstance(value, str) else value
