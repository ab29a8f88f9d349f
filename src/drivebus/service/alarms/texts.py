"""Alarms with their texts: title, text and remedy of what a condition observes or the service itself reports. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from drivebus import i18n
from drivebus.drives.dialects.base import UNNAMED_FAULT_CODE
from drivebus.drives.state import join_fault_after_word
from drivebus.service.alarms.condition import Observation
from drivebus.service.alarms.model import SYSTEM_ALARM_PRIORITIES, Alarm, SystemAlarm
from drivebus.service.config.model import AlarmConfig
from drivebus.values import Text, bilingual_text


def formatted_number(value: Any) -> Any:
    """Return a number without trailing zeros (50, not 50.000), and anything else unchanged."""
    return f"{round(value, 3):.12g}" if isinstance(value, float) else value


def signal_name(name: str) -> Text:
    """Return the translated name of a signal; its identifier if there is none."""
    key = f"signal.{name}"
    return bilingual_text(key) if i18n.known(key) else Text(name, name)


def subject_name(subject: str) -> Text:
    """Return the translated name of an alarm's subject; the subject itself, as a file or a bus, if there is none."""
    key = f"alarms.subject.{subject}"
    return bilingual_text(key) if i18n.known(key) else Text(subject, subject)


def alarm_title(setting: AlarmConfig, params: Mapping[str, Any]) -> Text:
    """Return the configured title, else the title of the alarm's kind."""
    if setting.title.en or setting.title.zh:
        return Text(setting.title.en or setting.title.zh, setting.title.zh or setting.title.en)
    return bilingual_text(f"alarms.title.{sentence_of(setting, params)}", **params)


def sentence_of(setting: AlarmConfig, params: Mapping[str, Any]) -> str:
    """Return the end of the keys of an alarm's sentences: its kind, except for a drive that sends something."""
    return "unusable_reply" if params.get("unusable_reply") else str(setting.kind)


def text_params(drive: Text, params: Mapping[str, Any], value: Any) -> dict[str, Any]:
    """Return the parameters of an alarm's sentence."""
    fault = params.get("fault") or {}
    signals = [signal_name(name) for name in params.get("signals", ())]
    return {
        "drive": drive,
        "value": formatted_number(value),
        "unit": params.get("unit", ""),
        "threshold": formatted_number(params.get("threshold")),
        "signal": signal_name(str(params.get("signal"))),
        "signals": Text.join(signals, "items"),
        "fault": _fault_text(fault),
        "unusable_reply": Text.from_mapping(params["unusable_reply"]["text"]) if "unusable_reply" in params else "",
    }


def configured_alarm(
    id: str, setting: AlarmConfig, *, drive: str, name: Text, observation: Observation, now_ms: int
) -> Alarm:
    """Return the alarm that an observed value raises."""
    params = text_params(name, observation.params or {}, observation.value)
    return Alarm(
        id=id,
        setting=setting.id,
        drive=drive,
        priority=setting.priority,
        kind=str(setting.kind),
        title=alarm_title(setting, params),
        text=bilingual_text(f"alarms.text.{sentence_of(setting, params)}", **params),
        remedy=_remedy(observation.params or {}) or bilingual_text(f"alarms.remedy.{setting.kind}"),
        raised_ms=now_ms,
        first_id=id,
        first_raised_ms=now_ms,
        value=observation.value,
    )


def system_alarm(
    id: str,
    kind: SystemAlarm,
    *,
    drive: str,
    name: Text,
    now_ms: int,
    subject: str,
    params: Mapping[str, Any],
    sentence: str | None = None,
) -> Alarm:
    """Return an alarm that the service itself raises.

    ``sentence``: last part of the i18n keys of its title and text, where it is not that of its kind.
    """
    sentence = sentence or str(kind)
    numbers = {key: formatted_number(value) for key, value in params.items()}
    named = {"drive": name, "subject": subject_name(subject), "bus": subject, "reason": ""} | numbers
    return Alarm(
        id=id,
        setting=str(kind),
        drive=drive,
        priority=SYSTEM_ALARM_PRIORITIES[kind],
        kind=str(kind),
        title=bilingual_text(f"alarms.title.{sentence}", **named),
        text=bilingual_text(f"alarms.text.{sentence}", **named),
        remedy=bilingual_text(f"alarms.remedy.{kind}"),
        raised_ms=now_ms,
        first_id=id,
        first_raised_ms=now_ms,
        subject=subject,
    )


def _fault_text(fault: Mapping[str, Any]) -> Text:
    """Return a fault's label and meaning, each once; the sentence around it already has the word fault."""
    code = fault.get("code")
    label = str(fault.get("label") or ("" if code in (None, UNNAMED_FAULT_CODE) else code))
    text = fault.get("text") or {}
    meanings = {language: str(text.get(language) or "") for language in i18n.LANGUAGES}
    return Text.per_language(lambda language: join_fault_after_word(label, meanings[language]))


def _remedy(params: Mapping[str, Any]) -> Text | None:
    """Return the remedy of the reported fault, or of the reply that can't be used; None without one."""
    key = f"hint.{(params.get('unusable_reply') or {}).get('code')}"
    return bilingual_text(key) if i18n.known(key) else _fault_remedy(params)


def _fault_remedy(params: Mapping[str, Any]) -> Text | None:
    """Return the remedy that the profile publishes for the reported fault; None without one in both languages."""
    remedy = (params.get("fault") or {}).get("remedy") or {}
    return Text(remedy["en"], remedy["zh"]) if remedy.get("en") and remedy.get("zh") else None
