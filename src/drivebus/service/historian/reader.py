"""Reader of the history: combines stored blocks with the writer's open samples, on a connection and thread of its own.

Open samples are copied first, then the database is read in one snapshot. The snapshot's ``first_uncompacted`` of a tag
shows which copied samples became blocks in between, so that none is missing and none counts twice.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from operator import itemgetter

from drivebus.service.historian import blocks
from drivebus.service.historian.blocks import SampleColumns
from drivebus.service.historian.columns import DamagedBlock
from drivebus.service.historian.compaction import OpenBlocks
from drivebus.service.historian.points import (
    RESOLUTIONS,
    Points,
    ResolutionLevel,
    concat,
    points_of_samples,
    roll_up,
    slice_time,
)
from drivebus.service.historian.store import Block, HistoryStore, StoreError
from drivebus.values import bilingual_text


@dataclass(frozen=True, slots=True)
class NumberedSamples:
    """Samples of a tag with their numbers, in order of arrival."""

    number: list[int]
    samples: SampleColumns


class HistoryReader:
    """Reader of a store. All methods run on the reader's thread and raise StoreError."""

    def __init__(self, store: HistoryStore, open_blocks: Callable[[], OpenBlocks]) -> None:
        self._store = store
        self._open_blocks = open_blocks
        self._is_open = False

    @property
    def store(self) -> HistoryStore:
        """The store, opened on first use."""
        if not self._is_open:
            self._store.open()
            self._is_open = True
        return self._store

    def close(self) -> None:
        self._is_open = False
        self._store.close()

    def points(
        self, level: ResolutionLevel, tags: Sequence[int], from_ms: int, to_ms: int
    ) -> Iterator[tuple[int, Points]]:
        """Yield tag by tag the sorted points in the time range; rollups include the point that ``from_ms`` falls into.

        Only one tag's points are in memory at a time: allocating the memory of ten took as long as the work.
        """
        width = RESOLUTIONS[level].width_ms
        first = from_ms if level is ResolutionLevel.RAW else from_ms // width * width
        fresh, rows = self._snapshot(level, tags, from_ms, to_ms)
        stored: dict[int, list[Block]] = {tag: [] for tag in tags}
        for row in rows:
            stored[row.tag].append(row)
        for tag, (_, samples) in fresh.items():
            points = points_of_samples(*samples)
            open_points = points if level is ResolutionLevel.RAW else roll_up(points, width)
            pieces = [_decode_block(row, first, to_ms) for row in stored[tag]]
            yield tag, concat([*pieces, slice_time(open_points, first, to_ms)])

    def samples(self, tags: Sequence[int], from_ms: int, to_ms: int) -> dict[int, NumberedSamples]:
        """Return the samples of each tag with their numbers, in order of arrival."""
        by_tag = {tag: NumberedSamples([], ([], [], b"")) for tag in tags}
        fresh, rows = self._snapshot(ResolutionLevel.RAW, tags, from_ms, to_ms)
        runs = [(row.tag, row.number, _decode_samples(row)) for row in rows]
        for tag, first, samples in sorted([*runs, *((tag, *run) for tag, run in fresh.items())], key=itemgetter(0, 1)):
            by_tag[tag] = _with_samples_in_range(by_tag[tag], first, samples, from_ms, to_ms)
        return by_tag

    def next_partition(self, level: ResolutionLevel, tags: Sequence[int], from_ms: int) -> int | None:
        """Return the start of the first partition at ``from_ms`` or later with any of these tags."""
        length = RESOLUTIONS[level].partition_ms
        times = (time for tag in tags for time in self._open_blocks().copy(tag)[1][0])
        fresh = [start for start in {time // length * length for time in times} if start >= from_ms]
        stored = self.store.next_partition(level, tags, from_ms)
        return min(fresh if stored is None else [*fresh, stored], default=None)

    def _snapshot(
        self, level: ResolutionLevel, tags: Sequence[int], from_ms: int, to_ms: int
    ) -> tuple[dict[int, tuple[int, SampleColumns]], list[Block]]:
        fresh = {tag: self._open_blocks().copy(tag) for tag in tags}
        length = RESOLUTIONS[level].partition_ms
        first_uncompacted, rows = self.store.read_blocks(level, tags, from_ms // length * length, to_ms)
        return {
            tag: _skip_compacted(first, samples, first_uncompacted.get(tag, 0))
            for tag, (first, samples) in fresh.items()
        }, rows


def _skip_compacted(first: int, samples: SampleColumns, first_uncompacted: int) -> tuple[int, SampleColumns]:
    """Drop the samples before number ``first_uncompacted``."""
    skip = max(0, first_uncompacted - first)
    time, value, quality = samples
    return first + skip, (time[skip:], value[skip:], quality[skip:])


def _decode_block(row: Block, first_ms: int, last_ms: int) -> Points:
    """Return the sorted points of a row in the time range."""
    if row.level is ResolutionLevel.RAW:
        return slice_time(points_of_samples(*_decode_samples(row)), first_ms, last_ms)
    with _naming_damaged_row(row):
        return blocks.decode_points(row.data, first_ms, last_ms)


def _decode_samples(row: Block) -> SampleColumns:
    with _naming_damaged_row(row):
        return blocks.decode_samples(row.data)


@contextmanager
def _naming_damaged_row(row: Block) -> Iterator[None]:
    """Turn DamagedBlock into a StoreError that names the row."""
    try:
        yield
    except DamagedBlock as error:
        detail = f"block {row.level} {row.tag} {row.start_ms}: {error}"
        raise StoreError(bilingual_text("history.damaged_block", detail=detail)) from error


def _with_samples_in_range(
    earlier: NumberedSamples, first: int, samples: SampleColumns, from_ms: int, to_ms: int
) -> NumberedSamples:
    """Return ``earlier`` with the samples of a time range after its own; ``first``: number of the first of them."""
    time, value, quality = samples
    times, values, qualities = earlier.samples
    indices = [n for n, moment in enumerate(time) if from_ms <= moment <= to_ms]
    return NumberedSamples(
        earlier.number + [first + n for n in indices],
        (
            [*times, *(time[n] for n in indices)],
            [*values, *(value[n] for n in indices)],
            qualities + bytes([quality[n] for n in indices]),
        ),
    )
