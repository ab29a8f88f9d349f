"""Alarms (ISA-18.2): values, their keys and changes, and the alarms that the service itself raises."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

from drivebus.service.config.model import AlarmKind, AlarmPriority
from drivebus.service.live.views import text_json
from drivebus.types import Json
from drivebus.values import Text


class SystemAlarm(StrEnum):
    """Kinds of alarms that the service itself raises."""

    STOP_UNCONFIRMED = "stop_unconfirmed"
    """A stop was sent and the drive does not report stopped."""
    CONTROL_LOST = "control_lost"
    """The owner of the control lease is gone while the drive runs."""
    RUNNING_AT_START = "running_at_start"
    """The drive was already running when the service started."""
    OTHER_SPEED = "other_speed"
    """The drive keeps another speed than the one to which the service set it."""
    INTERLOCK_TRIP = "interlock_trip"
    """An interlock stopped the drive."""
    AUDIT_FAILURE = "audit_failure"
    """The audit trail cannot be written; starts are refused."""
    STORAGE_FAILURE = "storage_failure"
    """The history, the alarm log or an incident cannot be written; control of the drives does not depend on it."""
    AUDIT_INCOMPLETE = "audit_incomplete"
    """Records or checkpoints of the audit trail were missing when the service started."""
    AUDIT_KEY_REPLACED = "audit_key_replaced"
    """The checkpoints of the audit trail were not made with its key when the service started."""
    AUDIT_HEAD_MISSING = "audit_head_missing"
    """The audit trail had checkpoints and no head when the service started."""
    SETTINGS_LOST = "settings_lost"
    """Waivers and limits of drives can't be read."""
    FILE_DAMAGED = "file_damaged"
    """A file could not be read when the service started, and was put aside."""
    CERTIFICATE_EXPIRY = "certificate_expiry"
    """The TLS certificate of a gateway ends soon, or has ended."""
    PORT_LOST = "port_lost"
    """A bus has lost its port."""
    FOREIGN_MASTER = "foreign_master"
    """Another master sends on a bus."""


SYSTEM_ALARM_PRIORITIES: Mapping[SystemAlarm, AlarmPriority] = {
    SystemAlarm.STOP_UNCONFIRMED: AlarmPriority.CRITICAL,
    SystemAlarm.CONTROL_LOST: AlarmPriority.HIGH,
    SystemAlarm.RUNNING_AT_START: AlarmPriority.HIGH,
    SystemAlarm.OTHER_SPEED: AlarmPriority.HIGH,
    SystemAlarm.INTERLOCK_TRIP: AlarmPriority.CRITICAL,
    SystemAlarm.AUDIT_FAILURE: AlarmPriority.CRITICAL,
    SystemAlarm.STORAGE_FAILURE: AlarmPriority.HIGH,
    SystemAlarm.AUDIT_INCOMPLETE: AlarmPriority.HIGH,
    SystemAlarm.AUDIT_KEY_REPLACED: AlarmPriority.HIGH,
    SystemAlarm.AUDIT_HEAD_MISSING: AlarmPriority.HIGH,
    SystemAlarm.SETTINGS_LOST: AlarmPriority.HIGH,
    SystemAlarm.FILE_DAMAGED: AlarmPriority.MEDIUM,
    SystemAlarm.CERTIFICATE_EXPIRY: AlarmPriority.MEDIUM,
    SystemAlarm.PORT_LOST: AlarmPriority.CRITICAL,
    SystemAlarm.FOREIGN_MASTER: AlarmPriority.CRITICAL,
}


