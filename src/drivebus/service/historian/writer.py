"""Where the plant leaves what is to be remembered. Never waits: a full queue loses what comes, counts it and marks the
hole, so that no line is drawn across it.

What came in one interval, made ready for one transaction: samples by tag, new tags, events with their numbers.

The one writer: makes durable what the intake holds, moves it into blocks, forgets what is too old.

Every method runs on the writer's thread. A store that fails is closed and opened again at the next
round; until then the batch stays in memory and the intake fills, and nobody else notices.
"""

from __future__ import annotations

import logging
import math
import time
from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from threading import Lock

from drivebus import clock
from drivebus.profiles.model import Text
from drivebus.service.config.model import HistoryConfig
from drivebus.service.historian import compaction
from drivebus.service.historian.blocks import DamagedBlock, SampleColumns, decode_batch, encode_batch
from drivebus.service.historian.compaction import OpenBlocks, compact_samples
from drivebus.service.historian.points import CODE_BY_QUALITY
from drivebus.service.historian.store import (
    Batch,
    Compaction,
    Document,
    EventRow,
    HistoryStore,
    StoreContents,
    StoreError,
    Tag,
)
from drivebus.service.live.views import Sample
from drivebus.values import Quality

MAX_QUEUED_SAMPLES = 200_000
"""Half an hour of 12 drives with 10 signals each second: a full disk found and mended in that time loses nothing."""
MAX_QUEUED_NOTES = 10_000
"""Events and documents."""


@dataclass(slots=True)
class QueuedBatch:
    """What the writer puts into one batch."""

    samples: list[Sample] = field(default_factory=list)
    events: list[EventRow] = field(default_factory=list)
    """Without an id yet."""
    documents: dict[tuple[str, str], Document] = field(default_factory=dict)
    """The last one of each place."""
    labels: dict[str, tuple[str, Text]] = field(default_factory=dict)
    accepted: int = 0
    """Things accepted up to and with these: what a flush waits for."""


class WriteQueue:
    """A bounded queue between the loop's thread and the writer's."""

    def __init__(self, max_samples: int = MAX_QUEUED_SAMPLES, max_notes: int = MAX_QUEUED_NOTES) -> None:
        self._lock = Lock()
        self._max_samples, self._max_notes = max_samples, max_notes
        self._batches: deque[Sequence[Sample]] = deque()
        self._waiting = QueuedBatch()
        self._gaps: dict[str, int] = {}
        self.queued = 0
        """Samples that wait."""
        self.samples = 0
        """Samples taken in so far, marks of holes among them."""
        self.lost_samples = 0
        self.lost_notes = 0
        self.accepted = 0

    def append(self, samples: Iterable[Sample]) -> None:
        batch = tuple(samples)
        with self._lock:
            if self.queued + len(batch) > self._max_samples:
                self._drop(batch)
                return
            if self._gaps:
                batch = (*self._gap_markers(), *batch)
            self._batches.append(batch)
            self.queued += len(batch)
            self.samples += len(batch)
            self.accepted += len(batch)

    def _drop(self, batch: Iterable[Sample]) -> None:
        for sample in batch:
            self.lost_samples += 1
            self._gaps.setdefault(sample.tag, sample.time_ms)

    def _gap_markers(self) -> list[Sample]:
        """A gap for each tag at the first moment that was lost."""
        holes, self._gaps = self._gaps, {}
        return [Sample(tag, time_ms, None, Quality.BAD) for tag, time_ms in holes.items()]

    def put_event(self, event: EventRow) -> None:
        with self._lock:
            if len(self._waiting.events) >= self._max_notes:
                self.lost_notes += 1
                return
            self._waiting.events.append(event)
            self.accepted += 1

    def put_document(self, document: Document) -> None:
        with self._lock:
            place = (document.kind, document.id)
            if place not in self._waiting.documents and len(self._waiting.documents) >= self._max_notes:
                self.lost_notes += 1
                return
            self._waiting.documents[place] = document
            self.accepted += 1

    def set_labels(self, labels: Mapping[str, tuple[str, Text]]) -> None:
        with self._lock:
            self._waiting.labels.update(labels)
            self.accepted += 1

    def take(self, max_samples: int) -> QueuedBatch:
        """Everything that waits, of samples about ``most``."""
        with self._lock:
            taken, self._waiting = self._waiting, QueuedBatch()
            while self._batches and len(taken.samples) < max_samples:
                taken.samples.extend(self._batches.popleft())
            self.queued -= len(taken.samples)
            taken.accepted = self.accepted - self.queued
            return taken


def sample_value(sample: Sample) -> float:
    """NaN for what is no number: a gap."""
    value = sample.value
    return value if value is not None and math.isfinite(value) else math.nan


@dataclass(frozen=True, slots=True)
class PendingBatch:
    """A batch on its way, tried again until it is durable."""

    batch: Batch
    groups: list[tuple[int, int, SampleColumns]]
    """Tag, number of the first, samples."""
    accepted: int
    """What the intake had accepted up to and with it."""


