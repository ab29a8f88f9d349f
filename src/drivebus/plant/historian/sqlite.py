"""The one door to sqlite3: history in one file beside the plant's other files. WAL, and every commit is synced."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import wraps
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypeVar

from drivebus.plant.historian.levels import Level
from drivebus.plant.historian.store import (
    SCHEMA,
    Batch,
    Block,
    Contents,
    Document,
    EventRow,
    Seal,
    StoreError,
    Tag,
    Window,
)

P = ParamSpec("P")
R = TypeVar("R")

_TABLES = """
CREATE TABLE meta (key TEXT PRIMARY KEY, value INTEGER NOT NULL) WITHOUT ROWID;
CREATE TABLE tag (id INTEGER PRIMARY KEY, name TEXT NOT NULL UNIQUE, unit TEXT NOT NULL, en TEXT NOT NULL,
                  zh TEXT NOT NULL, sealed INTEGER NOT NULL DEFAULT 0);
CREATE TABLE journal (id INTEGER PRIMARY KEY, data BLOB NOT NULL);
CREATE TABLE block (id INTEGER PRIMARY KEY, level INTEGER NOT NULL, tag INTEGER NOT NULL, start_ms INTEGER NOT NULL,
                    number INTEGER NOT NULL, stored_ms INTEGER NOT NULL, data BLOB NOT NULL);
CREATE UNIQUE INDEX block_place ON block (level, tag, start_ms, number);
CREATE INDEX block_stored ON block (level, stored_ms);
CREATE TABLE event (id INTEGER PRIMARY KEY, time_ms INTEGER NOT NULL, kind TEXT NOT NULL, drive TEXT,
                    data TEXT NOT NULL);