WRITE_FAILURE_ALARMS = (SystemAlarm.AUDIT_FAILURE, SystemAlarm.STORAGE_FAILURE)
"""Alarms whose subject can't be written."""
SYSTEM_ALARM_KINDS = frozenset(map(str, SystemAlarm))
AlarmKey = tuple[str, str, str, str]
"""Kind, configuration id, drive, subject. At most one alarm of a key is raised at a time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Alarm:
    """Occurrence of an alarm; active until it is cleared and acknowledged. Times are UTC milliseconds."""

    id: str
    setting: str
    """Id of the AlarmConfig; for a system alarm its kind."""
    drive: str
    """Empty if it concerns no drive."""
    priority: AlarmPriority
    kind: str
    """An ``AlarmKind`` or a ``SystemAlarm``."""
    title: Text
    text: Text
    remedy: Text = Text("", "")
    """What to do about it; empty in the log of an earlier version."""
    raised_ms: int
    first_id: str
    """Id of the first occurrence since the last acknowledgement: it stays while the alarm repeats."""
    first_raised_ms: int
    count: int = 1
    """Occurrences since the last acknowledgement, this one included."""
    value: float | int | str | None = None
    """Value or fault code that raised it."""
    subject: str = ""
    """Further subject: a bus, an interlock, a file."""
    cleared_ms: int | None = None
    acknowledged_ms: int | None = None
    acknowledged_by: str | None = None
    shelved_until_ms: int | None = None
    shelved_by: str | None = None
    shelved_reason: str | None = None
    incident: str | None = None
    drive_replaced: bool = False
    """A reload has removed its drive or given the name to another motor, whose alarms do not repeat this one."""

    @property
    def active(self) -> bool:
        return self.cleared_ms is None or self.acknowledged_ms is None

    @property
    def key(self) -> AlarmKey:
        """Key; it contains kind and id, so that a configured id that equals a system kind hides no system alarm."""
        return (self.kind, self.setting, self.drive, self.subject)

    def is_repeated_by(self, later: Alarm) -> bool:
        """Return whether a later alarm repeats this one, which is cleared; another fault is another alarm."""
        is_same = self.key == later.key and (self.kind != AlarmKind.FAULT or self.value == later.value)
        return is_same and self.cleared_ms is not None and not self.drive_replaced

    def repeating(self, earlier: Alarm) -> Alarm:
        """Return this alarm as a repetition of an unacknowledged one."""
        return replace(
            self,
            first_id=earlier.first_id,
            first_raised_ms=earlier.first_raised_ms,
            count=max(self.count, earlier.count + 1),
        )

    def as_json(self) -> Json:
        return {
            "id": self.id,
            "setting": self.setting,
            "drive": self.drive,
            "priority": str(self.priority),
            "kind": self.kind,
            "title": text_json(self.title),
            "text": text_json(self.text),
            "remedy": text_json(self.remedy),
            "value": self.value,
            "subject": self.subject,
            "raised_ms": self.raised_ms,
            "first_id": self.first_id,
            "first_raised_ms": self.first_raised_ms,
            "count": self.count,
            "cleared_ms": self.cleared_ms,
            "acknowledged_ms": self.acknowledged_ms,
            "acknowledged_by": self.acknowledged_by,
            "shelved_until_ms": self.shelved_until_ms,
            "shelved_by": self.shelved_by,
            "shelved_reason": self.shelved_reason,
            "incident": self.incident,
            "drive_replaced": self.drive_replaced,
        }

    @classmethod
    def from_json(cls, stored: dict[str, Any]) -> Alarm:
        """Return the alarm of a log line. Raises KeyError, TypeError, ValueError for anything else."""
        texts: dict[str, Json] = {name: stored[name] for name in ("title", "text", "remedy") if name in stored}
        alarm = cls(
            **{
                "first_id": stored["id"],  # the log of an earlier version has no count
                "first_raised_ms": stored["raised_ms"],
                **stored,
                "priority": AlarmPriority(stored["priority"]),
                **{name: Text(text["en"], text["zh"]) for name, text in texts.items()},
            }
        )
        alarm._check_types()
        return alarm

    def _check_types(self) -> None:
        """Raise TypeError for a field of another type: the service would fail with it at its start."""
        words = (self.id, self.first_id, self.setting, self.drive, self.kind, self.subject)
        optional_words = (self.acknowledged_by, self.shelved_by, self.shelved_reason, self.incident)
        texts = [text for sentence in (self.title, self.text, self.remedy) for text in (sentence.en, sentence.zh)]
        times = (self.cleared_ms, self.acknowledged_ms, self.shelved_until_ms)
        are_typed = (
            all(type(value) is str for value in (*words, *texts))
            and all(value is None or type(value) is str for value in optional_words)
            and all(type(value) is int for value in (self.raised_ms, self.first_raised_ms, self.count))
            and all(value is None or type(value) is int for value in times)
            and (self.value is None or type(self.value) in (int, float, str))
            and type(self.drive_replaced) is bool
        )
        if not are_typed:
            raise TypeError("a field of an alarm has another type")


@dataclass(frozen=True, slots=True)
class AlarmChange:
    """Change of an alarm: ``raised``, ``named`` (its fault now has a code), ``cleared``, ``acknowledged``, ``shelved``,
    ``unshelved`` or ``incident``.
    """

    action: str
    alarm: Alarm
