"""Alarm engine of a plant: raises, acknowledges, shelves and clears alarms (ISA-18.2). Pure: time is an argument.

An alarm that is raised again before a user has acknowledged it takes the place of the earlier occurrence, with a count:
the list has one entry, which is unacknowledged and active again. The log has each occurrence by its own id.

``now`` is in monotonic seconds and drives delays and shelving; ``now_ms`` is UTC and only shown, because the wall clock
may be set at any time.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import replace
from typing import Any

from drivebus.errors import NotFound
from drivebus.service.alarms.condition import AlarmCondition
from drivebus.service.alarms.model import (
    SYSTEM_ALARM_KINDS,
    Alarm,
    AlarmChange,
    AlarmKey,
    SystemAlarm,
)
from drivebus.service.alarms.occurrences import AlarmOccurrences
from drivebus.service.alarms.shelf import NOT_SHELVED, AlarmShelf, Shelving
from drivebus.service.alarms.texts import configured_alarm, system_alarm
from drivebus.service.auth.actor import SERVICE_NAME
from drivebus.service.config.model import AlarmConfig, AlarmKind, AlarmPriority, DriveConfig, title_of
from drivebus.service.live.views import DriveView
from drivebus.types import Json
from drivebus.values import Text

DEFAULT_ALARMS = (
    AlarmConfig(id="fault", kind=AlarmKind.FAULT, drives=(), priority=AlarmPriority.CRITICAL),
    AlarmConfig(id="no_response", kind=AlarmKind.NO_RESPONSE, drives=(), priority=AlarmPriority.HIGH),
)
"""Alarms of every drive for which the plant file configures none of that kind."""
MAX_UNACKNOWLEDGED_PER_KEY = 20
"""Cleared, unacknowledged alarms listed for one key: a drive may report another fault code each time.

