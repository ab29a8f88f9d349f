"""State of one drive in an answer: its signals, its behaviour at communication loss, its control."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from pydantic import Field

from drivebus.protocols.family import JogFrequency
from drivebus.service.api.operations.operation import ApiObject, LocalizedText
from drivebus.service.api.operations.outcomes import ErrorObject
from drivebus.service.control.comm_loss_record import CommLossRecord
from drivebus.service.live.views import (
    OPEN_OBJECT,
    CommLossTestObject,
    ControlRequestObject,
    LeaseObject,
    StopObject,
)

Direction = Literal["forward", "reverse"]
PresenceName = Literal["online", "offline", "never_seen"]


class SignalObject(ApiObject):
    """Value with its quality; ``reason`` says why it is not good."""

    value: float | int | str | None
    unit: str
    quality: Literal["good", "uncertain", "bad"]
    reason: str | None
    source_time_ms: int | None


@dataclass(frozen=True, slots=True, kw_only=True)
class CommLossTestedObject(CommLossRecord):
    """Record of the last communication-loss test; it counts now where it ``holds``.

    ``parameters``: raw values by notation at that time; ``fault``: label on the keypad, else the code.
    """

    __pydantic_config__ = OPEN_OBJECT

    holds: bool


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


class DriveObject(ApiObject):
    """Present state of one drive."""

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
    above_limit_hz: float | None = Field(
        description="frequency at which it runs or to which it was set, where that is above maximum_hz"
    )
    setpoint_cap_hz: float | None = Field(
        description="highest frequency that is sent until the scale of its setpoint is calibrated; null: no cap holds"
    )
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
    poll_interval_s: float | None = Field(
        description="period of its state and its most polled signal; null: nothing is read, as while its port is lost"
    )
    requested_interval_s: float | None = Field(
        description="period that its model or the plant file asks for, shorter where the bus cannot carry it"
    )
    unusable_reply: ErrorObject | None
    jog_frequency: JogFrequency | None
