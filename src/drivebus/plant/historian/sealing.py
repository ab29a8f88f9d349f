"""Samples of one tag become blocks at every level. Pure, but for the rows of merged levels, which it asks for."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import groupby

from drivebus.plant.historian import blocks
from drivebus.plant.historian.blocks import Samples
from drivebus.plant.historian.levels import GRAINS, Level
from drivebus.plant.historian.points import Points, of_samples, roll, split, together
from drivebus.plant.historian.store import Block, Seal

Found = Callable[[Level, int, int], bytes | None]
"""The row of a merged level's partition: level, tag, beginning (ms)."""


def seal(tag: int, first: int, samples: Samples, found: Found) -> Seal:
    """All blocks that these samples make or change; ``first`` is the number of the first."""
    made = list(_raw(tag, first, samples))
    points = of_samples(*samples)
    for level in (Level.SECOND, Level.MINUTE, Level.HOUR):
        points = roll(points, GRAINS[level].width_ms)
        made += _rolled(level, tag, first, points, found)
    return Seal(tag, first + len(samples[0]), made)


def _raw(tag: int, first: int, samples: Samples) -> Iterator[Block]:
    """In the order in which they came: a clock that jumps to another hour and back makes a block each time."""
    time, value, quality = samples
    length = GRAINS[Level.RAW].partition_ms
    at = 0
    for hour, run in groupby(moment // length for moment in time):
        end = at + sum(1 for _ in run)
        data = blocks.encode_samples(hour * length, time[at:end], value[at:end], quality[at:end])
        yield Block(Level.RAW, tag, hour * length, first + at, data)
        at = end


def _rolled(level: Level, tag: int, first: int, points: Points, found: Found) -> Iterator[Block]:
    grain = GRAINS[level]
    for start_ms, part in split(points, grain.partition_ms):
        there = found(level, tag, start_ms) if grain.merged else None
        if there is not None:
            part = roll(together([blocks.decode_points(start_ms, grain.width_ms, there), part]), grain.width_ms)
        data = blocks.encode_points(start_ms, grain.width_ms, part)
        yield Block(level, tag, start_ms, 0 if grain.merged else first, data)
