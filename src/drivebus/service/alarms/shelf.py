"""``AlarmShelf``: alarms that a user has put aside for a time (ISA-18.2). Pure: time is an argument."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

from drivebus.service.alarms.model import Alarm, AlarmKey

MAX_SHELVED_MS = 86_400_000
"""After a restart an alarm stays shelved for a day at most, even if the wall clock was set in between."""


@dataclass(frozen=True, slots=True)
class Shelving:
    """End of a shelving, the user who shelved, and the reason that the user gave."""

    until_ms: int | None = None
    by: str | None = None
    reason: str | None = None

    @property
    def alarm_fields(self) -> dict[str, Any]:
        return {"shelved_until_ms": self.until_ms, "shelved_by": self.by, "shelved_reason": self.reason}


NOT_SHELVED = Shelving()


class AlarmShelf:
    """Shelved alarm keys with the monotonic second of their end."""

    def __init__(self) -> None:
        self._until: dict[AlarmKey, tuple[float, Shelving]] = {}

    def shelve(self, key: AlarmKey, minutes: int, shelving: Shelving, now: float) -> None:
        """Shelve a key for ``minutes``."""
        self._until[key] = (now + minutes * 60.0, shelving)

    def restore(self, alarm: Alarm, now: float, now_ms: int) -> None:
        """Shelve an alarm of an earlier run for the rest of its time, as far as the wall clock shows."""
        if alarm.shelved_until_ms is not None:
            left_ms = min(max(0, alarm.shelved_until_ms - now_ms), MAX_SHELVED_MS)
            shelving = Shelving(alarm.shelved_until_ms, alarm.shelved_by, alarm.shelved_reason)
            self._until[alarm.key] = (now + left_ms / 1000, shelving)

    def shelving(self, key: AlarmKey) -> Shelving:
        shelved = self._until.get(key)
        return NOT_SHELVED if shelved is None else shelved[1]

    def expired(self, now: float) -> list[AlarmKey]:
        """Return the keys whose time has ended."""
        return [key for key, (until, _) in self._until.items() if now >= until]

    def of_drives(self, drives: Collection[str]) -> list[AlarmKey]:
        """Return the shelved keys of these drives."""
        return [key for key in self._until if key[2] in drives]

    def remove(self, key: AlarmKey) -> None:
        """Remove a key. Idempotent."""
        self._until.pop(key, None)
