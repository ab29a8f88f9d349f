"""Columns of one signal and how they are rolled up. Pure: time is in the data.

A rollup can be rolled up again and two rollups of the same stretch can be put together (late samples, a second seal),
because each point carries how many values it stands for.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import compress
from operator import mul, ne, truediv

from drivebus.values import Quality

GOOD, UNCERTAIN, BAD = 0, 1, 2
CODE_BY_QUALITY: dict[Quality, int] = {Quality.GOOD: GOOD, Quality.UNCERTAIN: UNCERTAIN, Quality.BAD: BAD}
QUALITY_BY_CODE: tuple[Quality, ...] = (Quality.GOOD, Quality.UNCERTAIN, Quality.BAD)


@dataclass(slots=True)
class Points:
    """Columns of equal length. ``low``, ``mean`` and ``high`` are NaN where ``count`` is 0: a gap."""

    time: Sequence[int] = field(default_factory=list)
    """UTC ms: the sample's own time, or the beginning of what the point stands for."""
    count: Sequence[int] = field(default_factory=list)
    """Values that the point stands for; a bad one does not count."""
    low: Sequence[float] = field(default_factory=list)
    mean: Sequence[float] = field(default_factory=list)
    high: Sequence[float] = field(default_factory=list)
    quality: bytes = b""
    """0 all good, 2 nothing to trust, 1 something between."""

    def __len__(self) -> int:
        return len(self.time)

    def columns(self) -> tuple[Sequence[int], Sequence[int], Sequence[float], Sequence[float], Sequence[float], bytes]:
        return self.time, self.count, self.low, self.mean, self.high, self.quality


def points_of_samples(time: Sequence[int], value: Sequence[float], quality: bytes) -> Points:
    """Samples as points in the order of their times; samples of one time stay in the order in which they came.

    A bad sample is a gap, whatever value stands beside it: nothing stale is shown as live (G17).
    """
    known = [0 if code == BAD or number != number else 1 for code, number in zip(quality, value, strict=True)]
    if 0 in known:
        value = [number if one else math.nan for number, one in zip(value, known, strict=True)]
    return sorted_by_time(Points(time, known, value, value, value, quality))


def sorted_by_time(points: Points) -> Points:
    """Sorted by time, and stable."""
    time = list(points.time)
    if time == sorted(time):
        return points
    order = sorted(range(len(time)), key=time.__getitem__)
    _, count, low, mean, high, quality = points.columns()
    return Points(
        [time[n] for n in order],
        [count[n] for n in order],
        [low[n] for n in order],
        [mean[n] for n in order],
        [high[n] for n in order],
        bytes([quality[n] for n in order]),
    )


def concat(pieces: Iterable[Points]) -> Points:
    """All pieces as one, in the order of their times."""
    found = Points([], [], [], [], [], b"")
    time, count, low, mean, high = list[int](), list[int](), list[float](), list[float](), list[float]()
    for piece in pieces:
        time += piece.time
        count += piece.count
        low += piece.low
        mean += piece.mean
        high += piece.high
        found.quality += piece.quality
    return sorted_by_time(Points(time, count, low, mean, high, found.quality))


def slice_time(points: Points, first_ms: int, last_ms: int) -> Points:
    """Those with ``first_ms <= time <= last_ms``; they are in order."""
    return _slice(points, bisect_left(points.time, first_ms), bisect_right(points.time, last_ms))


def _slice(points: Points, a: int, b: int) -> Points:
    time, count, low, mean, high, quality = points.columns()
    return Points(time[a:b], count[a:b], low[a:b], mean[a:b], high[a:b], quality[a:b])


def _bucket_ranges(time: Sequence[int], width_ms: int) -> list[tuple[int, int]]:
    """Where each stretch of ``width_ms`` begins and ends in the column ``time``, which is in order."""
    if not time:
        return []
    if (time[-1] - time[0]) // width_ms * 8 > len(time):
        keys = [moment // width_ms for moment in time]
        changes = list(compress(range(1, len(keys)), map(ne, keys, keys[1:])))
        return list(zip([0, *changes], [*changes, len(keys)], strict=True))
    found, begin = [], 0
    while begin < len(time):
        end = bisect_left(time, (time[begin] // width_ms + 1) * width_ms, begin)
        found.append((begin, end))
        begin = end
    return found


def roll_up(points: Points, width_ms: int) -> Points:
    """One point for each ``width_ms``, counted from 1970, that has any; ``points`` are in order."""
    time, count, low, mean, high, quality = points.columns()
    runs = _bucket_ranges(time, width_ms)
    starts = [time[begin] // width_ms * width_ms for begin, _ in runs]
    if len(runs) == len(time):
        return Points(starts, count, low, mean, high, quality)
    rolled = _roll_up_complete if 0 not in count else _roll_up_with_gaps
    counts, lows, means, highs = rolled(runs, count, low, mean, high)
    all_good = quality.count(GOOD) == len(quality)
    qualities = bytes(len(runs)) if all_good else bytes([_combined_quality(quality[a:b]) for a, b in runs])
    return Points(starts, counts, lows, means, highs, qualities)


BucketRanges = list[tuple[int, int]]
RolledColumns = tuple[list[int], list[float], list[float], list[float]]
Column = Sequence[float]


def _roll_up_complete(
    runs: BucketRanges, count: Sequence[int], low: Column, mean: Column, high: Column
) -> RolledColumns:
    """Every point has a value."""
    lows, highs = [min(low[a:b]) for a, b in runs], [max(high[a:b]) for a, b in runs]
    counts = [sum(count[a:b]) for a, b in runs]
    weighed = mean if count.count(1) == len(count) else list(map(mul, mean, count))
    means = map(truediv, [sum(weighed[a:b]) for a, b in runs], counts)
    # Rounding may not push a mean out of what it is the mean of.
    return counts, lows, list(map(min, map(max, means, lows), highs)), highs


def _roll_up_with_gaps(
    runs: BucketRanges, count: Sequence[int], low: Column, mean: Column, high: Column
) -> RolledColumns:
    """Some points are gaps: each run without them, and a gap where nothing is left."""
    counts, lows, means, highs = list[int](), list[float](), list[float](), list[float]()
    for a, b in runs:
        columns = [list(compress(column[a:b], count[a:b])) for column in (count, low, mean, high)]
        if columns[0]:
            whole = [(0, len(columns[0]))]
            one = _roll_up_complete(whole, [int(n) for n in columns[0]], columns[1], columns[2], columns[3])
        else:
            one = [0], [math.nan], [math.nan], [math.nan]
        counts += one[0]
        lows += one[1]
        means += one[2]
        highs += one[3]
    return counts, lows, means, highs


def _combined_quality(codes: bytes) -> int:
    """Good only where all are good, bad only where all are bad."""
    for code in (GOOD, BAD):
        if codes.count(code) == len(codes):
            return code
    return UNCERTAIN


def split_partitions(points: Points, width_ms: int) -> Iterable[tuple[int, Points]]:
    """Cut where one stretch of ``width_ms`` ends: the stretch's beginning (ms) and its points; they are in order."""
    for a, b in _bucket_ranges(points.time, width_ms):
        yield points.time[a] // width_ms * width_ms, _slice(points, a, b)
