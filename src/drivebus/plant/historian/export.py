"""History as a file for other programs, in parts that each fit one line of the plant's socket."""

from __future__ import annotations

import csv
import io
from base64 import b64encode
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from typing import Any

from drivebus.errors import ConfigurationError, ParamsError
from drivebus.plant.historian.cursors import cursor, place
from drivebus.plant.historian.levels import BY_NAME, GRAINS, Level
from drivebus.plant.historian.points import QUALITIES
from drivebus.plant.historian.reader import Reader
from drivebus.plant.historian.store import Tag
from drivebus.plant.operations import Export
from drivebus.plant.params import fault

Json = dict[str, Any]
Row = tuple[Any, ...]

ROWS = 20_000
"""Of CSV in one part: some 1.5 MB."""
AT_ONCE = 4
"""Parquet exports that may be under way; each holds a part in memory. A further one ends the oldest."""

COLUMNS: dict[bool, tuple[str, ...]] = {
    True: ("time", "tag", "value", "unit", "quality", "number"),
    False: ("time", "tag", "minimum", "mean", "maximum", "unit", "quality", "values"),
}
"""Of raw samples (``number``: in the order of their coming) and of rollups (``values``: how many it stands for)."""

_FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n", "＝", "＋", "－", "＠")


def neutral(text: str) -> str:
    """Text that no spreadsheet takes for a formula (S17)."""
    return f"'{text}" if text.startswith(_FORMULA) else text


def iso(time_ms: int) -> str:
    return datetime.fromtimestamp(time_ms / 1000, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def windows(reader: Reader, asked: Export, tags: Mapping[str, Tag], from_ms: int) -> Iterator[tuple[int, list[Row]]]:
    """Stretch by stretch: its beginning (ms) and its rows by time, from the one on that ``from_ms`` lies in."""
    level = BY_NAME[asked.resolution]
    ids = [tag.id for tag in tags.values()]
    length = GRAINS[level].partition_ms
    start = reader.following(level, ids, from_ms // length * length)
    while start is not None and start <= asked.to_ms:
        first, last = max(start, asked.from_ms), min(start + length - 1, asked.to_ms)
        rows = _samples(reader, tags, first, last) if level is Level.RAW else _points(reader, level, tags, first, last)
        yield start, rows
        start = reader.following(level, ids, start + length)


def _samples(reader: Reader, tags: Mapping[str, Tag], first: int, last: int) -> list[Row]:
    found = reader.samples([tag.id for tag in tags.values()], first, last)
    rows = [
        (time, name, None if value != value else value, tag.unit, str(QUALITIES[code]), number)
        for name, tag in tags.items()
        for number, time, value, code in zip(found[tag.id].number, *found[tag.id].samples, strict=True)
    ]
    return sorted(rows, key=lambda row: (row[0], row[1], row[5]))


def _points(reader: Reader, level: Level, tags: Mapping[str, Tag], first: int, last: int) -> list[Row]:
    found = dict(reader.rolled(level, [tag.id for tag in tags.values()], first, last))
    rows = [
        (time, name, *((low, mean, high) if n else (None, None, None)), tag.unit, str(QUALITIES[code]), n)
        for name, tag in tags.items()
        for time, n, low, mean, high, code in zip(*found[tag.id].columns(), strict=True)
    ]
    return sorted(rows, key=lambda row: row[:2])


class Exports:
    """All methods run on the reader's thread."""

    def __init__(self, reader: Reader) -> None:
        self._reader = reader
        self._begun: dict[int, tuple[int, Iterator[bytes]]] = {}
        self._serial = 0

    def part(self, asked: Export, tags: Mapping[str, Tag]) -> Json:
        """One part; ``next`` is None after the last. Raises ParamsError, ConfigurationError, StoreError."""
        name = f"history-{asked.resolution}-{iso(asked.from_ms)[:10]}.{asked.format}"
        made = self._csv(asked, tags) if asked.format == "csv" else self._parquet(asked, tags)
        return {"file": name, **made}

    def _csv(self, asked: Export, tags: Mapping[str, Tag]) -> Json:
        """Without a memory between the parts: the cursor tells the stretch and the row in it."""
        text = io.StringIO()
        writer = csv.writer(text)
        at, skip = (asked.from_ms, 0) if asked.cursor is None else place(asked.cursor, 2)
        if asked.cursor is None:
            writer.writerow(COLUMNS[asked.resolution == "raw"])
        room = ROWS
        for start, rows in windows(self._reader, asked, tags, at):
            part = rows[skip : skip + room]
            writer.writerows([iso(row[0]), *map(_cell, row[1:])] for row in part)
            room -= len(part)
            if skip + len(part) < len(rows):
                return {"text": text.getvalue(), "next": cursor(start, skip + len(part))}
            skip = 0
        return {"text": text.getvalue(), "next": None}

    def _parquet(self, asked: Export, tags: Mapping[str, Tag]) -> Json:
        """The cursor tells which export and how many parts are gone."""
        try:
            from drivebus.plant.historian.parquet import parts
        except ImportError as error:
            raise ConfigurationError("history.no_pyarrow") from error
        if asked.cursor is None:
            self._serial, serial, gone = self._serial + 1, self._serial + 1, 0
            rows = (rows for _, rows in windows(self._reader, asked, tags, asked.from_ms))
            self._begun[serial] = (0, parts(rows, COLUMNS[asked.resolution == "raw"]))
            if len(self._begun) > AT_ONCE:
                del self._begun[min(self._begun)]
        else:
            serial, gone = place(asked.cursor, 2)
        done, made = self._begun.get(serial, (-1, iter(())))
        if done != gone:
            raise ParamsError("plant.params", faults=[fault("cursor", asked.cursor, "export_over")])
        data = next(made, None)
        if data is None:
            del self._begun[serial]
            return {"base64": "", "next": None}
        self._begun[serial] = (gone + 1, made)
        return {"base64": b64encode(data).decode(), "next": cursor(serial, gone + 1)}


def _cell(value: Any) -> Any:
    if value is None:
        return ""
    return neutral(value) if isinstance(value, str) else value