The service acknowledges those beyond it; the alarm log keeps them."""
MAX_OCCURRENCE_IDS = 5_000
"""Ids of occurrences that find their alarm: a user may act on what a page showed a moment ago."""


class AlarmEngine:
    """All alarms of a plant. ``alarms``: those that were active when the service last ended."""

    def __init__(
        self,
        settings: Sequence[AlarmConfig],
        drives: Sequence[DriveConfig],
        record: Callable[[Alarm], None],
        alarms: Iterable[Alarm] = (),
        *,
        first_number: int = 1,
        now: float = 0.0,
        now_ms: int = 0,
    ) -> None:
        """Start at ``now`` and ``now_ms``. ``record`` gets every changed alarm, ``first_number`` the next new one."""
        self._record = record
        self._next_number = first_number
        self._alarms: dict[str, Alarm] = {}
        self._uncleared: dict[AlarmKey, str] = {}
        self._occurrences = AlarmOccurrences()
        self._shelf = AlarmShelf()
        self._conditions: dict[str, list[AlarmCondition]] = {}
        self._titles: dict[str, Text] = {}
        for alarm in alarms:
            self._restore(alarm, now, now_ms)
        self.configure(settings, drives, now_ms)

    # --- configuration ---------------------------------------------------------------------------------------------

    def configure(
        self,
        settings: Sequence[AlarmConfig],
        drives: Sequence[DriveConfig],
        now_ms: int,
        *,
        replaced_drives: Collection[str] = (),
    ) -> list[AlarmChange]:
        """Apply a configuration. Unchanged conditions keep their state; alarms without a condition are cleared.

        So are those of a replaced drive, and they are unshelved: another motor raises its own, also of the same fault.
        """
        cleared = [change for key in self._shelf.of_drives(replaced_drives) for change in self._unshelve(key)]
        cleared += self._clear_where(lambda alarm: alarm.drive in replaced_drives, now_ms)
        for alarm in [other for other in self._alarms.values() if other.drive in replaced_drives]:
            self._update("replaced", alarm, drive_replaced=True)  # in the log, so that it outlives a restart
        for drive in replaced_drives:
            self._conditions.pop(drive, None)
        old = {
            (condition.setting, condition.drive): condition
            for conditions in self._conditions.values()
            for condition in conditions
        }
        self._titles = {each.id: title_of(each) for each in drives}
        self._conditions = {
            id: [
                old.get((setting, id)) or self._resume(AlarmCondition(setting, id))
                for setting in _settings_of(settings, id)
            ]
            for id in self._titles
        }
        configured = {condition.key for conditions in self._conditions.values() for condition in conditions}
        return cleared + self._clear_where(
            lambda alarm: alarm.kind not in SYSTEM_ALARM_KINDS and alarm.key not in configured, now_ms
        )

    def _resume(self, condition: AlarmCondition) -> AlarmCondition:
        """Mark a condition as raised if its alarm is uncleared, so that it is not raised twice."""
        id = self._uncleared.get(condition.key)
        if id is not None:
            condition.raised, condition.value = True, self._alarms[id].value
        return condition

    def _clear_where(self, matches: Callable[[Alarm], bool], now_ms: int) -> list[AlarmChange]:
        keys = [key for key, id in self._uncleared.items() if matches(self._alarms[id])]
        return [change for key in keys for change in self._clear(key, now_ms)]

    def _restore(self, alarm: Alarm, now: float, now_ms: int) -> None:
        """Restore an alarm of an earlier run. System alarms are cleared: the service raises again what still holds.

        So is an older one of the same key, whose end is missing in a damaged log: nothing else would ever clear it.
        """
        self._shelf.restore(alarm, now, now_ms)
        if alarm.cleared_ms is None:
            self._clear(alarm.key, now_ms)
        earlier = self.find(alarm.first_id)
        if earlier is not None and earlier.cleared_ms is not None:
            alarm = self._repeat(earlier, alarm)
        self._occurrences.add(alarm)
        self._alarms[alarm.id] = alarm
        if alarm.cleared_ms is None:
            self._uncleared[alarm.key] = alarm.id
            if alarm.kind in SYSTEM_ALARM_KINDS:
                self._clear(alarm.key, now_ms)

    # --- events ----------------------------------------------------------------------------------------------------

    def observe(self, view: DriveView, now: float, now_ms: int) -> list[AlarmChange]:
        """Evaluate the conditions of a drive; call it at least four times a second and on every change.

        The alarm of a lost port suppresses ``no_response`` of the drives of its bus, unless it is shelved.
        """
        changes: list[AlarmChange] = []
        port_alarm = self._uncleared.get((SystemAlarm.PORT_LOST, SystemAlarm.PORT_LOST, "", view.bus))
        suppressed = port_alarm is not None and self._alarms[port_alarm].shelved_until_ms is None
        for condition in self._conditions.get(view.id, ()):
            if suppressed and condition.setting.kind is AlarmKind.NO_RESPONSE:
                condition.suppress()
                continue
            changes += self._name_fault(condition, view)
            cleared, raised = condition.evaluate(view, now)
            if cleared:
                changes += self._clear(condition.key, now_ms)
            if raised is not None:
                drive = condition.drive
                alarm = configured_alarm(
                    self._new_id(),
                    condition.setting,
                    drive=drive,
                    name=self._titles[drive],
                    observation=raised,
                    now_ms=now_ms,
                )
                changes += self._raise(alarm)
        return changes

    def _name_fault(self, condition: AlarmCondition, view: DriveView) -> list[AlarmChange]:
        """Name the fault in its alarm once its code is read, which takes seconds on a full bus: it is still one trip.

        An acknowledged alarm is not changed: its successor has the name, and is to be acknowledged.
        """
        named = condition.named_fault(view)
        id = self._uncleared.get(condition.key)
        if named is None or id is None or self._alarms[id].acknowledged_ms is not None:
            return []
        condition.value = named.value
        alarm = configured_alarm(
            id, condition.setting, drive=view.id, name=self._titles[view.id], observation=named, now_ms=0
        )
        texts = {"title": alarm.title, "text": alarm.text, "remedy": alarm.remedy}
        return [self._update("named", self._alarms[id], value=named.value, **texts)]

    def expire_shelves(self, now: float) -> list[AlarmChange]:
        """Unshelve alarms whose time has ended; call it about once a second."""
        return [change for key in self._shelf.expired(now) for change in self._unshelve(key)]

    def raise_alarm(
        self,
        kind: SystemAlarm,
        drive: str,
        now_ms: int,
        *,
        subject: str = "",
        sentence: str | None = None,
        **params: Any,
    ) -> list[AlarmChange]:
        """Raise a system alarm unless it is raised already.

        ``sentence`` as in ``system_alarm``; ``params`` are the parameters of that sentence.
        """
        name = self._titles.get(drive, Text(drive, drive))
        alarm = system_alarm(
            self._new_id(),
            kind,
            drive=drive,
            name=name,
            now_ms=now_ms,
            subject=subject,
            params=params,
            sentence=sentence,
        )
        return [] if alarm.key in self._uncleared else self._raise(alarm)

    def clear_alarm(self, kind: SystemAlarm, drive: str, now_ms: int, *, subject: str = "") -> list[AlarmChange]:
        """Clear a system alarm, if it is raised."""
        return self._clear((str(kind), str(kind), drive, subject), now_ms)

    def _new_id(self) -> str:
        return f"a{self._next_number}"

    def _raise(self, alarm: Alarm) -> list[AlarmChange]:
        self._next_number += 1
        repeated = [earlier for earlier in self._with_key(alarm.key) if earlier.is_repeated_by(alarm)]
        if repeated:
            alarm = self._repeat(repeated[-1], alarm)
        self._occurrences.add(alarm)
        self._occurrences.remove_excess(MAX_OCCURRENCE_IDS)
        self._uncleared[alarm.key] = alarm.id
        forgotten = self._acknowledge_excess(alarm)
        return [*forgotten, self._update("raised", alarm, **self._shelf.shelving(alarm.key).alarm_fields)]

    def _repeat(self, earlier: Alarm, alarm: Alarm) -> Alarm:
        """Let an occurrence take the place of a cleared one; return it with their count."""
        del self._alarms[earlier.id]
        return alarm.repeating(earlier)

    def _acknowledge_excess(self, alarm: Alarm) -> list[AlarmChange]:
        """Acknowledge the oldest cleared alarms of this key beyond ``MAX_UNACKNOWLEDGED_PER_KEY``."""
        waiting = [other for other in self._with_key(alarm.key) if other.cleared_ms is not None]
        excess = waiting[: max(0, len(waiting) - MAX_UNACKNOWLEDGED_PER_KEY + 1)]
        return [self._acknowledge(other, SERVICE_NAME, alarm.raised_ms) for other in excess]

    def _clear(self, key: AlarmKey, now_ms: int) -> list[AlarmChange]:
        id = self._uncleared.pop(key, None)
        return [] if id is None else [self._update("cleared", self._alarms[id], cleared_ms=now_ms)]

    # --- operator actions ------------------------------------------------------------------------------------------

    def acknowledge(self, id: str, by: str, now_ms: int) -> list[AlarmChange]:
        """Acknowledge an alarm with its earlier occurrences, if it is not acknowledged yet. Raises NotFound."""
        alarm = self._get(id)
        return [] if alarm.acknowledged_ms is not None else [self._acknowledge(alarm, by, now_ms)]

    def shelve(self, id: str, minutes: int, now: float, now_ms: int, *, by: str, reason: str) -> list[AlarmChange]:
        """Shelve every alarm of the same key for ``minutes``; its condition stays active. Raises NotFound."""
        alarm = self._get(id)
        shelving = Shelving(now_ms + minutes * 60_000, by, reason)
        self._shelf.shelve(alarm.key, minutes, shelving, now)
        return [self._update("shelved", each, **shelving.alarm_fields) for each in self._with_key(alarm.key)]

    def unshelve(self, id: str) -> list[AlarmChange]:
        """Unshelve every alarm of the same key. Raises NotFound."""
        return self._unshelve(self._get(id).key)

    def attach_incident(self, id: str, incident: str) -> list[AlarmChange]:
        """Link the incident that was recorded when this occurrence was raised, if it is still in the list."""
        alarm = self._alarms.get(id)
        return [] if alarm is None else [self._update("incident", alarm, incident=incident)]

    def _unshelve(self, key: AlarmKey) -> list[AlarmChange]:
        self._shelf.remove(key)
        shelved = [alarm for alarm in self._with_key(key) if alarm.shelved_until_ms is not None]
        return [self._update("unshelved", alarm, **NOT_SHELVED.alarm_fields) for alarm in shelved]

    def _acknowledge(self, alarm: Alarm, by: str, now_ms: int) -> AlarmChange:
        return self._update("acknowledged", alarm, acknowledged_ms=now_ms, acknowledged_by=by)

    def find(self, id: str) -> Alarm | None:
        """Return an active alarm by the id of its newest occurrence, or of an earlier one; None if there is none."""
        return self._alarms.get(self._occurrences.newest_id(id))

    def _get(self, id: str) -> Alarm:
        alarm = self.find(id)
        if alarm is None:
            raise NotFound("alarms.unknown", alarm=id)
        return alarm

    def _with_key(self, key: AlarmKey) -> list[Alarm]:
        return [alarm for alarm in self._alarms.values() if alarm.key == key]

    def _update(self, word: str, alarm: Alarm, **changed: Any) -> AlarmChange:
        """Change an alarm and log it; drop it from the active list once it is cleared and acknowledged."""
        alarm = replace(alarm, **changed)
        if alarm.active:
            self._alarms[alarm.id] = alarm
        else:
            self._alarms.pop(alarm.id, None)
        self._record(alarm)
        return AlarmChange(word, alarm)

    # --- state -----------------------------------------------------------------------------------------------------

    def active(self) -> list[Alarm]:
        """Return the alarms that are uncleared or unacknowledged, by priority, newest first."""
        order = [*AlarmPriority]
        return sorted(
            self._alarms.values(), key=lambda alarm: (order.index(alarm.priority), -alarm.raised_ms, alarm.id)
        )

    def counts(self, drive: str) -> dict[str, int]:
        """Return the number of a drive's uncleared, unshelved alarms by priority."""
        of_drive = (alarm for alarm in self._alarms.values() if alarm.drive == drive and alarm.shelved_until_ms is None)
        active = [alarm for alarm in of_drive if alarm.cleared_ms is None]
        return {str(p): n for p in AlarmPriority if (n := sum(alarm.priority is p for alarm in active))}

    def as_json(self) -> Json:
        """Return the live topic ``alarms``."""
        return {"active": [alarm.as_json() for alarm in self.active()]}


def _settings_of(settings: Sequence[AlarmConfig], drive: str) -> list[AlarmConfig]:
    configured = [setting for setting in settings if not setting.drives or drive in setting.drives]
    kinds = {setting.kind for setting in configured}
    return [*configured, *(setting for setting in DEFAULT_ALARMS if setting.kind not in kinds)]
