"""The one writer: makes durable what the intake holds, moves it into blocks, forgets what is too old.

Every method runs on the writer's thread. A store that fails is closed and opened again at the next
round; until then the batch stays in memory and the intake fills, and nobody else notices.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from contextlib import suppress

from drivebus import clock
from drivebus.service.config.model import HistoryConfig
from drivebus.service.historian import retention
from drivebus.service.historian.batch_builder import BatchBuilder, PendingBatch
from drivebus.service.historian.blocks import DamagedBlock, decode_batch
from drivebus.service.historian.compaction import compact_samples
from drivebus.service.historian.open_blocks import OpenBlocks
from drivebus.service.historian.store import Compaction, HistoryStore, StoreContents, StoreError, Tag
from drivebus.service.historian.write_queue import WriteQueue

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
                retention.clock_at_start(contents.clock, self._wall_ms()),
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
            rule(self._store, self._setting, now_ms) for rule in (retention.delete_expired, retention.delete_oversize)
        ]
        self._retention_s = self._monotonic_s() + (0.0 if any(more) else RETENTION_INTERVAL_S)
