"""Every alarm of the plant: raised, acknowledged, shelved, cleared. Pure: time is an argument, the log is handed in.

``now`` is the monotonic second, by which delays and shelves run; ``now_ms`` the UTC label that people read (F21).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, Protocol

from drivebus.errors import NotFound
from drivebus.plant.alarms import texts
from drivebus.plant.alarms.alarm import OWN, Alarm, Change, Key, Own
from drivebus.plant.alarms.shelves import Shelves
from drivebus.plant.alarms.watch import Watch
from drivebus.plant.model import AlarmKind, AlarmSetting, DriveSetting, Priority
from drivebus.plant.view import DriveView, Json
from drivebus.profiles.model import Text

IMPLICIT = (
    AlarmSetting("fault", AlarmKind.FAULT, (), priority=Priority.URGENT),
    AlarmSetting("silent", AlarmKind.SILENT, (), priority=Priority.HIGH),
)
"""For every drive that has no setting of that kind of its own."""
UNSEEN = 20
"""So many cleared and unacknowledged alarms of one thing stay listed; more of one that flaps fill no memory (I12)."""
NOBODY = "drivebus"
"""Acknowledges what is beyond ``UNSEEN``; the history keeps it."""


class Log(Protocol):
    """Where every change is kept."""

    def put(self, alarm: Alarm) -> None: ...


class AlarmBook:
    """All alarms of the plant. ``known``: what the log still held as active when the service ended."""

    def __init__(
        self,
        settings: Sequence[AlarmSetting],
        drives: Sequence[DriveSetting],
        log: Log,
        known: Iterable[Alarm] = (),
        *,
        first: int = 1,
        now: float = 0.0,
        now_ms: int = 0,
    ) -> None:
        """``first`` is the number of the next new alarm; ``now`` and ``now_ms`` are the moment of this start."""
        self._log = log
        self._next = first
        self._alarms: dict[str, Alarm] = {}
        self._uncleared: dict[Key, str] = {}
        self._shelves = Shelves()
        self._watches: dict[str, list[Watch]] = {}
        self._titles: dict[str, Text] = {}
        for alarm in known:
            self._know(alarm, now, now_ms)
        self.apply(settings, drives, now_ms)

    # --- what is watched -------------------------------------------------------------------------------------------

    def apply(self, settings: Sequence[AlarmSetting], drives: Sequence[DriveSetting], now_ms: int) -> list[Change]:
        """Watch this from now on. A setting that did not change goes on as it was; what nobody watches is cleared."""
        old = {(watch.setting, watch.drive): watch for watches in self._watches.values() for watch in watches}
        self._titles = {one.id: _title(one) for one in drives}
        self._watches = {
            id: [old.get((setting, id)) or self._watch(Watch(setting, id)) for setting in _of_drive(settings, id)]
            for id in self._titles
        }
        return self._abandoned(now_ms)

    def _watch(self, watch: Watch) -> Watch:
        """What was raised before goes on: it clears when a value says so, and is not raised twice."""
        id = self._uncleared.get(watch.key)
        if id is not None:
            watch.raised, watch.value = True, self._alarms[id].value
        return watch

    def _abandoned(self, now_ms: int) -> list[Change]:
        watched = {watch.key for watches in self._watches.values() for watch in watches}
        gone = [key for key, id in self._uncleared.items() if key not in watched and self._alarms[id].kind not in OWN]
        return [change for key in gone for change in self._clear(key, now_ms)]

    def _know(self, alarm: Alarm, now: float, now_ms: int) -> None:
        """An alarm of before. What the service itself raised is over with it; it raises again what still holds."""
        self._shelves.again(alarm, now, now_ms)
        self._alarms[alarm.id] = alarm
        if alarm.cleared_ms is None:
            self._uncleared[alarm.key] = alarm.id
            if alarm.kind in OWN:
                self._clear(alarm.key, now_ms)

    # --- what happens ----------------------------------------------------------------------------------------------

    def observe(self, view: DriveView, now: float, now_ms: int) -> list[Change]:
        """Look at a drive; at least four times a second, and whenever it changes."""
        changes: list[Change] = []
        for watch in self._watches.get(view.id, ()):
            cleared, risen = watch.look(view, now)
            if cleared:
                changes += self._clear(watch.key, now_ms)
            if risen is not None:
                name = self._titles[watch.drive]
                changes += self._raise(texts.of_setting(self._id(), watch.setting, watch.drive, name, risen, now_ms))
        return changes

    def tick(self, now: float, now_ms: int) -> list[Change]:
        """End the shelves whose time is over; once a second is enough."""
        return [change for key in self._shelves.over(now) for change in self._take_off(key)]

    def raise_alarm(self, kind: Own, drive: str, now_ms: int, *, about: str = "", **params: Any) -> list[Change]:
        """Something that the service itself found; nothing where it is raised already. ``params``: of its sentence."""
        name = self._titles.get(drive, Text(drive, drive))
        alarm = texts.of_service(self._id(), kind, drive, name, now_ms, about, params)
        return [] if alarm.key in self._uncleared else self._raise(alarm)

    def clear_alarm(self, kind: Own, drive: str, now_ms: int, *, about: str = "") -> list[Change]:
        """It is over; nothing where it was not raised."""
        return self._clear((str(kind), str(kind), drive, about), now_ms)

    def _id(self) -> str:
        return f"a{self._next}"

    def _raise(self, alarm: Alarm) -> list[Change]:
        self._next += 1
        self._uncleared[alarm.key] = alarm.id
        forgotten = self._forget(alarm)
        return [*forgotten, self._note("raised", alarm, shelved_until_ms=self._shelves.until_ms(alarm.key))]

    def _forget(self, alarm: Alarm) -> list[Change]:
        """Only the newest ``UNSEEN`` of one thing wait for somebody."""
        unseen = [one for one in self._alarms.values() if one.key == alarm.key and one.cleared_ms is not None]
        return [self._seen(one, NOBODY, alarm.raised_ms) for one in unseen[: max(0, len(unseen) - UNSEEN + 1)]]

    def _clear(self, key: Key, now_ms: int) -> list[Change]:
        id = self._uncleared.pop(key, None)
        return [] if id is None else [self._note("cleared", self._alarms[id], cleared_ms=now_ms)]

    # --- what people do --------------------------------------------------------------------------------------------

    def acknowledge(self, id: str, by: str, now_ms: int) -> list[Change]:
        """Somebody has seen it. Nothing where somebody had before. Raises NotFound."""
        alarm = self._get(id)
        return [] if alarm.acknowledged_ms is not None else [self._seen(alarm, by, now_ms)]

    def shelve(self, id: str, minutes: int, now: float, now_ms: int) -> list[Change]:
        """Neither it nor its like is shown as new for so long; what it watches goes on. Raises NotFound."""
        alarm = self._get(id)
        until_ms = self._shelves.put(alarm.key, minutes, now, now_ms)
        return [self._note("shelved", one, shelved_until_ms=until_ms) for one in self._like(alarm.key)]

    def unshelve(self, id: str) -> list[Change]:
        """Raises NotFound."""
        return self._take_off(self._get(id).key)

    def attach(self, id: str, case: str) -> list[Change]:
        """What was known when it was raised has been kept as this case. Raises NotFound."""
        return [self._note("case", self._get(id), case=case)]

    def _take_off(self, key: Key) -> list[Change]:
        self._shelves.take(key)
        shelved = [one for one in self._like(key) if one.shelved_until_ms is not None]
        return [self._note("unshelved", one, shelved_until_ms=None) for one in shelved]

    def _seen(self, alarm: Alarm, by: str, now_ms: int) -> Change:
        return self._note("acknowledged", alarm, acknowledged_ms=now_ms, by=by)

    def _get(self, id: str) -> Alarm:
        if id not in self._alarms:
            raise NotFound("alarms.unknown", alarm=id)
        return self._alarms[id]

    def _like(self, key: Key) -> list[Alarm]:
        return [one for one in self._alarms.values() if one.key == key]

    def _note(self, word: str, alarm: Alarm, **changed: Any) -> Change:
        """The one place where an alarm changes: kept in the log, and forgotten here once it is over and seen."""
        alarm = replace(alarm, **changed)
        if alarm.active:
            self._alarms[alarm.id] = alarm
        else:
            self._alarms.pop(alarm.id, None)
        self._log.put(alarm)
        return Change(word, alarm)

    # --- what can be seen ------------------------------------------------------------------------------------------

    def active(self) -> list[Alarm]:
        """Raised, and not cleared or not acknowledged: the most urgent and newest first."""
        order = [*Priority]
        return sorted(self._alarms.values(), key=lambda one: (order.index(one.priority), -one.raised_ms, one.id))

    def counts(self, drive: str) -> dict[str, int]:
        """Active alarms of a drive by priority; shelved ones do not count."""
        mine = [one for one in self._alarms.values() if one.drive == drive and one.shelved_until_ms is None]
        return {str(p): n for p in Priority if (n := sum(one.priority is p for one in mine))}

    def topic(self) -> Json:
        """The live topic ``alarms``."""
        return {"active": [alarm.as_json() for alarm in self.active()]}


def _of_drive(settings: Sequence[AlarmSetting], drive: str) -> list[AlarmSetting]:
    mine = [setting for setting in settings if not setting.drives or drive in setting.drives]
    kinds = {setting.kind for setting in mine}
    return [*mine, *(setting for setting in IMPLICIT if setting.kind not in kinds)]


def _title(drive: DriveSetting) -> Text:
    return Text(drive.title.en or drive.id, drive.title.zh or drive.title.en or drive.id)
