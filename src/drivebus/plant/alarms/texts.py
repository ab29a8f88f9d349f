"""A new alarm, and what it says in both languages with its numbers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from drivebus import i18n
from drivebus.plant.alarms.alarm import PRIORITIES, Alarm, Own
from drivebus.plant.alarms.watch import Found
from drivebus.plant.model import AlarmKind, AlarmSetting
from drivebus.profiles.complaint import both
from drivebus.profiles.model import Text


def number(value: Any) -> Any:
    """As short as it can be said: 50, not 50.000; a word stays a word."""
    return f"{round(value, 3):.12g}" if isinstance(value, float) else value


def signal_name(name: str) -> Text:
    """``output_frequency`` as people say it, where the catalogues know it."""
    key = f"signal.{name}"
    return both(key) if i18n.known(key) else Text(name, name)


def title_of(setting: AlarmSetting, params: Mapping[str, Any]) -> Text:
    """The plant's own title, else what the kind is called."""
    if setting.title.en or setting.title.zh:
        return Text(setting.title.en or setting.title.zh, setting.title.zh or setting.title.en)
    return both(f"alarms.title.{setting.kind}", **params)


def text_of(kind: AlarmKind, params: Mapping[str, Any]) -> Text:
    """What is the matter, with the numbers."""
    return both(f"alarms.text.{kind}", **params)


def params_of(drive: Text, found: Mapping[str, Any], value: Any) -> dict[str, Any]:
    """The numbers of a sentence."""
    fault = found.get("fault") or {}
    signals = [signal_name(name) for name in found.get("signals", ())]
    return {
        "drive": drive,
        "value": number(value),
        "unit": found.get("unit", ""),
        "threshold": number(found.get("threshold")),
        "signal": signal_name(str(found.get("signal"))),
        "signals": Text(", ".join(one.en for one in signals), "、".join(one.zh for one in signals)),
        "fault": _fault_text(fault),
    }


def of_setting(id: str, setting: AlarmSetting, drive: str, name: Text, found: Found, now_ms: int) -> Alarm:
    """An alarm that a value raises."""
    params = params_of(name, found.params or {}, found.value)
    title, text = title_of(setting, params), text_of(setting.kind, params)
    return Alarm(id, setting.id, drive, setting.priority, str(setting.kind), title, text, now_ms, found.value)


def of_service(id: str, kind: Own, drive: str, name: Text, now_ms: int, about: str, params: Mapping[str, Any]) -> Alarm:
    """An alarm that the service itself raises."""
    named = {"drive": name, "about": about, "reason": ""} | {key: number(value) for key, value in params.items()}
    title, text = both(f"alarms.title.{kind}", **named), both(f"alarms.text.{kind}", **named)
    return Alarm(id, str(kind), drive, PRIORITIES[kind], str(kind), title, text, now_ms, about=about)


def _fault_text(fault: Mapping[str, Any]) -> Text:
    """Its label and what it means; once where the meaning is no more than the label."""
    label, text = str(fault.get("label") or fault.get("code") or ""), fault.get("text") or {}
    said = [str(text.get(language) or "") for language in ("en", "zh")]
    return Text(*(one if label in one else f"{label} {one}".strip() for one in said))
