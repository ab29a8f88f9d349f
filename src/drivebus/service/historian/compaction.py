"""Life of samples in the store: open blocks (durable in the journal), compaction into blocks, retention.

Samples of a tag are numbered 0, 1, 2 … in order of arrival. When the wall clock is set back, later samples have larger
numbers and earlier times, and none is lost or moved.
The age clock counts the running time of the service; pauses of the service count for at most one day each. The age of
a row is read from it, so that a jump of the wall clock makes no row older.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Container, Iterable, Iterator
from dataclasses import dataclass, field
from threading import Lock

from drivebus.service.config.model import HistoryConfig
from drivebus.service.historian import blocks
from drivebus.service.historian.blocks import SampleColumns
from drivebus.service.historian.points import (
    DAY_MS,
    HOUR_MS,
    RESOLUTIONS,
    Points,
    ResolutionLevel,
    bucket_ranges,
    concat,
    points_of_samples,
    roll_up,
    split_partitions,
)
from drivebus.service.historian.store import Block, Compaction, HistoryStore


@dataclass(slots=True)
class TagBuffer:
    """Open samples of one tag from number ``first`` on."""

    first: int
    oldest_batch: int = 0
    """Row of the journal that holds sample ``first``."""
    time: array[int] = field(default_factory=lambda: array("q"))
    value: array[float] = field(default_factory=lambda: array("d"))
    quality: bytearray = field(default_factory=bytearray)

    def __len__(self) -> int:
        return len(self.time)

    @property
    def next_number(self) -> int:
        return self.first + len(self.time)

    def samples(self, skip: int = 0) -> SampleColumns:
        return self.time[skip:].tolist(), self.value[skip:].tolist(), bytes(self.quality[skip:])


class OpenBlocks:
    """Open samples of all tags. The writer changes them, readers copy them."""

    def __init__(self) -> None:
        self._buffers: dict[int, TagBuffer] = {}
        self._lock = Lock()
        self.total = 0

    def add_tag(self, tag: int, first: int) -> None:
        """Add a tag whose samples before number ``first`` are in blocks."""
        self._buffers[tag] = TagBuffer(first)

    def next_number(self, tag: int) -> int:
        return self._buffers[tag].next_number

    def add(self, batch: int, groups: Iterable[tuple[int, int, SampleColumns]]) -> None:
        """Add the samples of journal row ``batch``. After a restart those already in blocks are skipped."""
        with self._lock:
            for tag, first, (time, value, quality) in groups:
                buffer = self._buffers[tag]
                skip = max(0, buffer.next_number - first)
                if skip >= len(time):
                    continue
                buffer.oldest_batch = buffer.oldest_batch if len(buffer) else batch
                buffer.time.extend(time[skip:])
                buffer.value.extend(value[skip:])
                buffer.quality.extend(quality[skip:])
                self.total += len(time) - skip

    def copy(self, tag: int) -> tuple[int, SampleColumns]:
        """Return the number of the first open sample and the samples."""
        with self._lock:
            buffer = self._buffers[tag]
            return buffer.first, buffer.samples()

    def last_samples(self) -> dict[int, tuple[int, int]]:
        """Return time and quality code of the newest open sample of each tag that has one."""
        with self._lock:
            return {tag: (buffer.time[-1], buffer.quality[-1]) for tag, buffer in self._buffers.items() if len(buffer)}

    def drop_compacted(self, tag: int, upto: int) -> None:
        """Remove the samples before number ``upto``, which are in blocks now. Unknown tags are ignored."""
        with self._lock:
            if (buffer := self._buffers.get(tag)) is None:
                return
            done = min(max(0, upto - buffer.first), len(buffer))
            rest = TagBuffer(max(upto, buffer.first), buffer.oldest_batch)
            rest.time, rest.value, rest.quality = buffer.time[done:], buffer.value[done:], buffer.quality[done:]
            self._buffers[tag] = rest
            self.total -= done

    def oldest_first(self) -> list[tuple[int, int]]:
        """Return ``(tag, number of samples)``, the tag that holds the oldest journal row first."""
        buffered = [(buffer.oldest_batch, -len(buffer), tag) for tag, buffer in self._buffers.items() if len(buffer)]
        return [(tag, -size) for _, size, tag in sorted(buffered)]

    def oldest_batch(self, without: Container[int]) -> int | None:
        """Return the oldest journal row that is needed once the tags ``without`` are compacted."""
        buffered = (buffer.oldest_batch for tag, buffer in self._buffers.items() if len(buffer) and tag not in without)
        return min(buffered, default=None)


MergedBlockLookup = Callable[[ResolutionLevel, int, int], bytes | None]
"""Lookup of the block of a merged level's partition: level, tag, start (ms)."""


