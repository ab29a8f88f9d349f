"""Writer of the history: queue, batches, compaction into blocks, retention.

The queue never blocks: when it is full, samples are dropped, counted and marked as a gap, so that no chart draws a line
across them. The writer works on a thread of its own; a store that fails is closed and opened again in the next cycle;
until then the batch stays in memory and the queue fills.
"""

from __future__ import annotations

import logging
import math
import time
from array import array
from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from threading import Lock

from drivebus import i18n
from drivebus.service.config.model import HistoryConfig
from drivebus.service.historian import compaction
from drivebus.service.historian.blocks import SampleColumns, decode_batch, encode_batch
from drivebus.service.historian.columns import DamagedBlock
from drivebus.service.historian.compaction import OpenBlocks, compact_samples
from drivebus.service.historian.points import CODE_BY_QUALITY, QUALITY_BY_CODE
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
from drivebus.values import Quality, Text, bilingual_text

LOG = logging.getLogger("drivebus.history")

MAX_QUEUED_SAMPLES = 200_000
"""Half an hour of 12 drives with 10 signals a second: a full disk that is cleared in that time loses nothing."""
MAX_QUEUED_NOTES = 10_000
"""Queued events and documents."""
MAX_BATCH_SAMPLES = 50_000
"""Samples of one transaction."""
FULL_BLOCK_SAMPLES = 3600
"""Samples of one tag in a full block."""
MAX_OPEN_SAMPLES = 200_000
"""Samples that the journal holds. With fewer, blocks are small; with more, a start takes long."""
MAX_OPEN_SAMPLES_PER_TAG = 600
"""Samples that it holds of each tag, where that is more in all."""
TAGS_PER_COMPACTION = 16
"""Tags compacted in one transaction."""
COMPACTION_BUDGET_S = 0.25
"""Time for compaction in one cycle, unless samples arrive faster than they are compacted."""
COMPACTION_PAUSE_S = 0.0005
"""Pause between two tags, in which the bus loops of the same process get the interpreter."""
RETENTION_INTERVAL_S = 600.0
"""Interval of deleting expired rows."""


@dataclass(slots=True)
class QueuedBatch:
    """Content of the queue for one batch."""

    samples: list[Sample] = field(default_factory=list)
    events: list[EventRow] = field(default_factory=list)
    """Their ids are assigned by ``BatchBuilder``."""
    documents: dict[tuple[str, str], Document] = field(default_factory=dict)
    """The newest of each kind and id."""
    labels: dict[str, tuple[str, Text]] = field(default_factory=dict)
    accepted: int = 0
    """Number of items accepted up to and including this batch: what a flush waits for."""


class WriteQueue:
    """Bounded queue between the event loop's thread and the writer's."""

    def __init__(self, max_samples: int = MAX_QUEUED_SAMPLES, max_notes: int = MAX_QUEUED_NOTES) -> None:
        self._lock = Lock()
        self._max_samples, self._max_notes = max_samples, max_notes
        self._batches: deque[Sequence[Sample]] = deque()
        self._waiting = QueuedBatch()
        self._gaps: dict[str, int] = {}
        self.queued = 0
        """Number of samples in the queue."""
        self.samples = 0
        """Number of samples accepted since the start, gap markers included."""
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
        """Return one gap for each tag, at its first dropped sample."""
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
            key = (document.kind, document.id)
            if key not in self._waiting.documents and len(self._waiting.documents) >= self._max_notes:
                self.lost_notes += 1
                return
            self._waiting.documents[key] = document
            self.accepted += 1

    def set_labels(self, labels: Mapping[str, tuple[str, Text]]) -> None:
        with self._lock:
            self._waiting.labels.update(labels)
            self.accepted += 1

    def take(self, max_samples: int) -> QueuedBatch:
        """Remove and return the content of the queue, with about ``max_samples`` samples."""
        with self._lock:
            content, self._waiting = self._waiting, QueuedBatch()
            while self._batches and len(content.samples) < max_samples:
                content.samples.extend(self._batches.popleft())
            self.queued -= len(content.samples)
            content.accepted = self.accepted - self.queued
            return content


def sample_values(samples: Sequence[Sample]) -> array[float]:
    """Return the samples' values; NaN, which stands for a gap, for one that has none or is infinite."""
    values = [sample.value for sample in samples]
    if None not in values and math.isfinite(sum(values)):  # type: ignore[arg-type]
        return array("d", values)  # type: ignore[arg-type]
    return array("d", [math.nan if value is None or math.isinf(value) else value for value in values])


