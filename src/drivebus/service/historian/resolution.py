"""How finely history is kept: the samples themselves and three rollups. Values only."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

SECOND_MS = 1000
MINUTE_MS = 60 * SECOND_MS
HOUR_MS = 60 * MINUTE_MS
DAY_MS = 24 * HOUR_MS


class ResolutionLevel(IntEnum):
    """One resolution. The number stands in the store's rows: never change one."""

    RAW = 0
    SECOND = 1
    MINUTE = 2
    HOUR = 3


@dataclass(frozen=True, slots=True)
class Resolution:
    """What a level's rows hold."""

    name: str
    """As the API says it."""
    width_ms: int
    """One point stands for so long."""
    partition_ms: int
    """One row holds points of one stretch of this length, counted from 1970, and of no other."""
    merged: bool
    """A late sample changes the row that is there; else it makes one more row of the same stretch."""


RESOLUTIONS: dict[ResolutionLevel, Resolution] = {
    ResolutionLevel.RAW: Resolution("raw", 1, HOUR_MS, merged=False),
    ResolutionLevel.SECOND: Resolution("1s", SECOND_MS, HOUR_MS, merged=False),
    ResolutionLevel.MINUTE: Resolution("1min", MINUTE_MS, DAY_MS, merged=True),
    ResolutionLevel.HOUR: Resolution("1h", HOUR_MS, 40 * DAY_MS, merged=True),
}

LEVEL_BY_NAME: dict[str, ResolutionLevel] = {grain.name: level for level, grain in RESOLUTIONS.items()}
