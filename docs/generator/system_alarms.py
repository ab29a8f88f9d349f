"""Table of the alarms that the service itself raises: kind, priority and message of each."""

from __future__ import annotations

from drivebus import i18n
from drivebus.service.alarms.model import SYSTEM_ALARM_PRIORITIES, SystemAlarm
from drivebus.values import Text
from generator.terms import localized, named_placeholders, table

HEADS = (Text("kind", "类型"), Text("priority", "优先级"), Text("message", "文字"))


def system_alarms(language: str) -> str:
    """Return the table in the order of the declaration."""
    rows = [
        (
            f"`{kind}`",
            f"`{SYSTEM_ALARM_PRIORITIES[kind]}`",
            named_placeholders(i18n.catalogue(language)[f"alarms.text.{kind}"]),
        )
        for kind in SystemAlarm
    ]
    return table([localized(head, language) for head in HEADS], rows)