class BatchBuilder:
    """Knows every tag and the last numbers."""

    def __init__(self) -> None:
        self.tags: dict[str, Tag] = {}
        self.last_batch = 0
        """Number of the last journal row."""
        self._last_event = 0
        self._labels: dict[str, tuple[str, Text]] = {}

    def resume(self, contents: StoreContents) -> None:
        """Go on where a store ends."""
        self.tags = {tag.name: tag for tag in contents.tags}
        self._last_event = contents.last_event

    def build(self, taken: QueuedBatch, following: Callable[[int], int]) -> PendingBatch:
        """``following``: a known tag → the number of its next sample."""
        by_tag: defaultdict[str, list[Sample]] = defaultdict(list)
        for sample in taken.samples:
            by_tag[sample.tag].append(sample)
        tags = self._changed_tags(list(by_tag), taken)
        new = {tag.name: tag.id for tag in tags if tag.name not in self.tags}
        groups = []
        for name, samples in by_tag.items():
            tag, first = (new[name], 0) if name in new else (self.tags[name].id, following(self.tags[name].id))
            groups.append((tag, first, _sample_columns(samples)))
        events = [replace(event, id=self._last_event + n) for n, event in enumerate(taken.events, 1)]
        packed = encode_batch(groups) if groups else None
        batch = Batch(self.last_batch + 1, packed, tags, events, list(taken.documents.values()))
        return PendingBatch(batch, groups, taken.accepted)

    def _changed_tags(self, names: list[str], taken: QueuedBatch) -> list[Tag]:
        """Tags that are new, or that have another unit or text now."""
        found = []
        self._labels.update(taken.labels)
        free = 1 + max((tag.id for tag in self.tags.values()), default=0)
        for name in dict.fromkeys([*names, *(name for name in taken.labels if name in self.tags)]):
            tag = self.tags.get(name) or Tag(free, name)
            free += tag.id == free
            if name in self._labels:
                unit, text = self._labels[name]
                tag = replace(tag, unit=unit, en=text.en, zh=text.zh)
            if self.tags.get(name) != tag:
                found.append(tag)
        return found

    def confirm(self, batch: Batch) -> None:
        """It is durable."""
        self.tags |= {tag.name: tag for tag in batch.tags}
        self.last_batch = batch.id
        self._last_event += len(batch.events)


def _sample_columns(samples: list[Sample]) -> SampleColumns:
    time_ms = [sample.time_ms for sample in samples]
    return (
        time_ms,
        [sample_value(sample) for sample in samples],
        bytes([CODE_BY_QUALITY[sample.quality] for sample in samples]),
    )


log = logging.getLogger("drivebus.history")

MAX_BATCH_SAMPLES = 50_000
"""Samples in one transaction."""
FULL_BLOCK_SAMPLES = 3600
"""Samples of a tag that make a full block."""
MAX_OPEN_SAMPLES = 200_000
MAX_OPEN_SAMPLES_PER_TAG = 600
"""The journal holds so many samples, or so many a tag if that is more. Fewer: small blocks; more: a long start."""
TAGS_PER_COMPACTION = 16
"""Tags sealed in one transaction."""
COMPACTION_BUDGET_S = 0.25
"""Of one round at most, unless samples come faster than that."""
COMPACTION_PAUSE_S = 0.0005
"""Between two tags: the bus loops of the same process get the interpreter in between."""
RETENTION_INTERVAL_S = 600.0


