"""The historian's tables and statements, in the SQL that SQLite and PostgreSQL share. A ``Door`` is one connection."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager
from functools import wraps
from typing import Any, Concatenate, ParamSpec, Protocol, TypeVar

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
Row = Sequence[Any]

TABLES = (
    "CREATE TABLE meta (key TEXT PRIMARY KEY, value BIGINT NOT NULL)",
    "CREATE TABLE tag (id BIGINT PRIMARY KEY, name TEXT NOT NULL UNIQUE, unit TEXT NOT NULL, en TEXT NOT NULL, "
    "zh TEXT NOT NULL, sealed BIGINT NOT NULL DEFAULT 0)",
    "CREATE TABLE journal (id {id}, data {bytes} NOT NULL)",
    "CREATE TABLE block (id {id}, level BIGINT NOT NULL, tag BIGINT NOT NULL, start_ms BIGINT NOT NULL, "
    "number BIGINT NOT NULL, stored_ms BIGINT NOT NULL, data {bytes} NOT NULL)",
    "CREATE UNIQUE INDEX block_place ON block (level, tag, start_ms, number)",
    "CREATE INDEX block_stored ON block (level, stored_ms)",
    "CREATE TABLE event (id {id}, time_ms BIGINT NOT NULL, kind TEXT NOT NULL, drive TEXT, data TEXT NOT NULL)",
    "CREATE INDEX event_time ON event (time_ms, id)",
    "CREATE INDEX event_drive ON event (drive, time_ms, id)",
    "CREATE TABLE document (kind TEXT NOT NULL, id TEXT NOT NULL, data TEXT NOT NULL, PRIMARY KEY (kind, id))",
)
_PUT_TAG = """INSERT INTO tag (id, name, unit, en, zh) VALUES (?, ?, ?, ?, ?)
ON CONFLICT (id) DO UPDATE SET unit = excluded.unit, en = excluded.en, zh = excluded.zh"""
_PUT_BATCH = "INSERT INTO journal VALUES (?, ?) ON CONFLICT DO NOTHING"
_PUT_EVENT = "INSERT INTO event VALUES (?, ?, ?, ?, ?) ON CONFLICT DO NOTHING"
_PUT_DOCUMENT = "INSERT INTO document VALUES (?, ?, ?) ON CONFLICT (kind, id) DO UPDATE SET data = excluded.data"
_PUT_BLOCK = """INSERT INTO block (level, tag, start_ms, number, stored_ms, data) VALUES (?, ?, ?, ?, ?, ?)
ON CONFLICT (level, tag, start_ms, number) DO UPDATE SET stored_ms = excluded.stored_ms, data = excluded.data"""
_PUT_META = "INSERT INTO meta VALUES (?, ?) ON CONFLICT (key) DO UPDATE SET value = excluded.value"
_FORGET = "DELETE FROM block WHERE id IN (SELECT id FROM block WHERE level = ? AND stored_ms < ? LIMIT ?)"


class Door(Protocol):
    """One connection, used by one thread. ``?`` stands for a parameter. Raises what its database raises."""

    errors: tuple[type[Exception], ...]
    """All that a database, a disk or a network can do."""
    words: dict[str, str]
    """What ``{id}`` (a key that counts itself where nothing is given) and ``{bytes}`` are called there."""

    def connect(self) -> None: ...
    def close(self) -> None: ...

    def version(self) -> int:
        """Of the tables; 0: there are none."""
        ...

    def rows(self, statement: str, *given: Any) -> list[Row]: ...
    def run(self, statement: str, *given: Any) -> int:
        """How many rows were changed."""
        ...

    def many(self, statement: str, given: Iterable[Row]) -> None: ...
    def transaction(self, *, writing: bool) -> AbstractContextManager[None]:
        """All or nothing; one that only reads sees one moment."""
        ...

    def size_bytes(self) -> int: ...
    def tidy(self) -> None:
        """Give back what deleted rows left free, a little at a time."""
        ...


def _translated(method: Callable[Concatenate[SqlStore, P], R]) -> Callable[Concatenate[SqlStore, P], R]:
    """A method whose database errors are StoreError."""

    @wraps(method)
    def wrapped(self: SqlStore, /, *args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return method(self, *args, **kwargs)
        except self.door.errors as error:
            raise StoreError(str(error) or type(error).__name__) from error

    return wrapped


class SqlStore:
    """A ``Store`` through a door; a reader makes no tables."""

    def __init__(self, door: Door, *, reader: bool = False) -> None:
        self.door = door
        self._reader = reader

    @_translated
    def open(self) -> Contents:
        self.door.connect()
        version = self.door.version()
        if version > SCHEMA:
            raise StoreError(f"made by a later version of drivebus (tables {version}, known {SCHEMA})")
        if version == 0 and not self._reader:
            self._make_tables()
        tags = [Tag(*row) for row in self.door.rows("SELECT id, name, unit, en, zh, sealed FROM tag ORDER BY id")]
        last = self.door.rows("SELECT coalesce(max(id), 0) FROM event")[0][0]
        meta = {row[0]: row[1] for row in self.door.rows("SELECT key, value FROM meta")}
        return Contents(tags, last, (meta["clock"], meta["wall"]) if "clock" in meta else None)

    def _make_tables(self) -> None:
        with self.door.transaction(writing=True):
            for statement in TABLES:
                self.door.run(statement.format(**self.door.words))
            self.door.run(_PUT_META, "schema", SCHEMA)

    @_translated
    def close(self) -> None:
        self.door.close()

    @_translated
    def journal(self) -> Iterator[tuple[int, bytes]]:
        return iter([(row[0], row[1]) for row in self.door.rows("SELECT id, data FROM journal ORDER BY id")])

    @_translated
    def put(self, batch: Batch) -> None:
        with self.door.transaction(writing=True):
            self.door.many(_PUT_TAG, [(tag.id, tag.name, tag.unit, tag.en, tag.zh) for tag in batch.tags])
            if batch.samples is not None:
                self.door.run(_PUT_BATCH, batch.id, batch.samples)
            self.door.many(_PUT_EVENT, [(one.id, one.time_ms, one.kind, one.drive, one.data) for one in batch.events])
            for one in batch.documents:
                if one.data is None:
                    self.door.run("DELETE FROM document WHERE kind = ? AND id = ?", one.kind, one.id)
                else:
                    self.door.run(_PUT_DOCUMENT, one.kind, one.id, one.data)

    @_translated
    def seal(self, seals: Sequence[Seal], stored_ms: int, keep_from: int | None) -> None:
        with self.door.transaction(writing=True):
            for seal in seals:
                self.door.run("UPDATE tag SET sealed = ? WHERE id = ?", seal.to_number, seal.tag)
                rows = ((b.level, b.tag, b.start_ms, b.number, stored_ms, b.data) for b in seal.blocks)
                self.door.many(_PUT_BLOCK, rows)
            if keep_from is None:
                self.door.run("DELETE FROM journal")
            else:
                self.door.run("DELETE FROM journal WHERE id < ?", keep_from)

    @_translated
    def block(self, level: Level, tag: int, start_ms: int) -> bytes | None:
        asked = "SELECT data FROM block WHERE level = ? AND tag = ? AND start_ms = ? AND number = 0"
        found = self.door.rows(asked, level, tag, start_ms)
        return bytes(found[0][0]) if found else None

    @_translated
    def forget(self, level: Level, before_ms: int, most: int) -> int:
        gone = self.door.run(_FORGET, level, before_ms, most)
        self.door.tidy()
        return gone

    @_translated
    def forget_events(self, but: int) -> None:
        self.door.run("DELETE FROM event WHERE id <= (SELECT max(id) FROM event) - ?", but)

    @_translated
    def oldest(self, level: Level, skip: int) -> int | None:
        asked = "SELECT stored_ms FROM block WHERE level = ? ORDER BY stored_ms LIMIT 1 OFFSET ?"
        found = self.door.rows(asked, level, skip)
        return found[0][0] if found else None

    @_translated
    def keep_clock(self, clock_ms: int, wall_ms: int) -> None:
        with self.door.transaction(writing=True):
            self.door.many(_PUT_META, [("clock", clock_ms), ("wall", wall_ms)])

    @_translated
    def size_bytes(self) -> int:
        return self.door.size_bytes()

    @_translated
    def read(self, level: Level, tags: Sequence[int], from_ms: int, to_ms: int) -> tuple[dict[int, int], list[Block]]:
        one = "SELECT tag, start_ms, number, data FROM block WHERE level = ? AND tag = ?"
        asked = f"{one} AND start_ms BETWEEN ? AND ? ORDER BY start_ms, number"
        with self.door.transaction(writing=False):
            sealed = {row[0]: row[1] for row in self.door.rows("SELECT id, sealed FROM tag")}
            rows = [row for tag in tags for row in self.door.rows(asked, level, tag, from_ms, to_ms)]
        return sealed, [Block(level, *row) for row in rows]

    @_translated
    def following(self, level: Level, tags: Sequence[int], from_ms: int) -> int | None:
        asked = "SELECT min(start_ms) FROM block WHERE level = ? AND tag = ? AND start_ms >= ?"
        found = [self.door.rows(asked, level, tag, from_ms)[0][0] for tag in tags]
        return min((start for start in found if start is not None), default=None)

    @_translated
    def events(self, window: Window) -> list[EventRow]:
        before = window.before or (window.to_ms + 1, 0)
        where = "time_ms BETWEEN ? AND ? AND (time_ms, id) < (?, ?)"
        given: list[Any] = [window.from_ms, window.to_ms, *before]
        if window.drive is not None:
            where, given = f"{where} AND drive = ?", [*given, window.drive]
        asked = f"SELECT id, time_ms, kind, drive, data FROM event WHERE {where} ORDER BY time_ms DESC, id DESC LIMIT ?"
        return [EventRow(*row) for row in self.door.rows(asked, *given, window.limit)]

    @_translated
    def documents(self, kind: str) -> list[Document]:
        asked = "SELECT kind, id, data FROM document WHERE kind = ? ORDER BY id"
        return [Document(*row) for row in self.door.rows(asked, kind)]
