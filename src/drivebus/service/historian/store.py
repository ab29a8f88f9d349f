"""Store of the history: tables and statements in the SQL that SQLite and PostgreSQL share.

A store is used by one thread; every writing method is one transaction and durable on return. After StoreError it is
unknown whether the write was done; opening the store again shows it.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import wraps
from typing import Any, Concatenate, ParamSpec, Protocol, TypeVar

from drivebus.service.historian.points import ResolutionLevel
from drivebus.values import Text, bilingual_text

SCHEMA_VERSION = 3
"""Version of the tables and of the encoding of their rows; of the others only ``TEXT_COLUMNS_VERSION`` is changed."""
TEXT_COLUMNS_VERSION = 2
"""Version whose tags had a column for each of two languages; opened for writing, it is changed to the present one."""


class StoreError(Exception):
    """The database failed: full, read-only, damaged, unreachable. The write may or may not be done.

    ``reason`` is a part of a sentence.
    """

    def __init__(self, reason: Text) -> None:
        super().__init__(reason.en)
        self.reason = reason


@dataclass(frozen=True, slots=True, kw_only=True)
class Tag:
    """Signal of a drive. It stays known after the drive is removed from the plant."""

    id: int
    name: str
    """``<drive>.<signal>``."""
    unit: str = ""
    text: Text = Text("", "")
    first_uncompacted: int = 0
    """Number of the first sample that is not in a block."""


@dataclass(frozen=True, slots=True)
class Block:
    """Row of packed points."""

    level: ResolutionLevel
    tag: int
    start_ms: int
    """Start of its partition."""
    number: int
    """Number of its first sample; 0 for merged levels, whose partitions have one row."""
    data: bytes


@dataclass(frozen=True, slots=True)
class EventRow:
    """Event; ``id`` orders events of equal time."""

    id: int
    time_ms: int
    kind: str
    drive: str | None
    data: str
    """JSON."""


@dataclass(frozen=True, slots=True)
class Document:
    """JSON document of another component, by kind and id. ``data`` None deletes it."""

    kind: str
    id: str
    data: str | None


@dataclass(frozen=True, slots=True)
class Batch:
    """Content of one flush interval."""

    id: int
    samples: bytes | None = None
    tags: Sequence[Tag] = ()
    """New tags, and tags with a new unit or text."""
    events: Sequence[EventRow] = ()
    documents: Sequence[Document] = ()


@dataclass(frozen=True, slots=True)
class Compaction:
    """Move of one tag's samples from the journal into blocks."""

    tag: int
    to_number: int
    """Number of the first sample that stays in the journal."""
    blocks: Sequence[Block]


@dataclass(frozen=True, slots=True)
class StoreContents:
    """Content of a store when it is opened."""

    tags: Sequence[Tag]
    last_event: int
    clock: tuple[int, int] | None = None
    """Age clock and wall clock (ms) when they were last saved."""


@dataclass(frozen=True, slots=True)
class EventQuery:
    """Query of events, newest first."""

    from_ms: int
    to_ms: int
    drive: str | None
    before: tuple[int, int] | None
    """``(time_ms, id)`` of the last event of the previous page."""
    limit: int


P = ParamSpec("P")
R = TypeVar("R")
SqlRow = Sequence[Any]

