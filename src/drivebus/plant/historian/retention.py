"""How long history stays: by age at each level, and by size. Pure but for the store that it is given.

Age is counted from the moment of storing, by a clock that follows the wall clock back at once, but forward no faster
than twice the time that really passed (a day more at each start): a clock that jumps ten years ahead deletes nothing.
"""

from __future__ import annotations

from drivebus.plant.historian.levels import DAY_MS, GRAINS, HOUR_MS, Level
from drivebus.plant.historian.store import Store
from drivebus.plant.model import HistorySetting

AT_START_MS = DAY_MS
ROWS = 200
"""Rows deleted in one transaction: some tens of milliseconds."""
KEPT_MS = 2 * HOUR_MS
"""What only the size forbids stays so long all the same: the chart of the last hour is never empty."""


def clock(kept_ms: int | None, wall_ms: int, elapsed_ms: int) -> int:
    """The retention's clock after ``elapsed_ms`` of real time."""
    return wall_ms if kept_ms is None else min(wall_ms, kept_ms + 2 * elapsed_ms)


def at_start(kept_ms: int | None, wall_ms: int) -> int:
    """The same after the service was down for nobody knows how long."""
    return wall_ms if kept_ms is None else min(wall_ms, kept_ms + AT_START_MS)


def days(setting: HistorySetting, level: Level) -> float:
    return {
        Level.RAW: setting.raw_days,
        Level.SECOND: setting.second_days,
        Level.MINUTE: setting.minute_days,
        Level.HOUR: setting.hour_days,
    }[level]


def by_age(store: Store, setting: HistorySetting, now_ms: int) -> bool:
    """Delete some of what is too old; is there more? Raises StoreError."""
    oldest = {level: now_ms - round(days(setting, level) * DAY_MS) for level in Level}
    store.forget_events(oldest[Level.HOUR])
    return ROWS in [store.forget(level, before, ROWS) for level, before in oldest.items()]


def by_size(store: Store, setting: HistorySetting, now_ms: int) -> bool:
    """Delete some where there is too much, the finest level's oldest first; may there be more to delete?

    Raises StoreError.
    """
    if store.size_bytes() <= setting.largest_mb * 1e6:
        return False
    for level in GRAINS:
        oldest = store.oldest(level, ROWS) or store.oldest(level, 0)
        if oldest is not None and store.forget(level, min(oldest + 1, now_ms - KEPT_MS), ROWS):
            return True
    return False
