"""What every surface sees of the plant at one moment: values that know their JSON. The hub publishes these.

Times are UTC milliseconds (``time_ms``) of the plant's own clock, for labels; ages are seconds of the monotonic one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from drivebus.drives.state import Fault
from drivebus.profiles.model import FaultEntry, Text
from drivebus.values import Quality, Reading

Json = dict[str, Any]


def text_json(text: Text | None) -> Json | None:
    return None if text is None else {"en": text.en, "zh": text.zh}


def fault_json(fault: Fault | FaultEntry | None) -> Json | None:
    """The fault that a drive has, or one that its model may have."""
    return (
        None
        if fault is None
        else {
            "code": fault.code,
            "label": fault.label,
            "text": text_json(fault.text),
            "cause": text_json(fault.cause),
            "remedy": text_json(fault.remedy),
        }
    )


@dataclass(frozen=True, slots=True)
class SignalView:
    """One value with its trust. ``age_s`` None: never read. ``reason`` is an i18n key."""

    value: float | int | str | None
    unit: str
    quality: Quality
    reason: str | None
    age_s: float | None

    @classmethod
    def of(cls, reading: Reading, now: float) -> SignalView:
        return cls(reading.value, reading.unit, reading.quality, reading.reason, reading.age_s(now))

    def as_json(self) -> Json:
        age = None if self.age_s is None else round(self.age_s, 3)
        return {
            "value": self.value,
            "unit": self.unit,
            "quality": str(self.quality),
            "reason": self.reason,
            "age_s": age,
        }


@dataclass(frozen=True, slots=True)
class CommLossView:
    """The badge: what the drive does when this host dies. ``kind``: ``trips``, ``runs_on`` or ``unknown``."""

    kind: str
    after_s: float | None
    text: Text
    waiver: str | None = None
    """Why somebody allows a start all the same, and who; None: no waiver."""

    def as_json(self) -> Json:
        return {"kind": self.kind, "after_s": self.after_s, "text": text_json(self.text), "waiver": self.waiver}


@dataclass(frozen=True, slots=True)
class LeaseView:
    """Who may command the drive now."""

    owner: str
    session: str
    expires_in_s: float

    def as_json(self) -> Json:
        return {"owner": self.owner, "session": self.session, "expires_in_s": round(self.expires_in_s, 1)}


@dataclass(frozen=True, slots=True)
class DriveView:
    """One drive as the plant knows it now; topic ``drives/<id>``."""

    id: str
    title: Text
    bus: str
    address: int
    model: str
    grade: str
    capabilities: tuple[str, ...]
    groups: tuple[str, ...]
    presence: str
    """``online``, ``silent`` or ``never_seen``."""
    state: str
    """A DriveState; ``unknown`` with ``state_reason``."""
    state_reason: str | None
    direction: str | None
    fault: Json | None
    """``code``, ``label``, ``text``, ``cause``, ``remedy`` (texts in both languages)."""
    commanded_hz: float | None
    minimum_hz: float
    maximum_hz: float
    comm_loss: CommLossView
    lease: LeaseView | None = None
    latched: bool = False
    """A bus stop forbids every start until it is released."""
    stop_pending: bool = False
    """A stop is not confirmed yet and is being repeated."""
    start_blockers: tuple[Json, ...] = ()
    """Why it may not be started now: ``{"key", "params", "text": {"en", "zh"}}`` each (interlocks, waiver, latch)."""
    alarms: Mapping[str, int] = field(default_factory=dict)
    """Active alarms by priority."""
    signals: Mapping[str, SignalView] = field(default_factory=dict)
    directions: tuple[str, ...] = ("forward", "reverse")
    """Ways in which it may be run: what the model can do, within the limits that hold now."""
    state_age_s: float | None = None
    """How old the oldest reply is that the state rests on; not in topics, where it would change all the time."""
    jog_frequency: str | None = None
    """What decides the frequency of a jog: ``drive``, ``asked`` or ``either``; None where the model can't jog."""

    def as_json(self) -> Json:
        plain: tuple[str, ...] = (
            "id",
            "bus",
            "address",
            "model",
            "grade",
            "presence",
            "state",
            "state_reason",
            "direction",
            "fault",
            "commanded_hz",
            "minimum_hz",
            "maximum_hz",
            "latched",
            "stop_pending",
            "jog_frequency",
        )
        return {name: getattr(self, name) for name in plain} | {
            "title": text_json(self.title),
            "capabilities": list(self.capabilities),
            "directions": list(self.directions),
            "groups": list(self.groups),
            "comm_loss": self.comm_loss.as_json(),
            "lease": None if self.lease is None else self.lease.as_json(),
            "start_blockers": list(self.start_blockers),
            "alarms": dict(self.alarms),
            "signals": {name: signal.as_json() for name, signal in self.signals.items()},
            "state_age_s": None if self.state_age_s is None else round(self.state_age_s, 3),
        }


@dataclass(frozen=True, slots=True)
class Sample:
    """One value for the historian."""

    tag: str
    """``<drive>.<signal>``."""
    time_ms: int
    value: float | None
    """None: a gap that is known (bad quality)."""
    quality: Quality
