"""What is put aside for a while. By the monotonic clock; the UTC label is for people (F21).

A new alarm, and what it says in both languages with its numbers.

Every alarm of the plant: raised, acknowledged, shelved, cleared. Pure: time is an argument, the log is handed in.

``now`` is the monotonic second, by which delays and shelves run; ``now_ms`` the UTC label that people read (F21).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Protocol

from drivebus import i18n
from drivebus.errors import NotFound
from drivebus.profiles.diagnostics import bilingual_text
from drivebus.profiles.model import Text
from drivebus.service.alarms.condition import AlarmCondition, Observation
from drivebus.service.alarms.model import (
    SYSTEM_ALARM_KINDS,
    SYSTEM_ALARM_PRIORITIES,
    Alarm,
    AlarmChange,
    AlarmKey,
    SystemAlarm,
)
from drivebus.service.config.model import AlarmConfig, AlarmKind, AlarmPriority, DriveConfig
from drivebus.service.live.views import DriveView, Json

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


def formatted_number(value: Any) -> Any:
    """As short as it can be said: 50, not 50.000; a word stays a word."""
    return f"{round(value, 3):.12g}" if isinstance(value, float) else value


def signal_name(name: str) -> Text:
    """``output_frequency`` as people say it, where the catalogues know it."""
    key = f"signal.{name}"
    return bilingual_text(key) if i18n.known(key) else Text(name, name)


def alarm_title(setting: AlarmConfig, params: Mapping[str, Any]) -> Text:
    """The plant's own title, else what the kind is called."""
    if setting.title.en or setting.title.zh:
        return Text(setting.title.en or setting.title.zh, setting.title.zh or setting.title.en)
    return bilingual_text(f"alarms.title.{setting.kind}", **params)


def alarm_text(kind: AlarmKind, params: Mapping[str, Any]) -> Text:
    """What is the matter, with the numbers."""
    return bilingual_text(f"alarms.text.{kind}", **params)


def text_params(drive: Text, found: Mapping[str, Any], value: Any) -> dict[str, Any]:
    """The numbers of a sentence."""
    fault = found.get("fault") or {}
    signals = [signal_name(name) for name in found.get("signals", ())]
    return {
        "drive": drive,
        "value": formatted_number(value),
        "unit": found.get("unit", ""),
        "threshold": formatted_number(found.get("threshold")),
        "signal": signal_name(str(found.get("signal"))),
        "signals": Text(", ".join(one.en for one in signals), "、".join(one.zh for one in signals)),
        "fault": _fault_text(fault),
    }


def configured_alarm(id: str, setting: AlarmConfig, drive: str, name: Text, found: Observation, now_ms: int) -> Alarm:
    """An alarm that a value raises."""
    params = text_params(name, found.params or {}, found.value)
    title, text = alarm_title(setting, params), alarm_text(setting.kind, params)
    return Alarm(id, setting.id, drive, setting.priority, str(setting.kind), title, text, now_ms, found.value)


def system_alarm(
    id: str, kind: SystemAlarm, drive: str, name: Text, now_ms: int, about: str, params: Mapping[str, Any]
) -> Alarm:
    """An alarm that the service itself raises."""
    named = {"drive": name, "about": about, "reason": ""} | {
        key: formatted_number(value) for key, value in params.items()
    }
    title, text = bilingual_text(f"alarms.title.{kind}", **named), bilingual_text(f"alarms.text.{kind}", **named)
    return Alarm(id, str(kind), drive, SYSTEM_ALARM_PRIORITIES[kind], str(kind), title, text, now_ms, about=about)


def _fault_text(fault: Mapping[str, Any]) -> Text:
    """Its label and what it means; once where the meaning is no more than the label."""
    label, text = str(fault.get("label") or fault.get("code") or ""), fault.get("text") or {}
    said = [str(text.get(language) or "") for language in ("en", "zh")]
    return Text(*(one if label in one else f"{label} {one}".strip() for one in said))


DEFAULT_ALARMS = (
    AlarmConfig("fault", AlarmKind.FAULT, (), priority=AlarmPriority.CRITICAL),
    AlarmConfig("silent", AlarmKind.NO_RESPONSE, (), priority=AlarmPriority.HIGH),
)
"""For every drive that has no setting of that kind of its own."""
MAX_UNACKNOWLEDGED_PER_KEY = 20
"""So many cleared and unacknowledged alarms of one thing stay listed; more of one that flaps fill no memory (I12)."""
AUTOMATIC_ACKNOWLEDGER = "drivebus"
"""Acknowledges what is beyond ``UNSEEN``; the history keeps it."""