@dataclass(frozen=True, slots=True)
class PendingBatch:
    """Batch that is written again until it is durable."""

    batch: Batch
    groups: list[tuple[int, int, SampleColumns]]
    """Tag, number of its first sample, samples."""
    accepted: int
    """``QueuedBatch.accepted`` of its content."""


class BatchBuilder:
    """Builder of batches from the queue, with every tag and the last numbers of batches and events."""

    def __init__(self) -> None:
        self.tags: dict[str, Tag] = {}
        self.last_batch = 0
        """Number of the last row of the table ``journal``."""
        self._last_event = 0
        self._labels: dict[str, tuple[str, Text]] = {}

    def resume(self, contents: StoreContents) -> None:
        """Continue after the content of a store."""
        self.tags = {tag.name: tag for tag in contents.tags}
        self._last_event = contents.last_event

    def build(self, queued: QueuedBatch, next_number: Callable[[int], int]) -> PendingBatch:
        """Build a batch. ``next_number`` returns the number of a known tag's next sample."""
        by_tag: defaultdict[str, list[Sample]] = defaultdict(list)
        for sample in queued.samples:
            by_tag[sample.tag].append(sample)
        tags = self._changed_tags(list(by_tag), queued)
        new = {tag.name: tag.id for tag in tags if tag.name not in self.tags}
        groups = []
        for name, samples in by_tag.items():
            tag, first = (new[name], 0) if name in new else (self.tags[name].id, next_number(self.tags[name].id))
            groups.append((tag, first, _sample_columns(samples)))
        events = [replace(event, id=self._last_event + n) for n, event in enumerate(queued.events, 1)]
        packed = encode_batch(groups) if groups else None
        batch = Batch(self.last_batch + 1, packed, tags, events, list(queued.documents.values()))
        return PendingBatch(batch, groups, queued.accepted)

    def _changed_tags(self, names: list[str], queued: QueuedBatch) -> list[Tag]:
        """Return the tags that are new or have a new unit or text."""
        changed = []
        self._labels.update(queued.labels)
        free = 1 + max((tag.id for tag in self.tags.values()), default=0)
        for name in dict.fromkeys([*names, *(name for name in queued.labels if name in self.tags)]):
            tag = self.tags.get(name) or Tag(id=free, name=name)
            free += tag.id == free
            if name in self._labels:
                unit, text = self._labels[name]
                tag = replace(tag, unit=unit, text=text)
            if self.tags.get(name) != tag:
                changed.append(tag)
        return changed

    def confirm(self, batch: Batch) -> None:
        """Take over the numbers of a batch that is durable."""
        self.tags |= {tag.name: tag for tag in batch.tags}
        self.last_batch = batch.id
        self._last_event += len(batch.events)


def _sample_columns(samples: list[Sample]) -> SampleColumns:
    return (
        array("q", [sample.time_ms for sample in samples]),
        sample_values(samples),
        bytes([CODE_BY_QUALITY[sample.quality] for sample in samples]),
    )


