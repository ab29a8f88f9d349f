"""A new alarm, and what it says in both languages with its numbers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from drivebus import i18n
from drivebus.profiles.diagnostics import bilingual_text
from drivebus.profiles.model import Text
from drivebus.service.alarms.condition import Observation
from drivebus.service.alarms.model import SYSTEM_ALARM_PRIORITIES, Alarm, SystemAlarm
from drivebus.service.config.model import AlarmConfig, AlarmKind


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
