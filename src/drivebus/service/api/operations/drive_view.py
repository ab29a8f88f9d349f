"""State of one drive in an answer: its signals, its behaviour at communication loss, its control."""

from __future__ import annotations

from typing import Any, Literal

from drivebus.protocols.family import JogFrequency
from drivebus.service.api.operations.operation import ApiObject, LocalizedText
from drivebus.service.api.operations.outcomes import ErrorObject
from drivebus.service.control.comm_loss_record import CommLossResult
from drivebus.service.live.views import ControlRequestState, StopKind

Direction = Literal["forward", "reverse"]
PresenceName = Literal["online", "offline", "never_seen"]


class SignalObject(ApiObject):
    """Value with its quality; ``reason`` says why it is not good."""

    value: float | int | str | None
    unit: str
    quality: Literal["good", "uncertain", "bad"]
    reason: str | None
    source_time_ms: int | None


class CommLossTestedObject(ApiObject):
    """Record of the last communication-loss test; it counts now where it ``holds``.

    ``parameters``: raw values by notation at that time; ``fault``: label on the keypad.
    """

    result: CommLossResult
    silence_s: float
    time_ms: int
    user: str
    model: str
    link: str
    address: int
    parameters: dict[str, int]
    fault: str | None
    holds: bool


class CommLossTestObject(ApiObject):
    """Communication-loss test that is under way; the silence ends at ``until_ms``, null in other phases."""

    phase: Literal["starting", "turning", "silent", "reading"]
    until_ms: int | None


class CommLossObject(ApiObject):
    """Behaviour of the drive when its communication fails. ``no_result``: why the last test ended without one."""

    kind: Literal["trips", "runs_on", "unknown"]
    after_s: float | None
    text: LocalizedText | None
    waiver: str | None = None
    tested: CommLossTestedObject | None = None
    test: CommLossTestObject | None = None
    no_result: LocalizedText | None = None


class FaultObject(ApiObject):
    """Fault that a drive reports, or that its model may report. ``label`` is what the keypad shows."""

    code: int
    label: str
    text: LocalizedText
    cause: LocalizedText | None
    remedy: LocalizedText | None


class StartBlockerObject(ApiObject):
    """Reason against a start now; ``params`` are those of its sentence."""

    key: str
    params: dict[str, Any]
    text: LocalizedText


class StopObject(ApiObject):
    """Last stop request of a drive by drivebus, until it is started again; ``actor``: its user, or ``drivebus``."""

    kind: StopKind
    actor: str
    time_ms: int


class LeaseObject(ApiObject):
    """The session that may command the drive."""

    owner: str
    session: str
    expires_ms: int


class ControlRequestObject(ApiObject):
    """Newest request for control of the drive, until 60 s after its end. ``answered_by``: who granted or declined it.

    ``released``: no session has control any more; ``withdrawn``: by the session that asked, or because it took control.
    """

    id: str
    user: str
    session: str
    reason: str | None
    state: ControlRequestState
    requested_ms: int
    expires_ms: int
    answered_by: str | None


class DriveObject(ApiObject):
    """Present state of one drive.

    Its state and its most polled signal are read every ``poll_interval_s``; ``requested_interval_s`` is the period that
    its model or ``signals`` of the plant file asks for, which is shorter where the bus cannot carry it.
    """

    id: str
    title: LocalizedText | None
    bus: str
    address: int
    model: str
    grade: str
    capabilities: list[str]
    directions: list[str]
    groups: list[str]
    presence: PresenceName
    state: str
    state_reason: str | None
    direction: Direction | None
    fault: FaultObject | None
    commanded_hz: float | None
    minimum_hz: float
    maximum_hz: float
    comm_loss: CommLossObject
    lease: LeaseObject | None
    control_request: ControlRequestObject | None
    start_inhibited: bool
    last_stop: StopObject | None
    stop_pending: bool
    start_blockers: list[StartBlockerObject]
    alarms: dict[str, int]
    signals: dict[str, SignalObject]
    time_ms: int
    state_time_ms: int | None
    poll_interval_s: float | None
    requested_interval_s: float | None
    unusable_reply: ErrorObject | None
    jog_frequency: JogFrequency | None
