"""How long history stays: by age at each level, and by size. Pure but for the store that it is given.

Age is the time that the service has been running since a row was stored, and at most a day of each pause: no wall clock
that jumps, in whatever direction, makes a row older (G15).
"""

from __future__ import annotations

from drivebus.plant.historian.levels import DAY_MS, GRAINS, HOUR_MS, Level
from drivebus.plant.historian.store import Store
from drivebus.plant.model import HistorySetting

PAUSE_MS = DAY_MS
EVENTS = 1_000_000
"""So many of the newest stay: some 300 MB."""
ROWS = 200
"""Rows deleted in one transaction: some tens of milliseconds."""
KEPT_MS = 2 * HOUR_MS
"""What only the size forbids stays so long all the same: the chart of the last hour is never empty."""


def at_start(kept: tuple[int, int] | None, wall_ms: int) -> int:
    """The clock of age when the service begins; ``kept``: that clock and the wall clock when both were last written."""
    if kept is None:
        return 0
    clock_ms, then_ms = kept
    return clock_ms + min(max(0, wall_ms - then_ms), PAUSE_MS)


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
    store.forget_events(EVENTS)
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
