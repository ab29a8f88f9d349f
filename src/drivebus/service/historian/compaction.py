"""Samples of one tag become blocks at every level. Pure, but for the rows of merged levels, which it asks for."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import groupby

from drivebus.service.historian import blocks
from drivebus.service.historian.blocks import SampleColumns
from drivebus.service.historian.points import Points, concat, points_of_samples, roll_up, split_partitions
from drivebus.service.historian.resolution import RESOLUTIONS, ResolutionLevel
from drivebus.service.historian.store import Block, Compaction

MergedBlockLookup = Callable[[ResolutionLevel, int, int], bytes | None]
"""The row of a merged level's partition: level, tag, beginning (ms)."""


def compact_samples(tag: int, first: int, samples: SampleColumns, found: MergedBlockLookup) -> Compaction:
    """All blocks that these samples make or change; ``first`` is the number of the first."""
    made = list(_raw_blocks(tag, first, samples))
    points = points_of_samples(*samples)
    for level in (ResolutionLevel.SECOND, ResolutionLevel.MINUTE, ResolutionLevel.HOUR):
        points = roll_up(points, RESOLUTIONS[level].width_ms)
        made += _rollup_blocks(level, tag, first, points, found)
    return Compaction(tag, first + len(samples[0]), made)


def _raw_blocks(tag: int, first: int, samples: SampleColumns) -> Iterator[Block]:
    """In the order in which they came: a clock that jumps to another hour and back makes a block each time."""
    time, value, quality = samples
    length = RESOLUTIONS[ResolutionLevel.RAW].partition_ms
    at = 0
    for hour, run in groupby(moment // length for moment in time):
        end = at + sum(1 for _ in run)
        data = blocks.encode_samples(hour * length, time[at:end], value[at:end], quality[at:end])
        yield Block(ResolutionLevel.RAW, tag, hour * length, first + at, data)
        at = end


def _rollup_blocks(
    level: ResolutionLevel, tag: int, first: int, points: Points, found: MergedBlockLookup
) -> Iterator[Block]:
    grain = RESOLUTIONS[level]
    for start_ms, part in split_partitions(points, grain.partition_ms):
        there = found(level, tag, start_ms) if grain.merged else None
        if there is not None:
            part = roll_up(concat([blocks.decode_points(start_ms, grain.width_ms, there), part]), grain.width_ms)
        data = blocks.encode_points(start_ms, grain.width_ms, part)
        yield Block(level, tag, start_ms, 0 if grain.merged else first, data)