CREATE INDEX event_time ON event (time_ms, id);
CREATE INDEX event_drive ON event (drive, time_ms, id);
CREATE TABLE document (kind TEXT NOT NULL, id TEXT NOT NULL, data TEXT NOT NULL, PRIMARY KEY (kind, id)) WITHOUT ROWID;
"""
_PUT_TAG = """INSERT INTO tag (id, name, unit, en, zh) VALUES (?, ?, ?, ?, ?)
ON CONFLICT (id) DO UPDATE SET unit = excluded.unit, en = excluded.en, zh = excluded.zh"""
_PUT_BLOCK = """INSERT INTO block (level, tag, start_ms, number, stored_ms, data) VALUES (?, ?, ?, ?, ?, ?)
ON CONFLICT (level, tag, start_ms, number) DO UPDATE SET stored_ms = excluded.stored_ms, data = excluded.data"""
_RAISE = "INSERT INTO meta VALUES (?, ?) ON CONFLICT (key) DO UPDATE SET value = max(value, excluded.value)"
_EVENTS = """SELECT id, time_ms, kind, drive, data FROM event
WHERE time_ms BETWEEN ? AND ? AND (? IS NULL OR drive = ?) AND (time_ms, id) < (?, ?)
ORDER BY time_ms DESC, id DESC LIMIT ?"""


def _translated(
    method: Callable[Concatenate[SqliteStore, P], R],
) -> Callable[Concatenate[SqliteStore, P], R]:
    """A method whose database errors are StoreError; what it had begun is undone."""

    @wraps(method)
    def wrapped(self: SqliteStore, /, *args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return method(self, *args, **kwargs)
        except (sqlite3.Error, OSError) as error:
            raise StoreError(str(error)) from error

    return wrapped


class SqliteStore:
    """One connection to ``path``; a reader never writes."""

    def __init__(self, path: Path, *, reader: bool = False) -> None:
        self.path = path
        self._reader = reader
        self._open: sqlite3.Connection | None = None

    @property
    def _database(self) -> sqlite3.Connection:
        if self._open is None:
            raise StoreError("not open")
        return self._open

    @_translated
    def open(self) -> Contents:
        if not self._reader:
            self.path.touch(mode=0o600)
        mode = "ro" if self._reader else "rw"
        self._open = sqlite3.connect(f"{self.path.as_uri()}?mode={mode}", uri=True, isolation_level=None, timeout=5.0)
        self._database.execute("PRAGMA secure_delete = OFF")
        if not self._reader:
            self._prepare()
        return self._contents()

    def _prepare(self) -> None:
        for pragma in ("auto_vacuum = INCREMENTAL", "journal_mode = WAL", "synchronous = FULL"):
            self._database.execute(f"PRAGMA {pragma}").fetchall()
        (version,) = self._database.execute("PRAGMA user_version").fetchone()
        if version > SCHEMA:
            raise StoreError(f"made by a later version of drivebus (tables {version}, known {SCHEMA})")
        if version == 0:
            with self._transaction():
                for statement in _TABLES.split(";"):
                    self._database.execute(statement)
                self._database.execute(f"PRAGMA user_version = {SCHEMA}")

    def _contents(self) -> Contents:
        tags = [Tag(*row) for row in self._database.execute("SELECT id, name, unit, en, zh, sealed FROM tag")]
        (last,) = self._database.execute("SELECT coalesce(max(id), 0) FROM event").fetchone()
        meta = dict(self._database.execute("SELECT key, value FROM meta"))
        return Contents(tags, last, meta.get("clock"))

    @_translated
    def close(self) -> None:
        if self._open is not None:
            self._open.close()
            self._open = None

    def _transaction(self, kind: str = "IMMEDIATE") -> _Transaction:
        return _Transaction(self._database, kind)

    @_translated
    def journal(self) -> Iterator[tuple[int, bytes]]:
        return iter(self._database.execute("SELECT id, data FROM journal ORDER BY id").fetchall())

    @_translated
    def put(self, batch: Batch) -> None:
        with self._transaction() as database:
            tags = [(tag.id, tag.name, tag.unit, tag.en, tag.zh) for tag in batch.tags]
            database.executemany(_PUT_TAG, tags)
            if batch.samples is not None:
                database.execute("INSERT OR IGNORE INTO journal VALUES (?, ?)", (batch.id, batch.samples))
            events = [(event.id, event.time_ms, event.kind, event.drive, event.data) for event in batch.events]
            database.executemany("INSERT OR IGNORE INTO event VALUES (?, ?, ?, ?, ?)", events)
            for document in batch.documents:
                self._put_document(document)

    def _put_document(self, document: Document) -> None:
        place = (document.kind, document.id)
        if document.data is None:
            self._database.execute("DELETE FROM document WHERE kind = ? AND id = ?", place)
        else:
            self._database.execute("INSERT OR REPLACE INTO document VALUES (?, ?, ?)", (*place, document.data))

    @_translated
    def seal(self, seals: Sequence[Seal], stored_ms: int, keep_from: int | None) -> None:
        with self._transaction() as database:
            for seal in seals:
                moved = "UPDATE tag SET sealed = ? WHERE id = ? AND sealed = ?"
                if database.execute(moved, (seal.to_number, seal.tag, seal.from_number)).rowcount:
                    rows = [(b.level, b.tag, b.start_ms, b.number, stored_ms, b.data) for b in seal.blocks]
                    database.executemany(_PUT_BLOCK, rows)
            if keep_from is None:
                database.execute("DELETE FROM journal")
            else:
                database.execute("DELETE FROM journal WHERE id < ?", (keep_from,))

    @_translated
    def block(self, level: Level, tag: int, start_ms: int) -> bytes | None:
        asked = "SELECT data FROM block WHERE level = ? AND tag = ? AND start_ms = ? AND number = 0"
        found = self._database.execute(asked, (level, tag, start_ms)).fetchone()
        return None if found is None else bytes(found[0])

    @_translated
    def forget(self, level: Level, before_ms: int, most: int) -> int:
        asked = "DELETE FROM block WHERE id IN (SELECT id FROM block WHERE level = ? AND stored_ms < ? LIMIT ?)"
        with self._transaction() as database:
            gone = database.execute(asked, (level, before_ms, most)).rowcount
            if gone:
                database.execute(_RAISE, (f"floor.{level:d}", before_ms))
        database.execute("PRAGMA incremental_vacuum(1000)").fetchall()
        return gone

    @_translated
    def forget_events(self, before_ms: int) -> None:
        self._database.execute("DELETE FROM event WHERE time_ms < ?", (before_ms,))

    @_translated
    def oldest(self, level: Level, skip: int) -> int | None:
        asked = "SELECT stored_ms FROM block WHERE level = ? ORDER BY stored_ms LIMIT 1 OFFSET ?"
        found = self._database.execute(asked, (level, skip)).fetchone()
        return None if found is None else int(found[0])

    @_translated
    def keep_clock(self, clock_ms: int) -> None:
        self._database.execute("INSERT OR REPLACE INTO meta VALUES ('clock', ?)", (clock_ms,))

    @_translated
    def size_bytes(self) -> int:
        pages, free, size = (self._number(name) for name in ("page_count", "freelist_count", "page_size"))
        return (pages - free) * size

    def _number(self, pragma: str) -> int:
        return int(self._database.execute(f"PRAGMA {pragma}").fetchone()[0])

    @_translated
    def read(self, level: Level, tags: Sequence[int], from_ms: int, to_ms: int) -> tuple[dict[int, int], list[Block]]:
        one = "SELECT level, tag, start_ms, number, data FROM block WHERE level = ? AND tag = ?"
        asked = f"{one} AND start_ms BETWEEN ? AND ? ORDER BY start_ms, number"
        with self._transaction("DEFERRED") as database:
            sealed = dict(database.execute("SELECT id, sealed FROM tag"))
            rows = [row for tag in tags for row in database.execute(asked, (level, tag, from_ms, to_ms))]
        return sealed, [Block(Level(row[0]), *row[1:]) for row in rows]

    @_translated
    def floors(self) -> dict[Level, int]:
        meta = dict(self._database.execute("SELECT key, value FROM meta WHERE key LIKE 'floor.%'"))
        return {level: meta.get(f"floor.{level:d}", 0) for level in Level}

    @_translated
    def extent(self, level: Level, tags: Sequence[int]) -> tuple[int, int] | None:
        ends = [
            self._database.execute(
                f"SELECT {end}(start_ms) FROM block WHERE level = ? AND tag = ?", (level, tag)
            ).fetchone()[0]
            for tag in tags
            for end in ("min", "max")
        ]
        known = [end for end in ends if end is not None]
        return (min(known), max(known)) if known else None

    @_translated
    def events(self, window: Window) -> list[EventRow]:
        before = window.before or (window.to_ms + 1, 0)
        given = (window.from_ms, window.to_ms, window.drive, window.drive, *before, window.limit)
        return [EventRow(*row) for row in self._database.execute(_EVENTS, given)]

    @_translated
    def documents(self, kind: str, ids: Iterable[str] | None = None) -> list[Document]:
        rows = self._database.execute("SELECT kind, id, data FROM document WHERE kind = ? ORDER BY id", (kind,))
        wanted = None if ids is None else set(ids)
        return [Document(*row) for row in rows if wanted is None or row[1] in wanted]


class _Transaction:
    """BEGIN, then COMMIT or ROLLBACK."""

    def __init__(self, database: sqlite3.Connection, kind: str) -> None:
        self._database = database
        self._kind = kind

    def __enter__(self) -> sqlite3.Connection:
        self._database.execute(f"BEGIN {self._kind}")
        return self._database

    def __exit__(self, kind: Any, error: Any, trace: Any) -> None:
        if error is None:
            self._database.execute("COMMIT")
        elif self._database.in_transaction:
            self._database.execute("ROLLBACK")
