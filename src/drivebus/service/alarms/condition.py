"""Is it beyond, and for how long? One setting watching one drive. Pure: time is an argument."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum, auto
from typing import Any

from drivebus.service.alarms.model import AlarmKey
from drivebus.service.config.model import AlarmConfig, AlarmKind
from drivebus.service.live.views import DriveView, SignalView
from drivebus.values import Quality

FIRST_REPLY_TIMEOUT_S = 10.0
"""A drive that has not answered yet gets this long after the service began, before it counts as silent."""
DELAY_TOLERANCE_S = 1e-9
"""Sums of floating seconds miss the exact end of a delay by less than this."""


class LimitState(Enum):
    """Where the value is."""

    VIOLATED = auto()
    IN_HYSTERESIS = auto()
    """Inside the hysteresis: neither raises nor clears, and ends a delay that was running."""
    NORMAL = auto()
    UNKNOWN = auto()
    """Not good: decides nothing (the stale alarm does)."""


@dataclass(frozen=True, slots=True)
class Observation:
    """What a look at the drive found, with the numbers for the sentence."""

    state: LimitState
    value: float | int | str | None = None
    params: Mapping[str, Any] | None = None
    delay_s: float = 0.0
    """Where it must last longer than the setting says."""


@dataclass(slots=True)
class AlarmCondition:
    """One setting and one drive. ``value``: what raised it."""

    setting: AlarmConfig
    drive: str
    raised: bool = False
    value: float | int | str | None = None
    _since: float | None = None

    @property
    def key(self) -> AlarmKey:
        """Of the alarm that it raises."""
        return (str(self.setting.kind), self.setting.id, self.drive, "")

    def evaluate(self, view: DriveView, now: float) -> tuple[bool, Observation | None]:
        """Does it clear now, and what raises it now? Another fault than the one that raised it does both."""
        found = OBSERVERS[self.setting.kind](self.setting, view)
        cleared = self.raised and (found.state is LimitState.NORMAL or self._is_other_fault(found))
        if cleared:
            self.raised, self._since = False, None
        return cleared, found if self._becomes_active(found, now) else None

    def _is_other_fault(self, found: Observation) -> bool:
        return self.setting.kind is AlarmKind.FAULT and found.state is LimitState.VIOLATED and found.value != self.value

    def _becomes_active(self, found: Observation, now: float) -> bool:
        """Beyond for the whole delay; a time in between when nobody knew does not begin it again."""
        if self.raised or found.state is LimitState.UNKNOWN:
            return False
        if found.state is not LimitState.VIOLATED:
            self._since = None
            return False
        self._since = now if self._since is None else self._since
        if now - self._since + DELAY_TOLERANCE_S < max(self.setting.delay_s, found.delay_s):
            return False
        self.raised, self.value = True, found.value
        return True


def _threshold(setting: AlarmConfig, view: DriveView) -> Observation:
    signal = view.signals.get(setting.signal or "")
    if signal is None or setting.threshold is None or not _is_good_number(signal):
        return Observation(LimitState.UNKNOWN)
    sign = 1.0 if setting.kind is AlarmKind.ABOVE else -1.0
    over = sign * (float(signal.value) - setting.threshold)  # type: ignore[arg-type]
    place = (
        LimitState.VIOLATED
        if over > 0
        else LimitState.NORMAL
        if over <= -setting.hysteresis
        else LimitState.IN_HYSTERESIS
    )
    return Observation(
        place, signal.value, {"signal": setting.signal, "unit": signal.unit, "threshold": setting.threshold}
    )


def _is_good_number(signal: SignalView) -> bool:
    return signal.quality is Quality.GOOD and isinstance(signal.value, int | float)


def _fault(setting: AlarmConfig, view: DriveView) -> Observation:
    """Cleared only by a drive that says that it has none; one that can't be asked says nothing."""
    if view.fault is not None:
        return Observation(LimitState.VIOLATED, view.fault.get("code"), {"fault": view.fault})
    told = view.signals.get("fault")
    good = view.state != "unknown" or (told is not None and told.quality is Quality.GOOD)
    return Observation(LimitState.NORMAL if good and view.presence == "online" else LimitState.UNKNOWN)


def _no_response(setting: AlarmConfig, view: DriveView) -> Observation:
    if view.presence == "online":
        return Observation(LimitState.NORMAL)
    return Observation(LimitState.VIOLATED, delay_s=FIRST_REPLY_TIMEOUT_S if view.presence == "never_seen" else 0.0)


def _stale(setting: AlarmConfig, view: DriveView) -> Observation:
    """The signal, or any that was ever read: what a family does not report can't become stale."""
    named = setting.signal
    wanted = [name for name in view.signals if name == named] if named else [*view.signals]
    bad = [n for n in wanted if view.signals[n].quality is Quality.BAD and (named or view.signals[n].age_s is not None)]
    known = bool(wanted)
    place = LimitState.VIOLATED if bad else LimitState.NORMAL if known else LimitState.UNKNOWN
    return Observation(place, None, {"signals": bad})


OBSERVERS: Mapping[AlarmKind, Callable[[AlarmConfig, DriveView], Observation]] = {
    AlarmKind.ABOVE: _threshold,
    AlarmKind.BELOW: _threshold,
    AlarmKind.FAULT: _fault,
    AlarmKind.NO_RESPONSE: _no_response,
    AlarmKind.STALE: _stale,
}
