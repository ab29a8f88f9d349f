"""Is it beyond, and for how long? One setting watching one drive. Pure: time is an argument."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum, auto
from typing import Any

from drivebus.plant.alarms.alarm import Key
from drivebus.plant.model import AlarmKind, AlarmSetting
from drivebus.plant.view import DriveView, SignalView
from drivebus.reading import Quality

NEVER_SEEN_S = 10.0
"""A drive that has not answered yet gets this long after the service began, before it counts as silent."""
TICK_S = 1e-9
"""Sums of floating seconds miss the exact end of a delay by less than this."""


class Place(Enum):
    """Where the value is."""

    BEYOND = auto()
    WITHIN = auto()
    """Inside the hysteresis: neither raises nor clears, and ends a delay that was running."""
    BACK = auto()
    UNKNOWN = auto()
    """Not good: decides nothing (the stale alarm does)."""


@dataclass(frozen=True, slots=True)
class Found:
    """What a look at the drive found, with the numbers for the sentence."""

    place: Place
    value: float | int | str | None = None
    params: Mapping[str, Any] | None = None
    delay_s: float = 0.0
    """Where it must last longer than the setting says."""


@dataclass(slots=True)
class Watch:
    """One setting and one drive. ``value``: what raised it."""

    setting: AlarmSetting
    drive: str
    raised: bool = False
    value: float | int | str | None = None
    _since: float | None = None

    @property
    def key(self) -> Key:
        """Of the alarm that it raises."""
        return (str(self.setting.kind), self.setting.id, self.drive, "")

    def look(self, view: DriveView, now: float) -> tuple[bool, Found | None]:
        """Does it clear now, and what raises it now? Another fault than the one that raised it does both."""
        found = LOOKS[self.setting.kind](self.setting, view)
        cleared = self.raised and (found.place is Place.BACK or self._another(found))
        if cleared:
            self.raised, self._since = False, None
        return cleared, found if self._rises(found, now) else None

    def _another(self, found: Found) -> bool:
        return self.setting.kind is AlarmKind.FAULT and found.place is Place.BEYOND and found.value != self.value

    def _rises(self, found: Found, now: float) -> bool:
        """Beyond for the whole delay; a time in between when nobody knew does not begin it again."""
        if self.raised or found.place is Place.UNKNOWN:
            return False
        if found.place is not Place.BEYOND:
            self._since = None
            return False
        self._since = now if self._since is None else self._since
        if now - self._since + TICK_S < max(self.setting.delay_s, found.delay_s):
            return False
        self.raised, self.value = True, found.value
        return True


def _threshold(setting: AlarmSetting, view: DriveView) -> Found:
    signal = view.signals.get(setting.signal or "")
    if signal is None or setting.threshold is None or not _trusted(signal):
        return Found(Place.UNKNOWN)
    sign = 1.0 if setting.kind is AlarmKind.ABOVE else -1.0
    over = sign * (float(signal.value) - setting.threshold)  # type: ignore[arg-type]
    place = Place.BEYOND if over > 0 else Place.BACK if over <= -setting.hysteresis else Place.WITHIN
    return Found(place, signal.value, {"signal": setting.signal, "unit": signal.unit, "threshold": setting.threshold})


def _trusted(signal: SignalView) -> bool:
    return signal.quality is Quality.GOOD and isinstance(signal.value, int | float)


def _fault(setting: AlarmSetting, view: DriveView) -> Found:
    """Cleared only by a drive that says that it has none; one that can't be asked says nothing."""
    if view.fault is not None:
        return Found(Place.BEYOND, view.fault.get("code"), {"fault": view.fault})
    told = view.signals.get("fault")
    good = view.state != "unknown" or (told is not None and told.quality is Quality.GOOD)
    return Found(Place.BACK if good and view.presence == "online" else Place.UNKNOWN)


def _silent(setting: AlarmSetting, view: DriveView) -> Found:
    if view.presence == "online":
        return Found(Place.BACK)
    return Found(Place.BEYOND, delay_s=NEVER_SEEN_S if view.presence == "never_seen" else 0.0)


def _stale(setting: AlarmSetting, view: DriveView) -> Found:
    """The signal, or any that was ever read: what a family does not report can't become stale."""
    named = setting.signal
    wanted = [name for name in view.signals if name == named] if named else [*view.signals]
    bad = [n for n in wanted if view.signals[n].quality is Quality.BAD and (named or view.signals[n].age_s is not None)]
    known = bool(wanted)
    place = Place.BEYOND if bad else Place.BACK if known else Place.UNKNOWN
    return Found(place, None, {"signals": bad})


LOOKS: Mapping[AlarmKind, Callable[[AlarmSetting, DriveView], Found]] = {
    AlarmKind.ABOVE: _threshold,
    AlarmKind.BELOW: _threshold,
    AlarmKind.FAULT: _fault,
    AlarmKind.SILENT: _silent,
    AlarmKind.STALE: _stale,
}
