"""Points of one signal: resolutions, roll-up, and reduction to the points of a chart. Pure.

Each point carries the number of values it stands for, so that a rollup can be rolled up again and two rollups of the
same time can be combined (late samples, a second compaction).
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from itertools import compress, pairwise
from operator import mul, ne
from statistics import median
from typing import Any, TypeVar

from drivebus.types import Json
from drivebus.values import Quality

T = TypeVar("T")

SECOND_MS = 1000
MINUTE_MS = 60 * SECOND_MS
HOUR_MS = 60 * MINUTE_MS
DAY_MS = 24 * HOUR_MS


class ResolutionLevel(IntEnum):
    """Resolution of stored points. The numbers are in the store's rows and must never change."""

    RAW = 0
    SECOND = 1
    MINUTE = 2
    HOUR = 3


@dataclass(frozen=True, slots=True)
class Resolution:
    """Properties of a level's points and rows."""

    name: str
    """Name in the API."""
    width_ms: int
    """Time that one point stands for."""
    partition_ms: int
    """Time that one row stands for, counted from 1970."""
    merged: bool
    """Whether a late sample changes the existing row; else it makes a further row of the same partition."""


RESOLUTIONS: dict[ResolutionLevel, Resolution] = {
    ResolutionLevel.RAW: Resolution("raw", 1, HOUR_MS, merged=False),
    ResolutionLevel.SECOND: Resolution("1s", SECOND_MS, HOUR_MS, merged=False),
    ResolutionLevel.MINUTE: Resolution("1min", MINUTE_MS, DAY_MS, merged=True),
    ResolutionLevel.HOUR: Resolution("1h", HOUR_MS, 40 * DAY_MS, merged=True),
}

LEVEL_BY_NAME: dict[str, ResolutionLevel] = {resolution.name: level for level, resolution in RESOLUTIONS.items()}


GOOD, UNCERTAIN, BAD = 0, 1, 2
CODE_BY_QUALITY: dict[Quality, int] = {Quality.GOOD: GOOD, Quality.UNCERTAIN: UNCERTAIN, Quality.BAD: BAD}
QUALITY_BY_CODE: tuple[Quality, ...] = (Quality.GOOD, Quality.UNCERTAIN, Quality.BAD)


@dataclass(slots=True, kw_only=True)
class Points:
    """Columns of equal length. Where ``count`` is 0, a gap, ``low``, ``mean`` and ``high`` are NaN."""

    time: Sequence[int] = field(default_factory=list)
    """UTC ms: time of the sample, or start of the point's interval."""
    count: Sequence[int] = field(default_factory=list)
    """Number of values that the point stands for; bad ones do not count."""
    low: Sequence[float] = field(default_factory=list)
    mean: Sequence[float] = field(default_factory=list)
    high: Sequence[float] = field(default_factory=list)
    quality: bytes = b""
    """0: all values good; 2: none; 1: some."""

    def __len__(self) -> int:
        return len(self.time)

    def columns(self) -> tuple[Sequence[int], Sequence[int], Sequence[float], Sequence[float], Sequence[float], bytes]:
        return self.time, self.count, self.low, self.mean, self.high, self.quality


def points_of_samples(time: Sequence[int], value: Sequence[float], quality: bytes) -> Points:
    """Return samples as points sorted by time; samples of equal time keep their order.

    A bad sample becomes a gap whatever its value, so that no stale value is shown as live.
    """
    counts = [1] * len(time)
    if BAD in quality or not math.isfinite(sum(value)):
        counts = [0 if code == BAD or number != number else 1 for code, number in zip(quality, value, strict=True)]
        value = [number if count else math.nan for number, count in zip(value, counts, strict=True)]
    return sorted_by_time(Points(time=time, count=counts, low=value, mean=value, high=value, quality=quality))


def sorted_by_time(points: Points) -> Points:
    """Return points sorted by time (stable)."""
    time = list(points.time)
    if time == sorted(time):
        return points
    order = sorted(range(len(time)), key=time.__getitem__)
    _, count, low, mean, high, quality = points.columns()
    return Points(
        time=[time[n] for n in order],
        count=[count[n] for n in order],
        low=[low[n] for n in order],
        mean=[mean[n] for n in order],
        high=[high[n] for n in order],
        quality=bytes([quality[n] for n in order]),
    )


def concat(pieces: Iterable[Points]) -> Points:
    """Return all pieces as one, sorted by time."""
    parts = [piece for piece in pieces if piece.time]
    if len(parts) <= 1:
        return parts[0] if parts else Points()
    mean = _joined(piece.mean for piece in parts)
    flat = all(piece.low is piece.mean is piece.high for piece in parts)
    joined = Points(
        time=_joined(piece.time for piece in parts),
        count=_joined(piece.count for piece in parts),
        low=mean if flat else _joined(piece.low for piece in parts),
        mean=mean,
        high=mean if flat else _joined(piece.high for piece in parts),
        quality=b"".join(piece.quality for piece in parts),
    )
    return sorted_by_time(joined)


