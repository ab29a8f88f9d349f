"""How long history stays: by age at each level, and by size. Pure but for the store that it is given.

Age is the time that the service has been running since a row was stored, and at most a day of each pause: no wall clock
that jumps, in whatever direction, makes a row older (G15).
"""

from __future__ import annotations

from drivebus.service.config.model import HistoryConfig
from drivebus.service.historian.resolution import DAY_MS, HOUR_MS, RESOLUTIONS, ResolutionLevel
from drivebus.service.historian.store import HistoryStore

MAX_COUNTED_PAUSE_MS = DAY_MS
MAX_EVENTS = 1_000_000
"""So many of the newest stay: some 300 MB."""
DELETE_BATCH_ROWS = 200
"""Rows deleted in one transaction: some tens of milliseconds."""
MIN_RETENTION_MS = 2 * HOUR_MS
"""What only the size forbids stays so long all the same: the chart of the last hour is never empty."""


def clock_at_start(kept: tuple[int, int] | None, wall_ms: int) -> int:
    """The clock of age when the service begins; ``kept``: that clock and the wall clock when both were last written."""
    if kept is None:
        return 0
    clock_ms, then_ms = kept
    return clock_ms + min(max(0, wall_ms - then_ms), MAX_COUNTED_PAUSE_MS)


def retention_days(setting: HistoryConfig, level: ResolutionLevel) -> float:
    return {
        ResolutionLevel.RAW: setting.raw_days,
        ResolutionLevel.SECOND: setting.second_days,
        ResolutionLevel.MINUTE: setting.minute_days,
        ResolutionLevel.HOUR: setting.hour_days,
    }[level]


def delete_expired(store: HistoryStore, setting: HistoryConfig, now_ms: int) -> bool:
    """Delete some of what is too old; is there more? Raises StoreError."""
    oldest = {level: now_ms - round(retention_days(setting, level) * DAY_MS) for level in ResolutionLevel}
    store.delete_events(MAX_EVENTS)
    return DELETE_BATCH_ROWS in [
        store.delete_blocks(level, before, DELETE_BATCH_ROWS) for level, before in oldest.items()
    ]


def delete_oversize(store: HistoryStore, setting: HistoryConfig, now_ms: int) -> bool:
    """Delete some where there is too much, the finest level's oldest first; may there be more to delete?

    Raises StoreError.
    """
    if store.size_bytes() <= setting.largest_mb * 1e6:
        return False
    for level in RESOLUTIONS:
        oldest = store.oldest_stored_ms(level, DELETE_BATCH_ROWS) or store.oldest_stored_ms(level, 0)
        if oldest is not None and store.delete_blocks(
            level, min(oldest + 1, now_ms - MIN_RETENTION_MS), DELETE_BATCH_ROWS
        ):
            return True
    return False
