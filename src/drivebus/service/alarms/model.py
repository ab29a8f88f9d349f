"""What an alarm is. Values only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from drivebus.profiles.model import Text
from drivebus.service.config.model import AlarmPriority
from drivebus.service.live.views import Json, text_json


class SystemAlarm(StrEnum):
    """What the service itself raises; nothing that a drive reports decides about it."""

    STOP_UNCONFIRMED = "stop_unconfirmed"
    """A stop was sent and the drive does not report stopped (G07)."""
    CONTROL_LOST = "lease_lost"
    """Whoever commanded the running drive is gone (6.6)."""
    RUNNING_AT_START = "no_owner"
    """It was running when the service started (ruling 7)."""
    INTERLOCK_TRIP = "interlock"
    """An interlock stopped it."""
    STORAGE_FAILURE = "store"
    """The audit trail or the history can't be written (G14)."""
    AUDIT_INCOMPLETE = "audit"
    """Records of the audit trail were missing when the service started (S12)."""
    PORT_LOST = "port"
    """A bus has lost its port (F12)."""
    FOREIGN_MASTER = "foreign_master"
    """Somebody else speaks on a bus (F14)."""


SYSTEM_ALARM_PRIORITIES: Mapping[SystemAlarm, AlarmPriority] = {
    SystemAlarm.STOP_UNCONFIRMED: AlarmPriority.CRITICAL,
    SystemAlarm.CONTROL_LOST: AlarmPriority.HIGH,
    SystemAlarm.RUNNING_AT_START: AlarmPriority.HIGH,
    SystemAlarm.INTERLOCK_TRIP: AlarmPriority.CRITICAL,
    SystemAlarm.STORAGE_FAILURE: AlarmPriority.CRITICAL,
    SystemAlarm.AUDIT_INCOMPLETE: AlarmPriority.HIGH,
    SystemAlarm.PORT_LOST: AlarmPriority.CRITICAL,
    SystemAlarm.FOREIGN_MASTER: AlarmPriority.CRITICAL,
}


SYSTEM_ALARM_KINDS = frozenset(map(str, SystemAlarm))
AlarmKey = tuple[str, str, str, str]
"""Kind, setting, drive, what else: it can be raised once at a time."""


@dataclass(frozen=True, slots=True)
class Alarm:
    """One time that something was wrong. Active: not cleared, or not acknowledged. Times are UTC milliseconds."""

    id: str
    setting: str
    """The AlarmConfig's id, ``fault`` or ``silent``; for what the service raises, its kind."""
    drive: str
    """Empty where it is about no drive."""
    priority: AlarmPriority
    kind: str
    """An AlarmKind or an ``Own``."""
    title: Text
    text: Text
    raised_ms: int
    value: float | int | str | None = None
    """The value that raised it; a fault's code."""
    about: str = ""
    """What else it is about: a bus, an interlock, a store."""
    cleared_ms: int | None = None
    acknowledged_ms: int | None = None
    by: str | None = None
    shelved_until_ms: int | None = None
    case: str | None = None

    @property
    def active(self) -> bool:
        return self.cleared_ms is None or self.acknowledged_ms is None

    @property
    def key(self) -> AlarmKey:
        """What it is an alarm of. A setting that somebody calls like a kind of the service hides none of these."""
        return (self.kind, self.setting, self.drive, self.about)

    def as_json(self) -> Json:
        return {
            "id": self.id,
            "setting": self.setting,
            "drive": self.drive,
            "priority": str(self.priority),
            "kind": self.kind,
            "title": text_json(self.title),
            "text": text_json(self.text),
            "value": self.value,
            "about": self.about,
            "raised_ms": self.raised_ms,
            "cleared_ms": self.cleared_ms,
            "acknowledged_ms": self.acknowledged_ms,
            "by": self.by,
            "shelved_until_ms": self.shelved_until_ms,
            "case": self.case,
        }

    @classmethod
    def from_json(cls, found: dict[str, Any]) -> Alarm:
        """Raises KeyError, TypeError, ValueError for what is no alarm."""
        return cls(
            **{
                **found,
                "priority": AlarmPriority(found["priority"]),
                **{name: Text(found[name]["en"], found[name]["zh"]) for name in ("title", "text")},
            }
        )


@dataclass(frozen=True, slots=True)
class AlarmChange:
    """What happened to an alarm: ``raised``, ``cleared``, ``acknowledged``, ``shelved``, ``unshelved`` or ``case``."""

    action: str
    alarm: Alarm
