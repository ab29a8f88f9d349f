"""Alarms: what each kind needs, signals that its drives have, thresholds that can be reached and left again."""

from __future__ import annotations

from collections.abc import Iterator

from drivebus.profiles.diagnostics import Issue, KeyPath, bilingual_text, issue
from drivebus.profiles.model import Signal
from drivebus.service.config.build import alarm_drives, polled_signals
from drivebus.service.config.check_drives import suggestions
from drivebus.service.config.parsed import ParsedPlant
from drivebus.service.config.schema import AlarmTable

_THRESHOLD_KINDS = ("above", "below")
_SIGNAL_KINDS = (*_THRESHOLD_KINDS, "stale")


def alarm_problems(draft: ParsedPlant) -> Iterator[Issue]:
    for id, alarm in draft.file.alarm.items():
        path = ("alarm", id)
        yield from _check_keys(alarm, path)
        if alarm.signal is not None and alarm.kind in _SIGNAL_KINDS:
            yield from _check_signal(draft, alarm, alarm.signal, path)


def _check_keys(alarm: AlarmTable, path: KeyPath) -> Iterator[Issue]:
    """What a kind needs and what means nothing to it."""
    for name in ("signal", "threshold") if alarm.kind in _THRESHOLD_KINDS else ():
        if getattr(alarm, name) is None:
            yield issue("alarm_needs", (*path, "kind"), alarm.kind, name=name)
    idle = () if alarm.kind in _THRESHOLD_KINDS else ("threshold", "hysteresis")
    for name in (*idle, *(() if alarm.kind in _SIGNAL_KINDS else ("signal",))):
        if name in alarm.model_fields_set:
            yield issue("alarm_idle", (*path, name), getattr(alarm, name), kind=alarm.kind)


def _check_signal(draft: ParsedPlant, alarm: AlarmTable, name: str, path: KeyPath) -> Iterator[Issue]:
    drives = [one for one in alarm_drives(draft, alarm) if one in draft.profiles]
    if not alarm.drives and not drives:
        known = {signal for id, one in draft.file.drive.items() for signal in polled_signals(draft, id, one)}
        yield issue(
            "alarm_signal",
            (*path, "signal"),
            name,
            drive=bilingual_text("plant_config.any_drive"),
            **suggestions(name, sorted(known)),
        )
        return
    signals: dict[str, Signal] = {}
    for drive in drives:
        asked = polled_signals(draft, drive, draft.file.drive[drive])
        if name not in asked:
            yield issue("alarm_signal", (*path, "signal"), name, drive=drive, **suggestions(name, asked))
        elif name in draft.profiles[drive].signals:
            signals[drive] = draft.profiles[drive].signals[name]
    units = {signal.unit: drive for drive, signal in signals.items()}
    if alarm.kind in _THRESHOLD_KINDS and len(units) > 1:
        shown = ", ".join(f"{drive}: {unit or '-'}" for unit, drive in units.items())
        yield issue("alarm_units", (*path, "signal"), name, units=shown)
    elif alarm.threshold is not None:
        yield from _check_threshold(alarm, alarm.threshold, signals, path)


def _check_threshold(alarm: AlarmTable, threshold: float, signals: dict[str, Signal], path: KeyPath) -> Iterator[Issue]:
    """It can be crossed, and left again by the hysteresis."""
    for drive, signal in signals.items():
        low, high = signal.minimum, signal.maximum
        bounds = f"{_bound_text(low)} … {_bound_text(high)} {signal.unit}".rstrip()
        if _outside(threshold, low, high):
            yield issue("alarm_threshold", (*path, "threshold"), threshold, drive=drive, range=bounds)
            return
        back = threshold - alarm.hysteresis if alarm.kind == "above" else threshold + alarm.hysteresis
        if alarm.hysteresis and _outside(back, low, high):
            found = alarm.hysteresis
            yield issue("alarm_hysteresis", (*path, "hysteresis"), found, back=f"{back:g}", drive=drive, range=bounds)
            return


def _outside(value: float, low: float | None, high: float | None) -> bool:
    return (low is not None and value < low) or (high is not None and value > high)


def _bound_text(bound: float | None) -> str:
    return "-" if bound is None else f"{bound:g}"