def _joined(columns: Iterable[Sequence[T]]) -> list[T]:
    values = list[T]()
    for column in columns:
        values += column
    return values


def slice_time(points: Points, first_ms: int, last_ms: int) -> Points:
    """Return the points with ``first_ms <= time <= last_ms`` of sorted points."""
    return _slice(points, bisect_left(points.time, first_ms), bisect_right(points.time, last_ms))


def _slice(points: Points, a: int, b: int) -> Points:
    time, count, low, mean, high, quality = points.columns()
    lows = low[a:b]
    means, highs = (lows, lows) if low is mean is high else (mean[a:b], high[a:b])
    return Points(time=time[a:b], count=count[a:b], low=lows, mean=means, high=highs, quality=quality[a:b])


def bucket_ranges(time: Sequence[int], width_ms: int) -> list[tuple[int, int]]:
    """Return begin and end index of each run of neighbours in the same bucket of ``width_ms``."""
    if not time:
        return []
    if (time[-1] - time[0]) // width_ms * 8 > len(time) or time != sorted(time):
        keys = [moment // width_ms for moment in time]
        changes = list(compress(range(1, len(keys)), map(ne, keys, keys[1:])))
        return list(zip([0, *changes], [*changes, len(keys)], strict=True))
    ranges, begin = [], 0
    while begin < len(time):
        end = bisect_left(time, (time[begin] // width_ms + 1) * width_ms, begin)
        ranges.append((begin, end))
        begin = end
    return ranges


def roll_up(points: Points, width_ms: int) -> Points:
    """Roll up sorted points to one point for each non-empty bucket of ``width_ms``, counted from 1970."""
    time, count, low, mean, high, quality = points.columns()
    if len(time) <= 1 or (time[-1] - time[0]) // (len(time) - 1) * 2 > width_ms:  # perhaps one in each bucket
        starts = [moment // width_ms * width_ms for moment in time]
        if all(map(ne, starts, starts[1:])):
            return Points(time=starts, count=count, low=low, mean=mean, high=high, quality=quality)
    runs = bucket_ranges(time, width_ms)
    starts = [time[begin] // width_ms * width_ms for begin, _ in runs]
    rolled = _roll_up_complete if 0 not in count else _roll_up_with_gaps
    counts, lows, means, highs = rolled(runs, count, low, mean, high)
    all_good = quality.count(GOOD) == len(quality)
    qualities = bytes(len(runs)) if all_good else bytes([_combined_quality(quality[a:b]) for a, b in runs])
    return Points(time=starts, count=counts, low=lows, mean=means, high=highs, quality=qualities)


BucketRanges = list[tuple[int, int]]
RolledColumns = tuple[list[int], list[float], list[float], list[float]]
Column = Sequence[float]


def _roll_up_complete(
    runs: BucketRanges, count: Sequence[int], low: Column, mean: Column, high: Column
) -> RolledColumns:
    """Roll up points that all have values."""
    lows, highs = [min(low[a:b]) for a, b in runs], [max(high[a:b]) for a, b in runs]
    if count.count(count[0]) == len(count):
        counts = [count[0] * (b - a) for a, b in runs]
        means = [sum(mean[a:b]) / (b - a) for a, b in runs]
    else:
        counts = [sum(count[a:b]) for a, b in runs]
        weighed = list(map(mul, mean, count))
        means = [sum(weighed[a:b]) / total for (a, b), total in zip(runs, counts, strict=True)]
    # Rounding must not move a mean outside the range of its values.
    return counts, lows, list(map(min, map(max, means, lows), highs)), highs


def _roll_up_with_gaps(
    runs: BucketRanges, count: Sequence[int], low: Column, mean: Column, high: Column
) -> RolledColumns:
    """Roll up points with gaps: without them, and to a gap where no value is left."""
    counts, lows, means, highs = list[int](), list[float](), list[float](), list[float]()
    for a, b in runs:
        columns = [list(compress(column[a:b], count[a:b])) for column in (count, low, mean, high)]
        if columns[0]:
            whole = [(0, len(columns[0]))]
            columns_of_part = _roll_up_complete(whole, [int(n) for n in columns[0]], columns[1], columns[2], columns[3])
        else:
            columns_of_part = [0], [math.nan], [math.nan], [math.nan]
        counts += columns_of_part[0]
        lows += columns_of_part[1]
        means += columns_of_part[2]
        highs += columns_of_part[3]
    return counts, lows, means, highs


def _combined_quality(codes: bytes) -> int:
    """Return GOOD if all are good, BAD if all are bad, else UNCERTAIN."""
    for code in (GOOD, BAD):
        if codes.count(code) == len(codes):
            return code
    return UNCERTAIN


def split_partitions(points: Points, width_ms: int) -> Iterable[tuple[int, Points]]:
    """Yield the start (ms) and the points of each partition of ``width_ms``; ``points`` are sorted."""
    for a, b in bucket_ranges(points.time, width_ms):
        yield points.time[a] // width_ms * width_ms, _slice(points, a, b)


MEAN_DIGITS = 6
"""Decimal places of a mean."""
MIN_POINTS_DIVISOR = 4
"""A level with a quarter of the requested points is fine enough; all of them would mean to read up to 60 times as many
instead of 15.
"""
MISSING_SPAN_DIVISOR = 10
"""A coarser level is chosen if it covers a tenth of the time range more."""
GAP_FACTOR = 3
"""A distance of this many times the usual one is a gap."""


def coarsest_sufficient(from_ms: int, to_ms: int, points: int) -> ResolutionLevel:
    """Return the coarsest level with enough points."""
    widest = (to_ms - from_ms) / points * MIN_POINTS_DIVISOR
    return max(
        level for level in ResolutionLevel if level is ResolutionLevel.RAW or RESOLUTIONS[level].width_ms <= widest
    )


ReadLevel = Callable[[ResolutionLevel], dict[str, Points]]
"""Reads the points of every signal at a level."""


def coarsest_covering(
    first: ResolutionLevel, from_ms: int, to_ms: int, read: ReadLevel
) -> tuple[ResolutionLevel, dict[str, Points]]:
    """Return the points of ``first``, or of a coarser level that reaches back farther."""
    chosen, points = first, read(first)
    for coarser in (level for level in ResolutionLevel if level > first):
        missing = _first_time(points, to_ms) - from_ms
        if missing * MISSING_SPAN_DIVISOR <= to_ms - from_ms:
            break
        other = read(coarser)
        # A bucket may begin before its first sample: within one bucket the finer level misses nothing.
        within = RESOLUTIONS[coarser].width_ms if any(map(len, points.values())) else 0
        if (_first_time(points, to_ms) - _first_time(other, to_ms) - within) * MISSING_SPAN_DIVISOR > to_ms - from_ms:
            chosen, points = coarser, other
    return chosen, points


def _first_time(by_tag: Mapping[str, Points], to_ms: int) -> int:
    return min((points.time[0] for points in by_tag.values() if len(points)), default=to_ms)


def downsample(points: Points, level: ResolutionLevel, from_ms: int, to_ms: int, max_points: int) -> Points:
    """Return at most ``max_points`` of sorted points, with a gap wherever nothing was recorded."""
    width = RESOLUTIONS[level].width_ms
    if level is not ResolutionLevel.RAW and len(points) <= 2 * max_points:
        points = roll_up(points, width)
    if len(points) <= max_points and len(shown := with_gaps(points, width)) <= max_points:
        return shown
    span = max(to_ms - from_ms, 1)
    # Buckets begin at multiples of their length, so that one more than span / length may be touched.
    bucket = -(-span // (max_points - 1) // width) * width
    return with_gaps(roll_up(points, bucket), bucket)


def with_gaps(points: Points, width_ms: int) -> Points:
    """Insert a gap after each point whose distance to the next is far longer than usual.

    It must be so overall and among its neighbours: a stretch that was polled more slowly stays joined.
    """
    time = points.time
    if len(time) < 3:
        return points
    steps = [after - before for before, after in pairwise(time)]
    usual = max(width_ms, median(steps))
    if max(steps) <= GAP_FACTOR * usual:
        return points
    nan = float("nan")
    columns: list[list[Any]] = [list(column) for column in points.columns()]
    long = [
        at
        for at, step in enumerate(steps)
        if step > GAP_FACTOR * usual and step > GAP_FACTOR * _smaller_neighbour(steps, at)
    ]
    for at in reversed(long):
        for column, cell in zip(columns, (time[at] + int(usual), 0, nan, nan, nan, BAD), strict=True):
            column.insert(at + 1, cell)
    return Points(
        time=columns[0], count=columns[1], low=columns[2], mean=columns[3], high=columns[4], quality=bytes(columns[5])
    )


def _smaller_neighbour(steps: list[int], at: int) -> int:
    """Return the smaller of the steps before and after."""
    return min(steps[max(0, at - 1) : at] + steps[at + 1 : at + 2])


def series_json(points: Points) -> Json:
    """Return the columns of the API; null stands for a gap."""
    counts = points.count
    if 0 not in counts:
        low, high = list(points.low), list(points.high)
        mean: list[float | None] = [round(value, MEAN_DIGITS) for value in points.mean]
        return {"t": list(points.time), "min": low, "mean": mean, "max": high, "q": list(points.quality)}

    def column(values: Any, digits: int | None = None) -> list[float | None]:
        shown = (value if digits is None else round(value, digits) for value in values)
        return [value if n else None for value, n in zip(shown, counts, strict=True)]

    return {
        "t": list(points.time),
        "min": column(points.low),
        "mean": column(points.mean, MEAN_DIGITS),
        "max": column(points.high),
        "q": list(points.quality),
    }
