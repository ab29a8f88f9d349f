"""Alarm condition: one alarm configuration evaluated for one drive, with hysteresis and delay. Pure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum, auto
from typing import Any

from drivebus.drives.dialects.base import UNNAMED_FAULT_CODE
from drivebus.service.alarms.model import AlarmKey
from drivebus.service.config.model import AlarmConfig, AlarmKind
from drivebus.service.live.views import DriveView, SignalView
from drivebus.values import Quality

FIRST_REPLY_TIMEOUT_S = 10.0
"""A drive that has never answered raises ``no_response`` only after this time."""
UNNAMED_FAULT_DELAY_S = 2.0
"""Time for the fault word to be read after the status word has shown a fault: the alarm then names the fault."""
DELAY_TOLERANCE_S = 1e-9
"""Larger than the rounding error of added seconds at the end of a delay."""


class LimitState(Enum):
    """Position of a value relative to its limit."""

    VIOLATED = auto()
    IN_HYSTERESIS = auto()
    """Neither raises nor clears the alarm, and ends a running delay."""
    NORMAL = auto()
    UNKNOWN = auto()
    """No good value: neither raises nor clears the alarm."""


@dataclass(frozen=True, slots=True)
class Observation:
    """Result of observing a drive, with the parameters of the alarm's sentence."""

    state: LimitState
    value: float | int | str | None = None
    params: Mapping[str, Any] | None = None
    delay_s: float = 0.0
    """Minimum delay, where it is longer than the configured one."""


@dataclass(slots=True)
class AlarmCondition:
    """Alarm configuration applied to a drive. ``value``: the value that raised the alarm."""

    setting: AlarmConfig
    drive: str
    raised: bool = False
    value: float | int | str | None = None
    _since: float | None = None

    @property
    def key(self) -> AlarmKey:
        """Key of the alarm that it raises."""
        return (str(self.setting.kind), self.setting.id, self.drive, "")

    def evaluate(self, view: DriveView, now: float) -> tuple[bool, Observation | None]:
        """Return whether the alarm clears now, and the observation that raises it now.

        Both happen when a drive reports another fault than the one that raised the alarm, and when a drive that was
        silent sends a reply that can't be used.
        """
        observation = OBSERVERS[self.setting.kind](self.setting, view)
        shows_reply = self.raised and self._is_no_silence(observation)
        cleared = shows_reply or (
            self.raised and (observation.state is LimitState.NORMAL or self._is_other_fault(observation))
        )
        if cleared:
            self.raised, self._since = False, self._since if shows_reply else None
        return cleared, observation if self._becomes_active(observation, now) else None

    def named_fault(self, view: DriveView) -> Observation | None:
        """Return the fault of a raised alarm without a code, once the drive has named it."""
        if not self.raised or self.setting.kind is not AlarmKind.FAULT or self.value != UNNAMED_FAULT_CODE:
            return None
        observation = OBSERVERS[self.setting.kind](self.setting, view)
        return observation if self._is_other_fault(observation) else None

    def suppress(self) -> None:
        """Neither raise nor clear the alarm now; its delay begins again afterwards."""
        self._since = None

    def _is_other_fault(self, observation: Observation) -> bool:
        is_fault = self.setting.kind is AlarmKind.FAULT and observation.state is LimitState.VIOLATED
        return is_fault and observation.value not in (self.value, UNNAMED_FAULT_CODE)

    def _is_no_silence(self, observation: Observation) -> bool:
        """Return whether the alarm says that a drive is silent which sends something now."""
        is_silence = self.setting.kind is AlarmKind.NO_RESPONSE and self.value is None
        return is_silence and observation.state is LimitState.VIOLATED and observation.value is not None

    def _becomes_active(self, observation: Observation, now: float) -> bool:
        """Return whether the limit has been violated for the whole delay. Unknown values do not restart the delay."""
        if self.raised or observation.state is LimitState.UNKNOWN:
            return False
        if observation.state is not LimitState.VIOLATED:
            self._since = None
            return False
        self._since = now if self._since is None else self._since
        if now - self._since + DELAY_TOLERANCE_S < max(self.setting.delay_s, observation.delay_s):
            return False
        self.raised, self.value = True, observation.value
        return True


def _threshold(setting: AlarmConfig, view: DriveView) -> Observation:
    signal = view.signals.get(setting.signal or "")
    if signal is None or setting.threshold is None or not _is_good_number(signal):
        return Observation(LimitState.UNKNOWN)
    sign = 1.0 if setting.kind is AlarmKind.ABOVE else -1.0
    over = sign * (float(signal.value) - setting.threshold)  # type: ignore[arg-type]
    state = LimitState.IN_HYSTERESIS
    if over > 0:
        state = LimitState.VIOLATED
    elif over <= -setting.hysteresis:
        state = LimitState.NORMAL
    params = {"signal": setting.signal, "unit": signal.unit, "threshold": setting.threshold}
    return Observation(state, signal.value, params)


def _is_good_number(signal: SignalView) -> bool:
    return signal.quality is Quality.GOOD and isinstance(signal.value, int | float)


def _fault(setting: AlarmConfig, view: DriveView) -> Observation:
    """Observe the fault: normal only if the drive answers and reports none, unknown if it does not answer."""
    if view.fault is not None:
        code = view.fault.get("code")
        delay_s = UNNAMED_FAULT_DELAY_S if code == UNNAMED_FAULT_CODE else 0.0
        return Observation(LimitState.VIOLATED, code, {"fault": view.fault}, delay_s)
    reported = view.signals.get("fault")
    good = view.state != "unknown" or (reported is not None and reported.quality is Quality.GOOD)
    return Observation(LimitState.NORMAL if good and view.presence == "online" else LimitState.UNKNOWN)


def _no_response(setting: AlarmConfig, view: DriveView) -> Observation:
    if view.presence == "online":
        return Observation(LimitState.NORMAL)
    delay_s = FIRST_REPLY_TIMEOUT_S if view.presence == "never_seen" else 0.0
    error = view.unusable_reply
    if error is None:
        return Observation(LimitState.VIOLATED, delay_s=delay_s)
    return Observation(LimitState.VIOLATED, error["code"], {"unusable_reply": error}, delay_s)


def _stale(setting: AlarmConfig, view: DriveView) -> Observation:
    """Observe whether the signal, or without one any signal that was ever read, has bad quality."""
    named = setting.signal
    wanted = [name for name in view.signals if name == named] if named else [*view.signals]
    bad = [
        n
        for n in wanted
        if view.signals[n].quality is Quality.BAD and (named or view.signals[n].source_time_ms is not None)
    ]
    state = LimitState.NORMAL if wanted else LimitState.UNKNOWN
    return Observation(LimitState.VIOLATED if bad else state, None, {"signals": bad})


OBSERVERS: Mapping[AlarmKind, Callable[[AlarmConfig, DriveView], Observation]] = {
    AlarmKind.ABOVE: _threshold,
    AlarmKind.BELOW: _threshold,
    AlarmKind.FAULT: _fault,
    AlarmKind.NO_RESPONSE: _no_response,
    AlarmKind.STALE: _stale,
}