CREATE_TABLES = (
    "CREATE TABLE meta (key TEXT PRIMARY KEY, value BIGINT NOT NULL)",
    "CREATE TABLE tag (id BIGINT PRIMARY KEY, name TEXT NOT NULL UNIQUE, unit TEXT NOT NULL, text TEXT NOT NULL, "
    "first_uncompacted BIGINT NOT NULL DEFAULT 0)",
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
_PUT_TAG = """INSERT INTO tag (id, name, unit, text) VALUES (?, ?, ?, ?)
ON CONFLICT (id) DO UPDATE SET unit = excluded.unit, text = excluded.text"""
_PUT_BATCH = "INSERT INTO journal VALUES (?, ?) ON CONFLICT DO NOTHING"
_PUT_EVENT = "INSERT INTO event VALUES (?, ?, ?, ?, ?) ON CONFLICT DO NOTHING"
_PUT_DOCUMENT = "INSERT INTO document VALUES (?, ?, ?) ON CONFLICT (kind, id) DO UPDATE SET data = excluded.data"
_PUT_BLOCK = """INSERT INTO block (level, tag, start_ms, number, stored_ms, data) VALUES (?, ?, ?, ?, ?, ?)
ON CONFLICT (level, tag, start_ms, number) DO UPDATE SET stored_ms = excluded.stored_ms, data = excluded.data"""
_PUT_META = "INSERT INTO meta VALUES (?, ?) ON CONFLICT (key) DO UPDATE SET value = excluded.value"
_DELETE_BLOCKS = "DELETE FROM block WHERE id IN (SELECT id FROM block WHERE level = ? AND stored_ms < ? LIMIT ?)"


class SqlConnection(Protocol):
    """Connection to a database, used by one thread.

    ``?`` stands for a parameter. Raises the database's own errors, and StoreError where it must not be used.
    """

    errors: tuple[type[Exception], ...]
    """All errors of the database, disk and network."""
    type_names: dict[str, str]
    """Column types for ``{id}``, an auto-incremented key, and ``{bytes}``."""

    def reason(self, error: Exception) -> Text:
        """Return why one of its errors came, as a part of a sentence."""
        ...

    def connect(self) -> None: ...
    def close(self) -> None: ...

    def version(self) -> int:
        """Return the version of the tables; 0 if there are none."""
        ...

    def fetch(self, statement: str, *values: Any) -> list[SqlRow]: ...
    def execute(self, statement: str, *values: Any) -> int:
        """Execute a statement and return the number of changed rows."""
        ...

    def execute_many(self, statement: str, rows: Iterable[SqlRow]) -> None: ...
    def transaction(self, *, writing: bool) -> AbstractContextManager[None]:
        """Run a transaction. One that only reads sees a consistent snapshot."""
        ...

    def size_bytes(self) -> int: ...
    def vacuum(self) -> None:
        """Return some of the space of deleted rows."""
        ...


def _text_to_json(text: Text) -> str:
    return json.dumps(text.by_language(), ensure_ascii=False)


def _text_from_json(stored: str) -> Text:
    return Text.from_mapping(json.loads(stored) or {"en": ""})


def _raises_store_error(method: Callable[Concatenate[HistoryStore, P], R]) -> Callable[Concatenate[HistoryStore, P], R]:
    """Translate the database errors of a method to StoreError."""

    @wraps(method)
    def wrapped(self: HistoryStore, /, *args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return method(self, *args, **kwargs)
        except self.connection.errors as error:
            raise StoreError(self.connection.reason(error)) from error

    return wrapped


class HistoryStore:
    """Store over a connection. Each method raises StoreError. A reader creates no tables."""

    def __init__(self, connection: SqlConnection, *, reader: bool = False) -> None:
        self.connection = connection
        self._reader = reader

    @_raises_store_error
    def open(self) -> StoreContents:
        self.connection.connect()
        version = self.connection.version()
        if version > SCHEMA_VERSION:
            raise StoreError(bilingual_text("history.later_version", version=version, known=SCHEMA_VERSION))
        if version == TEXT_COLUMNS_VERSION and not self._reader:
            self._merge_text_columns()
        elif 0 < version < SCHEMA_VERSION:
            raise StoreError(bilingual_text("history.earlier_version", version=version, known=SCHEMA_VERSION))
        if version == 0 and not self._reader:
            self._make_tables()
        tags = [
            Tag(id=id, name=name, unit=unit, text=_text_from_json(text), first_uncompacted=first)
            for id, name, unit, text, first in self.connection.fetch(
                "SELECT id, name, unit, text, first_uncompacted FROM tag ORDER BY id"
            )
        ]
        last = self.connection.fetch("SELECT coalesce(max(id), 0) FROM event")[0][0]
        meta = {row[0]: row[1] for row in self.connection.fetch("SELECT key, value FROM meta")}
        return StoreContents(tags, last, (meta["clock"], meta["wall"]) if "clock" in meta else None)

    def _make_tables(self) -> None:
        with self.connection.transaction(writing=True):
            for statement in CREATE_TABLES:
                self.connection.execute(statement.format(**self.connection.type_names))
            self.connection.execute(_PUT_META, "schema", SCHEMA_VERSION)

    def _merge_text_columns(self) -> None:
        """Replace the columns ``en`` and ``zh`` of an earlier version by one with a JSON object of all languages."""
        with self.connection.transaction(writing=True):
            rows = self.connection.fetch("SELECT id, en, zh FROM tag")
            self.connection.execute("ALTER TABLE tag ADD COLUMN text TEXT NOT NULL DEFAULT '{}'")
            texts = [(_text_to_json(Text(en, zh)), id) for id, en, zh in rows]
            self.connection.execute_many("UPDATE tag SET text = ? WHERE id = ?", texts)
            for column in ("en", "zh"):
                self.connection.execute(f"ALTER TABLE tag DROP COLUMN {column}")
            self.connection.execute(_PUT_META, "schema", SCHEMA_VERSION)

    @_raises_store_error
    def close(self) -> None:
        self.connection.close()

    @_raises_store_error
    def journal(self) -> Iterator[tuple[int, bytes]]:
        return iter([(row[0], row[1]) for row in self.connection.fetch("SELECT id, data FROM journal ORDER BY id")])

    @_raises_store_error
    def write_batch(self, batch: Batch) -> None:
        with self.connection.transaction(writing=True):
            self.connection.execute_many(
                _PUT_TAG, [(tag.id, tag.name, tag.unit, _text_to_json(tag.text)) for tag in batch.tags]
            )
            if batch.samples is not None:
                self.connection.execute(_PUT_BATCH, batch.id, batch.samples)
            self.connection.execute_many(
                _PUT_EVENT, [(event.id, event.time_ms, event.kind, event.drive, event.data) for event in batch.events]
            )
            for document in batch.documents:
                if document.data is None:
                    self.connection.execute(
                        "DELETE FROM document WHERE kind = ? AND id = ?", document.kind, document.id
                    )
                else:
                    self.connection.execute(_PUT_DOCUMENT, document.kind, document.id, document.data)

    @_raises_store_error
    def compact(self, compactions: Sequence[Compaction], stored_ms: int, keep_from: int | None) -> None:
        with self.connection.transaction(writing=True):
            for compaction in compactions:
                update = "UPDATE tag SET first_uncompacted = ? WHERE id = ?"
                self.connection.execute(update, compaction.to_number, compaction.tag)
                rows = ((b.level, b.tag, b.start_ms, b.number, stored_ms, b.data) for b in compaction.blocks)
                self.connection.execute_many(_PUT_BLOCK, rows)
            if keep_from is None:
                self.connection.execute("DELETE FROM journal")
            else:
                self.connection.execute("DELETE FROM journal WHERE id < ?", keep_from)

    @_raises_store_error
    def merged_block(self, level: ResolutionLevel, tag: int, start_ms: int) -> bytes | None:
        query = "SELECT data FROM block WHERE level = ? AND tag = ? AND start_ms = ? AND number = 0"
        rows = self.connection.fetch(query, level, tag, start_ms)
        return bytes(rows[0][0]) if rows else None

    @_raises_store_error
    def delete_blocks(self, level: ResolutionLevel, before_ms: int, max_rows: int) -> int:
        deleted = self.connection.execute(_DELETE_BLOCKS, level, before_ms, max_rows)
        self.connection.vacuum()
        return deleted

    @_raises_store_error
    def delete_events(self, keep: int) -> None:
        self.connection.execute("DELETE FROM event WHERE id <= (SELECT max(id) FROM event) - ?", keep)

    @_raises_store_error
    def oldest_stored_ms(self, level: ResolutionLevel, skip: int) -> int | None:
        query = "SELECT stored_ms FROM block WHERE level = ? ORDER BY stored_ms LIMIT 1 OFFSET ?"
        rows = self.connection.fetch(query, level, skip)
        return rows[0][0] if rows else None

    @_raises_store_error
    def save_clock(self, clock_ms: int, wall_ms: int) -> None:
        with self.connection.transaction(writing=True):
            self.connection.execute_many(_PUT_META, [("clock", clock_ms), ("wall", wall_ms)])

    @_raises_store_error
    def size_bytes(self) -> int:
        return self.connection.size_bytes()

    @_raises_store_error
    def read_blocks(
        self, level: ResolutionLevel, tags: Sequence[int], from_ms: int, to_ms: int
    ) -> tuple[dict[int, int], list[Block]]:
        of_tag = "SELECT tag, start_ms, number, data FROM block WHERE level = ? AND tag = ?"
        query = f"{of_tag} AND start_ms BETWEEN ? AND ? ORDER BY start_ms, number"
        with self.connection.transaction(writing=False):
            query_tags = "SELECT id, first_uncompacted FROM tag"
            first_uncompacted = {row[0]: row[1] for row in self.connection.fetch(query_tags)}
            rows = [row for tag in tags for row in self.connection.fetch(query, level, tag, from_ms, to_ms)]
        return first_uncompacted, [Block(level, *row) for row in rows]

    @_raises_store_error
    def next_partition(self, level: ResolutionLevel, tags: Sequence[int], from_ms: int) -> int | None:
        query = "SELECT min(start_ms) FROM block WHERE level = ? AND tag = ? AND start_ms >= ?"
        starts_ms = [self.connection.fetch(query, level, tag, from_ms)[0][0] for tag in tags]
        return min((start for start in starts_ms if start is not None), default=None)

    @_raises_store_error
    def events(self, window: EventQuery) -> list[EventRow]:
        before = window.before or (window.to_ms + 1, 0)
        where = "time_ms BETWEEN ? AND ? AND (time_ms, id) < (?, ?)"
        values: list[Any] = [window.from_ms, window.to_ms, *before]
        if window.drive is not None:
            where, values = f"{where} AND drive = ?", [*values, window.drive]
        query = f"SELECT id, time_ms, kind, drive, data FROM event WHERE {where} ORDER BY time_ms DESC, id DESC LIMIT ?"
        return [EventRow(*row) for row in self.connection.fetch(query, *values, window.limit)]

    @_raises_store_error
    def documents(self, kind: str) -> list[Document]:
        query = "SELECT kind, id, data FROM document WHERE kind = ? ORDER BY id"
        return [Document(*row) for row in self.connection.fetch(query, kind)]