class HistoryWriter:
    """Writer of a store. It must be the store's only writer."""

    def __init__(
        self,
        store: HistoryStore,
        setting: HistoryConfig,
        queue: WriteQueue,
        *,
        wall_ms: Callable[[], int],
    ) -> None:
        self._store, self._setting, self._queue = store, setting, queue
        self._wall_ms, self._monotonic_s = wall_ms, time.monotonic
        self.open_blocks = OpenBlocks()
        self.problem: Text | None = None
        """Reason that prevents writing; None if the last write succeeded."""
        self.written_count = 0
        """Number of accepted items that are durable."""
        self._builder = BatchBuilder()
        self._pending: PendingBatch | None = None
        self._is_open = False
        self._reported_lost = 0
        """Number of lost samples in the log."""
        self._was_open = False
        """Whether the store was open before, so that the open blocks in memory are valid."""
        self._clock_ms = 0
        self._clock_s = self._retention_s = self._monotonic_s()

    @property
    def tags(self) -> dict[str, Tag]:
        """All tags by name."""
        return self._builder.tags

    def run_cycle(self) -> None:
        """Write, compact and delete; called once each flush interval. Raises no StoreError."""
        with suppress(StoreError):
            self.write()
            self._compact_due()
            self._apply_retention()

    def write(self) -> None:
        """Make everything durable that was queued at the call. Raises StoreError."""
        accepted = self._queue.accepted
        self._guarded(self._write_batch)
        while self.written_count < accepted:
            self._guarded(self._write_batch)

    def close(self) -> None:
        """Write the last batch, as far as the store accepts it, and close the store."""
        try:
            self.write()
        except StoreError:
            LOG.error(i18n.preferred_text("log.history_lost", reason=self.problem))
        finally:
            self._is_open = False
            with suppress(StoreError):
                self._store.close()

    def compact_all(self) -> None:
        """Compact all open samples. Raises StoreError."""
        self.write()
        self._guarded(lambda: self._compact([tag for tag, _ in self.open_blocks.oldest_first()]))

    def _guarded(self, step: Callable[[], None]) -> None:
        try:
            if not self._is_open:
                self._open()
            step()
        except StoreError as error:
            self._record_failure(error)
            raise
        except DamagedBlock as error:
            failure = StoreError(bilingual_text("history.damaged_block", detail=str(error)))
            self._record_failure(failure)
            raise failure from error
        if self.problem is not None:
            self.problem = None
            self._report_lost_samples()

    def _report_lost_samples(self) -> None:
        lost = self._queue.lost_samples - self._reported_lost
        self._reported_lost += lost
        if lost:
            LOG.warning(i18n.preferred_text("log.history_again", lost=lost))

    def _record_failure(self, error: StoreError) -> None:
        """Close the store and keep the error: the service raises an alarm of it, and only that alarm is logged."""
        self._is_open = False
        LOG.debug("history can't be written: %s", error)
        self.problem = error.reason
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
                compaction.age_clock_at_start(contents.clock, self._wall_ms()),
                self._monotonic_s(),
            )
            self._queue.append(self._pause_markers())
        self._is_open = self._was_open = True

    def _replay(self, contents: StoreContents) -> None:
        """Load the durable samples that are not in blocks yet, after a start."""
        self.open_blocks = OpenBlocks()
        self._builder.resume(contents)
        for tag in contents.tags:
            self.open_blocks.add_tag(tag.id, tag.first_uncompacted)
        for batch, data in self._store.journal():
            self.open_blocks.add(batch, decode_batch(data))
            self._builder.last_batch = batch

    def _pause_markers(self) -> list[Sample]:
        """Return a gap directly after the last value of each tag: until when that was true is not known.

        A tag whose samples are all compacted has none: the service was killed in the moment after that.
        """
        names = {tag.id: tag.name for tag in self.tags.values()}
        return [
            Sample(names[tag], time_ms + 1, None, Quality.BAD)
            for tag, (time_ms, code) in self.open_blocks.last_samples().items()
            if QUALITY_BY_CODE[code] is not Quality.BAD
        ]

    def _write_batch(self) -> None:
        if self._pending is None:
            self._pending = self._builder.build(self._queue.take(MAX_BATCH_SAMPLES), self.open_blocks.next_number)
        pending, batch = self._pending, self._pending.batch
        if batch.samples or batch.tags or batch.events or batch.documents:
            self._store.write_batch(batch)
        for tag in batch.tags:
            if tag.name not in self.tags:
                self.open_blocks.add_tag(tag.id, 0)
        self._builder.confirm(batch)
        self.open_blocks.add(batch.id, pending.groups)
        self.written_count = pending.accepted
        self._pending = None

    def _compact_due(self) -> None:
        limit = max(MAX_OPEN_SAMPLES, MAX_OPEN_SAMPLES_PER_TAG * len(self.tags))
        until = self._monotonic_s() + COMPACTION_BUDGET_S
        while due := self._due_tags(limit):
            self._guarded(lambda due=due: self._compact(due))  # type: ignore[misc]
            if self.open_blocks.total < 2 * limit and self._monotonic_s() > until:
                return

    def _due_tags(self, limit: int) -> list[int]:
        """Return the tags with a full block, and while the journal is too long those that hold its oldest rows."""
        excess, due = self.open_blocks.total - limit, []
        for tag, size in self.open_blocks.oldest_first():
            if size >= FULL_BLOCK_SAMPLES or excess > 0:
                due.append(tag)
                excess -= size
        return due[:TAGS_PER_COMPACTION]

    def _compact(self, tags: list[int]) -> None:
        for at in range(0, len(tags), TAGS_PER_COMPACTION):
            part = tags[at : at + TAGS_PER_COMPACTION]
            compactions = [self._compaction_of(tag) for tag in part]
            self._store.compact(compactions, self._age_clock_ms(), self.open_blocks.oldest_batch(without=set(part)))
            for compaction_done in compactions:
                self.open_blocks.drop_compacted(compaction_done.tag, compaction_done.to_number)

    def _compaction_of(self, tag: int) -> Compaction:
        first, samples = self.open_blocks.copy(tag)
        time.sleep(COMPACTION_PAUSE_S)
        return compact_samples(tag, first, samples, self._store.merged_block)

    def _age_clock_ms(self) -> int:
        """Return the age clock in ms: running time of the service plus counted pauses."""
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