class HistoryWriter:
    """Over a store that nobody else writes to."""

    def __init__(
        self,
        store: HistoryStore,
        setting: HistoryConfig,
        queue: WriteQueue,
        *,
        wall_ms: Callable[[], int] = clock.wall_ms,
        monotonic_s: Callable[[], float] = time.monotonic,
        pause_s: float = COMPACTION_PAUSE_S,
    ) -> None:
        self._store, self._setting, self._queue = store, setting, queue
        self._wall_ms, self._monotonic_s, self._pause_s = wall_ms, monotonic_s, pause_s
        self.open_blocks = OpenBlocks()
        self.problem: str | None = None
        """Why nothing can be written now."""
        self.written_count = 0
        """Things of the intake that are durable."""
        self._builder = BatchBuilder()
        self._pending: PendingBatch | None = None
        self._is_open = False
        self._was_open = False
        """It was open once: what is in memory goes on."""
        self._clock_ms = 0
        self._clock_s = self._retention_s = monotonic_s()

    @property
    def tags(self) -> dict[str, Tag]:
        """Every tag by name."""
        return self._builder.tags

    def run_cycle(self) -> None:
        """Once each flush interval. Raises nothing that a database can do."""
        with suppress(StoreError):
            self.write()
            self._compact_due()
            self._apply_retention()

    def write(self) -> None:
        """Everything that the intake held at the call is durable on return. Raises StoreError."""
        mark = self._queue.accepted
        self._guarded(self._write_batch)
        while self.written_count < mark:
            self._guarded(self._write_batch)

    def close(self) -> None:
        """The last batch, as far as the store takes it."""
        try:
            self.write()
        except StoreError:
            log.error("history that came last is lost: %s", self.problem)
        finally:
            self._is_open = False
            with suppress(StoreError):
                self._store.close()

    def compact_all(self) -> None:
        """Everything into blocks. Raises StoreError."""
        self.write()
        self._guarded(lambda: self._compact([tag for tag, _ in self.open_blocks.oldest_first()]))

    def _guarded(self, step: Callable[[], None]) -> None:
        try:
            if not self._is_open:
                self._open()
            step()
        except (StoreError, DamagedBlock) as error:
            self._record_failure(error)
            raise StoreError(str(error)) from error
        if self.problem is not None:
            self.problem = None
            log.warning("history is written again; samples lost: %d", self._queue.lost_samples)

    def _record_failure(self, error: Exception) -> None:
        self._is_open = False
        if self.problem is None:
            log.error("history can't be written: %s", error)
        self.problem = str(error)
        with suppress(StoreError):
            self._store.close()

    def _open(self) -> None:
        contents = self._store.open()
        if self._was_open:
            for tag in contents.tags:
                self.open_blocks.drop_compacted(tag.id, tag.first_uncompacted)
        else:
            self._replay(contents)
            self._clock_ms, self._clock_s = (
                compaction.clock_at_start(contents.clock, self._wall_ms()),
                self._monotonic_s(),
            )
        self._is_open = self._was_open = True

    def _replay(self, contents: StoreContents) -> None:
        """After a start: what was durable and is not in blocks yet."""
        self.open_blocks = OpenBlocks()
        self._builder.resume(contents)
        for tag in contents.tags:
            self.open_blocks.add_tag(tag.id, tag.first_uncompacted)
        for batch, data in self._store.journal():
            self.open_blocks.add(batch, decode_batch(data))
            self._builder.last_batch = batch

    def _write_batch(self) -> None:
        if self._pending is None:
            self._pending = self._builder.build(self._queue.take(MAX_BATCH_SAMPLES), self.open_blocks.next_number)
        packed, batch = self._pending, self._pending.batch
        if batch.samples or batch.tags or batch.events or batch.documents:
            self._store.write_batch(batch)
        for tag in batch.tags:
            if tag.name not in self.tags:
                self.open_blocks.add_tag(tag.id, 0)
        self._builder.confirm(batch)
        self.open_blocks.add(batch.id, packed.groups)
        self.written_count = packed.accepted
        self._pending = None

    def _compact_due(self) -> None:
        most = max(MAX_OPEN_SAMPLES, MAX_OPEN_SAMPLES_PER_TAG * len(self.tags))
        until = self._monotonic_s() + COMPACTION_BUDGET_S
        while ripe := self._due_tags(most):
            self._guarded(lambda ripe=ripe: self._compact(ripe))  # type: ignore[misc]
            if self.open_blocks.total < 2 * most and self._monotonic_s() > until:
                return

    def _due_tags(self, most: int) -> list[int]:
        """Tags with a full block, and those that keep the oldest journal rows while there are too many."""
        over, ripe = self.open_blocks.total - most, []
        for tag, size in self.open_blocks.oldest_first():
            if size >= FULL_BLOCK_SAMPLES or over > 0:
                ripe.append(tag)
                over -= size
        return ripe[:TAGS_PER_COMPACTION]

    def _compact(self, tags: list[int]) -> None:
        for at in range(0, len(tags), TAGS_PER_COMPACTION):
            part = tags[at : at + TAGS_PER_COMPACTION]
            seals = [self._compaction_of(tag) for tag in part]
            self._store.compact(seals, self._age_clock_ms(), self.open_blocks.oldest_batch(without=set(part)))
            for one in seals:
                self.open_blocks.drop_compacted(one.tag, one.to_number)

    def _compaction_of(self, tag: int) -> Compaction:
        first, samples = self.open_blocks.copy(tag)
        time.sleep(self._pause_s)
        return compact_samples(tag, first, samples, self._store.merged_block)

    def _age_clock_ms(self) -> int:
        """The clock of age."""
        return self._clock_ms + round(1000 * (self._monotonic_s() - self._clock_s))

    def _apply_retention(self) -> None:
        if self._monotonic_s() < self._retention_s:
            return
        self._guarded(self._delete_some)

    def _delete_some(self) -> None:
        now_ms = self._age_clock_ms()
        self._store.save_clock(now_ms, self._wall_ms())
        more = [
            rule(self._store, self._setting, now_ms) for rule in (compaction.delete_expired, compaction.delete_oversize)
        ]
        self._retention_s = self._monotonic_s() + (0.0 if any(more) else RETENTION_INTERVAL_S)
