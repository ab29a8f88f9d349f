"""Occurrences of alarms that are raised again before their acknowledgement."""

from __future__ import annotations

from drivebus.service.alarms.model import Alarm


class AlarmOccurrences:
    """Occurrences of each alarm by their ids: the newest one stands for those before it, with their count."""

    def __init__(self) -> None:
        self._first_ids: dict[str, str] = {}
        """Id of an occurrence → id of the first one of the same alarm."""
        self._newest_ids: dict[str, str] = {}
        """Id of a first occurrence → id of the newest one."""

    def add(self, alarm: Alarm) -> None:
        """Add an occurrence. Idempotent."""
        self._first_ids[alarm.id] = alarm.first_id
        newest = self._newest_ids.setdefault(alarm.first_id, alarm.id)
        if alarm_number(newest) < alarm_number(alarm.id):
            self._newest_ids[alarm.first_id] = alarm.id

    def newest_id(self, id: str) -> str:
        """Return the id of the newest occurrence of an alarm by the id of any; an unknown id as it is."""
        return self._newest_ids.get(self._first_ids.get(id, id), id)

    def remove(self, id: str) -> None:
        """Remove an occurrence. Idempotent."""
        first_id = self._first_ids.pop(id, id)
        if self._newest_ids.get(first_id) == id:
            del self._newest_ids[first_id]

    def remove_excess(self, limit: int) -> None:
        """Remove the occurrence that was added first where there are more than ``limit``."""
        if len(self._first_ids) > limit:
            self.remove(next(iter(self._first_ids)))


def alarm_number(id: str) -> int:
    """Return the number in an alarm's id; later alarms have larger numbers."""
    return int(id[1:])
