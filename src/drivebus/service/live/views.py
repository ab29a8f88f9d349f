"""Views of drives, signals, leases and samples: values with their JSON.

Times are UTC milliseconds (``time_ms``) of the plant's own clock, for labels; ages are seconds of the monotonic one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from pydantic import ConfigDict

from drivebus.drives.state import Fault
from drivebus.profiles.model import FaultEntry
from drivebus.service.runtime.utc_clock import UtcClock
from drivebus.types import Json
from drivebus.values import Quality, Reading, Text

OPEN_OBJECT = ConfigDict(extra="allow")
"""Configuration of a record that is an object of the API as it stands; the API promise allows more keys."""


def text_json(text: Text | None) -> Json | None:
    return None if text is None else text.by_language()


def record_json(record: Any) -> Json | None:
    """Return a record of plain values as JSON; ``asdict`` takes eight times as long, for each view of each drive."""
    return None if record is None else {name: getattr(record, name) for name in record.__slots__}


def fault_json(fault: Fault | FaultEntry | None) -> Json | None:
    """Return a present fault of a drive, or a possible one of its model."""
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
    """A value with its quality. ``source_time_ms`` is the UTC time of its reply, None: never read."""

    value: float | int | str | None
    unit: str
    quality: Quality
    reason: str | None
    """i18n key."""
    source_time_ms: int | None

    @classmethod
    def of(cls, reading: Reading, clock: UtcClock) -> SignalView:
        return cls(reading.value, reading.unit, reading.quality, reading.reason, clock.utc_ms(reading.source_time))

    def as_json(self) -> Json:
        return {
            "value": self.value,
            "unit": self.unit,
            "quality": str(self.quality),
            "reason": self.reason,
            "source_time_ms": self.source_time_ms,
        }


@dataclass(frozen=True, slots=True)
class CommLossTestObject:
    """Communication-loss test that is under way; the silence ends at ``until_ms``, null in other phases."""

    __pydantic_config__ = OPEN_OBJECT

    phase: Literal["starting", "turning", "silent", "reading"]
    until_ms: int | None


@dataclass(frozen=True, slots=True, kw_only=True)
class CommLossView:
    """Behaviour of a drive at communication loss. ``kind``: ``trips``, ``runs_on`` or ``unknown``."""

    kind: str
    after_s: float | None
    text: Text
    waiver: str | None = None
    """Reason and author of a waiver that permits starts, None: no waiver."""

    tested: Json | None = None
    """Record of the last test, and whether it ``holds``: whether the parameters still read as they did then."""
    test: CommLossTestObject | None = None
    """Test that is under way."""
    no_result: Json | None = None
    """Why the last test ended without a result, in both languages; None after another one, and after a restart."""

    def as_json(self) -> Json:
        return {
            "kind": self.kind,
            "after_s": self.after_s,
            "text": text_json(self.text),
            "waiver": self.waiver,
            "tested": self.tested,
            "test": record_json(self.test),
            "no_result": self.no_result,
        }


StopKind = Literal["drive", "group", "all", "jog", "test", "automatic", "service"]
"""Kind of a stop: of one drive, its group, everything, a jog, a communication-loss test, by the service itself
(interlock, ``on_client_lost``, ``on_restart``), the service's own end."""


@dataclass(frozen=True, slots=True)
class StopObject:
    """Last stop request of a drive by drivebus, until it is started again; ``actor``: its user, or ``drivebus``."""

    __pydantic_config__ = OPEN_OBJECT

    kind: StopKind
    actor: str
    time_ms: int


@dataclass(frozen=True, slots=True)
class LeaseObject:
    """The session that may command the drive."""

    __pydantic_config__ = OPEN_OBJECT

    owner: str
    """Name of a user of the plant, or of the machine where the session is not ``remote``."""
    session: str
    remote: bool
    """False for the command line on the service's machine."""
    expires_ms: int
    """UTC time at which it ends unless it is renewed."""


ControlRequestState = Literal["open", "granted", "declined", "expired", "withdrawn", "released"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlRequestObject:
    """Newest request for control of the drive, until 60 s after its end. ``answered_by``: who granted or declined it.

    ``released``: no session has control any more; ``withdrawn``: by the session that asked, or because it took control.
    """

    __pydantic_config__ = OPEN_OBJECT

    id: str
    user: str
    session: str
    reason: str | None
    state: ControlRequestState
    requested_ms: int
    expires_ms: int
    answered_by: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveView:
    """Present state of one drive; topic ``drives/<id>``."""

    id: str
    title: Text
    bus: str
    address: int
    model: str
    grade: str
    capabilities: tuple[str, ...]
    groups: tuple[str, ...]
    presence: str
    """``online``, ``offline`` or ``never_seen``."""
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
    lease: LeaseObject | None = None
    control_request: ControlRequestObject | None = None
    start_inhibited: bool = False
    """Whether a bus stop inhibits every start until it is released."""
    last_stop: StopObject | None = None
    """Its last stop request by drivebus, None: none since its last start."""
    stop_pending: bool = False
    """Whether a stop is not confirmed yet and is being repeated."""
    start_blockers: tuple[Json, ...] = ()
    """Reasons against a start now, each ``{"key", "params", "text": {"en", "zh"}}`` (interlocks, waiver, inhibit)."""
    alarms: Mapping[str, int] = field(default_factory=dict)
    """Alarms by priority whose condition holds, without shelved ones."""
    signals: Mapping[str, SignalView] = field(default_factory=dict)
    directions: tuple[str, ...] = ("forward", "reverse")
    """Directions in which it may run: those of the model, within the present limits."""
    time_ms: int = field(default=0, compare=False)
    """UTC time of this view; not in topics, which are published only when they change."""
    state_time_ms: int | None = None
    """UTC time of the oldest reply on which the state rests."""
    poll_interval_s: float | None = None
    """Seconds between two polls of its most polled signal; None: nothing is polled, as while its port is lost."""
    requested_interval_s: float | None = None
    """Seconds that its model, or ``signals`` of the plant file, requests; fewer than ``poll_interval_s`` where the bus
    cannot carry that.
    """
    unusable_reply: Json | None = None
    """Error that names what a drive sends while it is not online; None: it sends nothing."""
    above_limit_hz: float | None = None
    """Frequency at which it runs or to which it was set, where that is above ``maximum_hz``."""
    setpoint_cap_hz: float | None = None
    """Highest frequency that is sent while the scale of its setpoint is not determined; None: no cap holds."""
    jog_frequency: str | None = None
    """Where the frequency of a jog comes from: a ``JogFrequency``; None where the model can't jog."""

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
            "above_limit_hz",
            "setpoint_cap_hz",
            "start_inhibited",
            "stop_pending",
            "poll_interval_s",
            "requested_interval_s",
            "unusable_reply",
            "jog_frequency",
            "time_ms",
            "state_time_ms",
        )
        return {name: getattr(self, name) for name in plain} | {
            "title": text_json(self.title),
            "capabilities": list(self.capabilities),
            "directions": list(self.directions),
            "groups": list(self.groups),
            "comm_loss": self.comm_loss.as_json(),
            "last_stop": record_json(self.last_stop),
            "lease": record_json(self.lease),
            "control_request": record_json(self.control_request),
            "start_blockers": list(self.start_blockers),
            "alarms": dict(self.alarms),
            "signals": {name: signal.as_json() for name, signal in self.signals.items()},
        }


@dataclass(frozen=True, slots=True)
class Sample:
    """Value for the historian."""

    tag: str
    """``<drive>.<signal>``."""
    time_ms: int
    value: float | None
    """None: a gap that is known (bad quality)."""
    quality: Quality
