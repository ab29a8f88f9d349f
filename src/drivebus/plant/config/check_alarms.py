"""Alarms: what each kind needs, signals that its drives have, thresholds that can be reached and left again."""

from __future__ import annotations

from collections.abc import Iterator

from drivebus.plant.config.build import polled, watched
from drivebus.plant.config.check_drives import near
from drivebus.plant.config.draft import Draft
from drivebus.plant.config.schema import AlarmTable
from drivebus.profiles.complaint import Path, Problem, both, problem
from drivebus.profiles.model import Signal

_THRESHOLD = ("above", "below")
_OF_A_SIGNAL = (*_THRESHOLD, "stale")


def problems(draft: Draft) -> Iterator[Problem]:
    for id, alarm in draft.file.alarm.items():
        path = ("alarm", id)
        yield from _keys(alarm, path)
        if alarm.signal is not None and alarm.kind in _OF_A_SIGNAL:
            yield from _signal(draft, alarm, alarm.signal, path)


def _keys(alarm: AlarmTable, path: Path) -> Iterator[Problem]:
    """What a kind needs and what means nothing to it."""
    for name in ("signal", "threshold") if alarm.kind in _THRESHOLD else ():
        if getattr(alarm, name) is None:
            yield problem("alarm_needs", (*path, "kind"), alarm.kind, name=name)
    idle = () if alarm.kind in _THRESHOLD else ("threshold", "hysteresis")
    for name in (*idle, *(() if alarm.kind in _OF_A_SIGNAL else ("signal",))):
        if name in alarm.model_fields_set:
            yield problem("alarm_idle", (*path, name), getattr(alarm, name), kind=alarm.kind)


def _signal(draft: Draft, alarm: AlarmTable, name: str, path: Path) -> Iterator[Problem]:
    drives = [one for one in watched(draft, alarm) if one in draft.profiles]
    if not alarm.drives and not drives:
        known = {signal for id, one in draft.file.drive.items() for signal in polled(draft, id, one)}
        yield problem(
            "alarm_signal", (*path, "signal"), name, drive=both("plant_config.any_drive"), **near(name, sorted(known))
        )
        return
    signals: dict[str, Signal] = {}
    for drive in drives:
        asked = polled(draft, drive, draft.file.drive[drive])
        if name not in asked:
            yield problem("alarm_signal", (*path, "signal"), name, drive=drive, **near(name, asked))
        elif name in draft.profiles[drive].signals:
            signals[drive] = draft.profiles[drive].signals[name]
    units = {signal.unit: drive for drive, signal in signals.items()}
    if alarm.kind in _THRESHOLD and len(units) > 1:
        shown = ", ".join(f"{drive}: {unit or '-'}" for unit, drive in units.items())
        yield problem("alarm_units", (*path, "signal"), name, units=shown)
    elif alarm.threshold is not None:
        yield from _threshold(alarm, alarm.threshold, signals, path)


def _threshold(alarm: AlarmTable, threshold: float, signals: dict[str, Signal], path: Path) -> Iterator[Problem]:
    """It can be crossed, and left again by the hysteresis."""
    for drive, signal in signals.items():
        low, high = signal.minimum, signal.maximum
        bounds = f"{_shown(low)} … {_shown(high)} {signal.unit}".rstrip()
        if _outside(threshold, low, high):
            yield problem("alarm_threshold", (*path, "threshold"), threshold, drive=drive, range=bounds)
            return
        back = threshold - alarm.hysteresis if alarm.kind == "above" else threshold + alarm.hysteresis
        if alarm.hysteresis and _outside(back, low, high):
            found = alarm.hysteresis
            yield problem("alarm_hysteresis", (*path, "hysteresis"), found, back=f"{back:g}", drive=drive, range=bounds)
            return


def _outside(value: float, low: float | None, high: float | None) -> bool:
    return (low is not None and value < low) or (high is not None and value > high)


def _shown(bound: float | None) -> str:
    return "-" if bound is None else f"{bound:g}"
