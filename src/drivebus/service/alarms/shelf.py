"""What is put aside for a while. By the monotonic clock; the UTC label is for people (F21)."""

from __future__ import annotations

from drivebus.service.alarms.model import Alarm, AlarmKey

MAX_SHELVED_MS = 86_400_000
"""Nothing is put aside for longer than a day, whatever a clock was set to in between."""


class AlarmShelf:
    """An alarm's key → until when."""

    def __init__(self) -> None:
        self._until: dict[AlarmKey, tuple[float, int]] = {}

    def shelve(self, key: AlarmKey, minutes: int, now: float, now_ms: int) -> int:
        """The label of its end."""
        self._until[key] = (now + minutes * 60.0, now_ms + minutes * 60_000)
        return self._until[key][1]

    def restore(self, alarm: Alarm, now: float, now_ms: int) -> None:
        """It was put aside when the service ended: for what is left of that, as far as the label can tell."""
        if alarm.shelved_until_ms is not None:
            left_ms = min(max(0, alarm.shelved_until_ms - now_ms), MAX_SHELVED_MS)
            self._until[alarm.key] = (now + left_ms / 1000, alarm.shelved_until_ms)

    def until_ms(self, key: AlarmKey) -> int | None:
        found = self._until.get(key)
        return None if found is None else found[1]

    def expired(self, now: float) -> list[AlarmKey]:
        """Whose time is over."""
        return [key for key, (until, _) in self._until.items() if now >= until]

    def remove(self, key: AlarmKey) -> None:
        """It is no longer put aside. Idempotent."""
        self._until.pop(key, None)