class AlarmSink(Protocol):
    """Where every change is kept."""

    def put(self, alarm: Alarm) -> None: ...


class AlarmEngine:
    """All alarms of the plant. ``known``: what the log still held as active when the service ended."""

    def __init__(
        self,
        settings: Sequence[AlarmConfig],
        drives: Sequence[DriveConfig],
        log: AlarmSink,
        known: Iterable[Alarm] = (),
        *,
        first_number: int = 1,
        now: float = 0.0,
        now_ms: int = 0,
    ) -> None:
        """``first`` is the number of the next new alarm; ``now`` and ``now_ms`` are the moment of this start."""
        self._log = log
        self._next_number = first_number
        self._alarms: dict[str, Alarm] = {}
        self._uncleared: dict[AlarmKey, str] = {}
        self._shelves = AlarmShelf()
        self._conditions: dict[str, list[AlarmCondition]] = {}
        self._titles: dict[str, Text] = {}
        for alarm in known:
            self._restore(alarm, now, now_ms)
        self.configure(settings, drives, now_ms)

    # --- what is watched -------------------------------------------------------------------------------------------

    def configure(
        self, settings: Sequence[AlarmConfig], drives: Sequence[DriveConfig], now_ms: int
    ) -> list[AlarmChange]:
        """Watch this from now on. A setting that did not change goes on as it was; what nobody watches is cleared."""
        old = {(watch.setting, watch.drive): watch for watches in self._conditions.values() for watch in watches}
        self._titles = {one.id: _drive_title(one) for one in drives}
        self._conditions = {
            id: [
                old.get((setting, id)) or self._resume(AlarmCondition(setting, id))
                for setting in _settings_of(settings, id)
            ]
            for id in self._titles
        }
        return self._clear_unconfigured(now_ms)

    def _resume(self, watch: AlarmCondition) -> AlarmCondition:
        """What was raised before goes on: it clears when a value says so, and is not raised twice."""
        id = self._uncleared.get(watch.key)
        if id is not None:
            watch.raised, watch.value = True, self._alarms[id].value
        return watch

    def _clear_unconfigured(self, now_ms: int) -> list[AlarmChange]:
        watched = {watch.key for watches in self._conditions.values() for watch in watches}
        gone = [
            key
            for key, id in self._uncleared.items()
            if key not in watched and self._alarms[id].kind not in SYSTEM_ALARM_KINDS
        ]
        return [change for key in gone for change in self._clear(key, now_ms)]

    def _restore(self, alarm: Alarm, now: float, now_ms: int) -> None:
        """An alarm of before. What the service itself raised is over with it; it raises again what still holds."""
        self._shelves.restore(alarm, now, now_ms)
        self._alarms[alarm.id] = alarm
        if alarm.cleared_ms is None:
            self._uncleared[alarm.key] = alarm.id
            if alarm.kind in SYSTEM_ALARM_KINDS:
                self._clear(alarm.key, now_ms)

    # --- what happens ----------------------------------------------------------------------------------------------

    def observe(self, view: DriveView, now: float, now_ms: int) -> list[AlarmChange]:
        """Look at a drive; at least four times a second, and whenever it changes."""
        changes: list[AlarmChange] = []
        for watch in self._conditions.get(view.id, ()):
            cleared, risen = watch.evaluate(view, now)
            if cleared:
                changes += self._clear(watch.key, now_ms)
            if risen is not None:
                name = self._titles[watch.drive]
                changes += self._raise(
                    configured_alarm(self._new_id(), watch.setting, watch.drive, name, risen, now_ms)
                )
        return changes

    def expire_shelves(self, now: float, now_ms: int) -> list[AlarmChange]:
        """End the shelves whose time is over; once a second is enough."""
        return [change for key in self._shelves.expired(now) for change in self._unshelve(key)]

    def raise_alarm(
        self, kind: SystemAlarm, drive: str, now_ms: int, *, about: str = "", **params: Any
    ) -> list[AlarmChange]:
        """Something that the service itself found; nothing where it is raised already. ``params``: of its sentence."""
        name = self._titles.get(drive, Text(drive, drive))
        alarm = system_alarm(self._new_id(), kind, drive, name, now_ms, about, params)
        return [] if alarm.key in self._uncleared else self._raise(alarm)

    def clear_alarm(self, kind: SystemAlarm, drive: str, now_ms: int, *, about: str = "") -> list[AlarmChange]:
        """It is over; nothing where it was not raised."""
        return self._clear((str(kind), str(kind), drive, about), now_ms)

    def _new_id(self) -> str:
        return f"a{self._next_number}"

    def _raise(self, alarm: Alarm) -> list[AlarmChange]:
        self._next_number += 1
        self._uncleared[alarm.key] = alarm.id
        forgotten = self._acknowledge_excess(alarm)
        return [*forgotten, self._update("raised", alarm, shelved_until_ms=self._shelves.until_ms(alarm.key))]

    def _acknowledge_excess(self, alarm: Alarm) -> list[AlarmChange]:
        """Only the newest ``UNSEEN`` of one thing wait for somebody."""
        unseen = [one for one in self._alarms.values() if one.key == alarm.key and one.cleared_ms is not None]
        return [
            self._acknowledge(one, AUTOMATIC_ACKNOWLEDGER, alarm.raised_ms)
            for one in unseen[: max(0, len(unseen) - MAX_UNACKNOWLEDGED_PER_KEY + 1)]
        ]

    def _clear(self, key: AlarmKey, now_ms: int) -> list[AlarmChange]:
        id = self._uncleared.pop(key, None)
        return [] if id is None else [self._update("cleared", self._alarms[id], cleared_ms=now_ms)]

    # --- what people do --------------------------------------------------------------------------------------------

    def acknowledge(self, id: str, by: str, now_ms: int) -> list[AlarmChange]:
        """Somebody has seen it. Nothing where somebody had before. Raises NotFound."""
        alarm = self._get(id)
        return [] if alarm.acknowledged_ms is not None else [self._acknowledge(alarm, by, now_ms)]

    def shelve(self, id: str, minutes: int, now: float, now_ms: int) -> list[AlarmChange]:
        """Neither it nor its like is shown as new for so long; what it watches goes on. Raises NotFound."""
        alarm = self._get(id)
        until_ms = self._shelves.shelve(alarm.key, minutes, now, now_ms)
        return [self._update("shelved", one, shelved_until_ms=until_ms) for one in self._with_key(alarm.key)]

    def unshelve(self, id: str) -> list[AlarmChange]:
        """Raises NotFound."""
        return self._unshelve(self._get(id).key)

    def attach_incident(self, id: str, case: str) -> list[AlarmChange]:
        """What was known when it was raised has been kept as this case. Raises NotFound."""
        return [self._update("case", self._get(id), case=case)]

    def _unshelve(self, key: AlarmKey) -> list[AlarmChange]:
        self._shelves.remove(key)
        shelved = [one for one in self._with_key(key) if one.shelved_until_ms is not None]
        return [self._update("unshelved", one, shelved_until_ms=None) for one in shelved]

    def _acknowledge(self, alarm: Alarm, by: str, now_ms: int) -> AlarmChange:
        return self._update("acknowledged", alarm, acknowledged_ms=now_ms, by=by)

    def _get(self, id: str) -> Alarm:
        if id not in self._alarms:
            raise NotFound("alarms.unknown", alarm=id)
        return self._alarms[id]

    def _with_key(self, key: AlarmKey) -> list[Alarm]:
        return [one for one in self._alarms.values() if one.key == key]

    def _update(self, word: str, alarm: Alarm, **changed: Any) -> AlarmChange:
        """The one place where an alarm changes: kept in the log, and forgotten here once it is over and seen."""
        alarm = replace(alarm, **changed)
        if alarm.active:
            self._alarms[alarm.id] = alarm
        else:
            self._alarms.pop(alarm.id, None)
        self._log.put(alarm)
        return AlarmChange(word, alarm)

    # --- what can be seen ------------------------------------------------------------------------------------------

    def active(self) -> list[Alarm]:
        """Raised, and not cleared or not acknowledged: the most urgent and newest first."""
        order = [*AlarmPriority]
        return sorted(self._alarms.values(), key=lambda one: (order.index(one.priority), -one.raised_ms, one.id))

    def counts(self, drive: str) -> dict[str, int]:
        """Active alarms of a drive by priority; shelved ones do not count."""
        mine = [one for one in self._alarms.values() if one.drive == drive and one.shelved_until_ms is None]
        return {str(p): n for p in AlarmPriority if (n := sum(one.priority is p for one in mine))}

    def as_json(self) -> Json:
        """The live topic ``alarms``."""
        return {"active": [alarm.as_json() for alarm in self.active()]}


def _settings_of(settings: Sequence[AlarmConfig], drive: str) -> list[AlarmConfig]:
    mine = [setting for setting in settings if not setting.drives or drive in setting.drives]
    kinds = {setting.kind for setting in mine}
    return [*mine, *(setting for setting in DEFAULT_ALARMS if setting.kind not in kinds)]


def _drive_title(drive: DriveConfig) -> Text:
    return Text(drive.title.en or drive.id, drive.title.zh or drive.title.en or drive.id)