def compact_samples(tag: int, first: int, samples: SampleColumns, find_block: MergedBlockLookup) -> Compaction:
    """Return all blocks that these samples create or change. ``first`` is the number of the first sample."""
    blocks_made = list(_raw_blocks(tag, first, samples))
    points = points_of_samples(*samples)
    for level in (ResolutionLevel.SECOND, ResolutionLevel.MINUTE, ResolutionLevel.HOUR):
        points = roll_up(points, RESOLUTIONS[level].width_ms)
        blocks_made += _rollup_blocks(level, tag, first, points, find_block)
    return Compaction(tag, first + len(samples[0]), blocks_made)


def _raw_blocks(tag: int, first: int, samples: SampleColumns) -> Iterator[Block]:
    """Yield raw blocks in order of arrival: a clock that jumps to another hour and back makes a block each time."""
    time, value, quality = samples
    length = RESOLUTIONS[ResolutionLevel.RAW].partition_ms
    for begin, end in bucket_ranges(time, length):
        start_ms = time[begin] // length * length
        data = blocks.encode_samples(time[begin:end], value[begin:end], quality[begin:end])
        yield Block(ResolutionLevel.RAW, tag, start_ms, first + begin, data)


def _rollup_blocks(
    level: ResolutionLevel, tag: int, first: int, points: Points, find_block: MergedBlockLookup
) -> Iterator[Block]:
    resolution = RESOLUTIONS[level]
    for start_ms, part in split_partitions(points, resolution.partition_ms):
        stored = find_block(level, tag, start_ms) if resolution.merged else None
        if stored is not None:
            part = roll_up(concat([blocks.decode_points(stored), part]), resolution.width_ms)
        data = blocks.encode_points(part)
        yield Block(level, tag, start_ms, 0 if resolution.merged else first, data)


MAX_COUNTED_PAUSE_MS = DAY_MS
"""Part of a pause of the service that counts as age."""
MAX_EVENTS = 1_000_000
"""Newest events that are kept: about 300 MB."""
DELETE_BATCH_ROWS = 200
"""Rows deleted in one transaction: some tens of milliseconds."""
MIN_RETENTION_MS = 2 * HOUR_MS
"""The size limit deletes nothing younger, so that the chart of the last hour is never empty."""


def age_clock_at_start(saved: tuple[int, int] | None, wall_ms: int) -> int:
    """Return the age clock at the start. ``saved``: age clock and wall clock when they were last saved."""
    if saved is None:
        return 0
    clock_ms, then_ms = saved
    return clock_ms + min(max(0, wall_ms - then_ms), MAX_COUNTED_PAUSE_MS)


def retention_days(setting: HistoryConfig, level: ResolutionLevel) -> float:
    return {
        ResolutionLevel.RAW: setting.retention.raw_days,
        ResolutionLevel.SECOND: setting.retention.rollup_1s_days,
        ResolutionLevel.MINUTE: setting.retention.rollup_1min_days,
        ResolutionLevel.HOUR: setting.retention.rollup_1h_days,
    }[level]


def delete_expired(store: HistoryStore, setting: HistoryConfig, now_ms: int) -> bool:
    """Delete a batch of expired rows and return whether there may be more. Raises StoreError."""
    oldest = {level: now_ms - round(retention_days(setting, level) * DAY_MS) for level in ResolutionLevel}
    store.delete_events(MAX_EVENTS)
    return DELETE_BATCH_ROWS in [
        store.delete_blocks(level, before, DELETE_BATCH_ROWS) for level, before in oldest.items()
    ]


def delete_oversize(store: HistoryStore, setting: HistoryConfig, now_ms: int) -> bool:
    """Delete a batch of rows if the store is too large, and return whether there may be more. Raises StoreError.

    The finest level and the oldest rows go first.
    """
    if store.size_bytes() <= setting.max_size_mb * 1e6:
        return False
    for level in RESOLUTIONS:
        oldest = store.oldest_stored_ms(level, DELETE_BATCH_ROWS) or store.oldest_stored_ms(level, 0)
        if oldest is not None and store.delete_blocks(
            level, min(oldest + 1, now_ms - MIN_RETENTION_MS), DELETE_BATCH_ROWS
        ):
            return True
    return False
