"""From stored points to at most so many on a screen. Pure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import pairwise
from statistics import median
from typing import Any

from drivebus.service.historian.points import BAD, Points, roll_up
from drivebus.service.historian.resolution import RESOLUTIONS, ResolutionLevel

Json = dict[str, Any]

MEAN_DIGITS = 6
"""After the point, of a mean."""
MIN_POINTS_DIVISOR = 4
"""A quarter of the points asked for. With all of them, up to 60 times as many would be read, and not 15 times."""
MISSING_SPAN_DIVISOR = 10
"""A tenth of the span at its beginning is worth a coarser level."""
GAP_FACTOR = 3
"""So many times the usual distance without a point is a gap."""


def coarsest_sufficient(from_ms: int, to_ms: int, points: int) -> ResolutionLevel:
    """The coarsest level that still gives enough."""
    wanted = (to_ms - from_ms) / points * MIN_POINTS_DIVISOR
    return max(one for one in ResolutionLevel if one is ResolutionLevel.RAW or RESOLUTIONS[one].width_ms <= wanted)


ReadLevel = Callable[[ResolutionLevel], dict[str, Points]]
"""What a level has of each signal, thinned or not."""


def coarsest_covering(
    first: ResolutionLevel, from_ms: int, to_ms: int, read: ReadLevel
) -> tuple[ResolutionLevel, dict[str, Points]]:
    """What ``first`` has, or a coarser level that reaches back farther: fine history is forgotten earlier."""
    chosen, found = first, read(first)
    for coarser in (one for one in ResolutionLevel if one > first):
        missing = _first_time(found, to_ms) - from_ms
        if missing * MISSING_SPAN_DIVISOR <= to_ms - from_ms:
            break
        other = read(coarser)
        # A bucket may begin before its first sample: of what is finer there is nothing missing within its length.
        within = RESOLUTIONS[coarser].width_ms if any(map(len, found.values())) else 0
        if (_first_time(found, to_ms) - _first_time(other, to_ms) - within) * MISSING_SPAN_DIVISOR > to_ms - from_ms:
            chosen, found = coarser, other
    return chosen, found


def _first_time(found: Mapping[str, Points], to_ms: int) -> int:
    return min((points.time[0] for points in found.values() if len(points)), default=to_ms)


def downsample(points: Points, one: ResolutionLevel, from_ms: int, to_ms: int, most: int) -> Points:
    """At most ``most`` points, in order, with a gap wherever nothing was recorded; ``points`` are in order."""
    width = RESOLUTIONS[one].width_ms
    if one is not ResolutionLevel.RAW and len(points) <= 2 * most:
        points = roll_up(points, width)
    if len(points) <= most and len(shown := with_gaps(points, width)) <= most:
        return shown
    span = max(to_ms - from_ms, 1)
    # Buckets begin at multiples of their length, so that one more than span / length may be touched.
    bucket = -(-span // (most - 1) // width) * width
    return with_gaps(roll_up(points, bucket), bucket)


def with_gaps(points: Points, width_ms: int) -> Points:
    """A gap after each point that is followed by far too long a silence, for the whole and for what is beside it:
    where a signal was read more slowly for a while, its points stay joined.
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
    return Points(columns[0], columns[1], columns[2], columns[3], columns[4], bytes(columns[5]))


def _smaller_neighbour(steps: list[int], at: int) -> int:
    """The smaller of the steps before and after."""
    return min(steps[max(0, at - 1) : at] + steps[at + 1 : at + 2])


def series_json(points: Points) -> Json:
    """As the API gives it: null is a gap."""
    known = points.count
    if 0 not in known:
        low, high = list(points.low), list(points.high)
        mean: list[float | None] = [round(value, MEAN_DIGITS) for value in points.mean]
        return {"t": list(points.time), "min": low, "mean": mean, "max": high, "q": list(points.quality)}

    def column(values: Any, digits: int | None = None) -> list[float | None]:
        shown = (value if digits is None else round(value, digits) for value in values)
        return [value if n else None for value, n in zip(shown, known, strict=True)]

    return {
        "t": list(points.time),
        "min": column(points.low),
        "mean": column(points.mean, MEAN_DIGITS),
        "max": column(points.high),
        "q": list(points.quality),
    }
