"""What the historian needs of a database. ``sqlite`` and ``postgres`` are two of them, with the same tests.

A store is used by one thread. Every writing method is one transaction and durable on return. After StoreError nobody
knows whether it was done: the store is opened again, and tells.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

from drivebus.service.historian.resolution import ResolutionLevel

SCHEMA_VERSION = 1
"""Version of the tables; a store of a later one is left alone."""


class StoreError(Exception):
    """The database could not do it: full, read-only, damaged, gone. What was asked for may or may not be done."""


@dataclass(frozen=True, slots=True)
class Tag:
    """A signal of a drive; stays known when the drive is taken out of the plant."""

    id: int
    name: str
    """``<drive>.<signal>``."""
    unit: str = ""
    en: str = ""
    zh: str = ""
    first_uncompacted: int = 0
    """Samples with a smaller number are in blocks."""


@dataclass(frozen=True, slots=True)
class Block:
    """One row of packed points."""

    level: ResolutionLevel
    tag: int
    start_ms: int
    """Beginning of its partition."""
    number: int
    """Number of its first sample; 0 where a partition has one row only (merged levels)."""
    data: bytes


@dataclass(frozen=True, slots=True)
class EventRow:
    """Something that happened; ``id`` orders events of one moment."""

    id: int
    time_ms: int
    kind: str
    drive: str | None
    data: str
    """JSON."""


@dataclass(frozen=True, slots=True)
class Document:
    """Somebody else's state, by kind and id. ``data`` (JSON) None deletes it."""

    kind: str
    id: str
    data: str | None


@dataclass(frozen=True, slots=True)
class Batch:
    """What came in one interval."""

    id: int
    samples: bytes | None = None
    tags: Sequence[Tag] = ()
    """New, or with a new unit or text."""
    events: Sequence[EventRow] = ()
    documents: Sequence[Document] = ()


@dataclass(frozen=True, slots=True)
class Compaction:
    """Samples of one tag moved from the journal into blocks."""

    tag: int
    to_number: int
    """Of the first that stays in the journal."""
    blocks: Sequence[Block]


@dataclass(frozen=True, slots=True)
class StoreContents:
    """What a store holds when it is opened."""

    tags: Sequence[Tag]
    last_event: int
    clock: tuple[int, int] | None = None
    """The clock of age and the wall clock (ms) when they were last kept."""


@dataclass(frozen=True, slots=True)
class EventQuery:
    """Which events are asked for; newest first."""

    from_ms: int
    to_ms: int
    drive: str | None
    before: tuple[int, int] | None
    """``(time_ms, id)`` of the last one had."""
    limit: int


class HistoryStore(Protocol):
    """Each method raises StoreError."""

    def open(self) -> StoreContents:
        """Connect, make the tables where there are none."""
        ...

    def close(self) -> None: ...

    def journal(self) -> Iterator[tuple[int, bytes]]:
        """Batches that are not yet in blocks, in their order."""
        ...

    def write_batch(self, batch: Batch) -> None:
        """Nothing more where a batch of this id is there."""
        ...

    def compact(self, seals: Sequence[Compaction], stored_ms: int, keep_from: int | None) -> None:
        """Put blocks (in place of one at the same place) and forget journal rows before ``keep_from`` (all: None)."""
        ...

    def merged_block(self, level: ResolutionLevel, tag: int, start_ms: int) -> bytes | None:
        """The one row of a merged level's partition."""
        ...

    def delete_blocks(self, level: ResolutionLevel, before_ms: int, most: int) -> int:
        """Delete at most so many of the blocks that were stored before; how many it were."""
        ...

    def delete_events(self, but: int) -> None:
        """All but so many of the newest."""
        ...

    def oldest_stored_ms(self, level: ResolutionLevel, skip: int) -> int | None:
        """When the ``skip``-th oldest block of a level was stored."""
        ...

    def save_clock(self, clock_ms: int, wall_ms: int) -> None: ...

    def size_bytes(self) -> int:
        """What the data takes, without what deleted rows left free."""
        ...

    def read_blocks(
        self, level: ResolutionLevel, tags: Sequence[int], from_ms: int, to_ms: int
    ) -> tuple[dict[int, int], list[Block]]:
        """At one moment: each tag's ``sealed``, and blocks whose partition begins within, by tag, start, number."""
        ...

    def next_partition(self, level: ResolutionLevel, tags: Sequence[int], from_ms: int) -> int | None:
        """The first partition that begins at ``from_ms`` or later and holds any of these tags."""
        ...

    def events(self, window: EventQuery) -> list[EventRow]: ...

    def documents(self, kind: str) -> list[Document]:
        """By id."""
        ...
