"""Operations on incidents: what was recorded around a trip, and notes on it."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from drivebus.service.api.operations.buses import FrameObject
from drivebus.service.api.operations.drive_view import FaultObject
from drivebus.service.api.operations.drives import ReadingObject
from drivebus.service.api.operations.history import EventObject, TimeRangeParams
from drivebus.service.api.operations.operation import (
    ApiObject,
    Audit,
    IssuedId,
    LocalizedText,
    Operation,
    OperationParams,
    PageResponse,
    Reason,
)
from drivebus.service.auth.rights import Right
from drivebus.values import Text


class IncidentParams(OperationParams):
    """Incident that the operation returns."""

    incident: Annotated[IssuedId, Field(examples=["000017-fan-1"])]


class IncidentNoteParams(IncidentParams):
    """Note on an incident: what was found, what was done."""

    note: Reason


class IncidentSummaryObject(ApiObject):
    """An incident: the alarm that recorded it, with ``why`` as its kind."""

    id: str
    time_ms: int
    drive: str
    bus: str | None
    why: str
    alarm: str
    title: LocalizedText
    text: LocalizedText


class IncidentSeriesObject(ApiObject):
    """Samples of a signal: seconds before the incident, values, and quality (0 good, 1 uncertain, 2 bad)."""

    t: list[float]
    v: list[float | None]
    q: list[int]


class IncidentStateObject(ApiObject):
    """A state of the drive, and from when on it had it, in seconds before the incident."""

    t: float
    state: str
    direction: str | None
    presence: str
    fault: FaultObject | None
    commanded_hz: float | None


class IncidentFrameObject(FrameObject):
    """A frame on the bus of the drive; ``t`` in seconds before the incident."""

    t: float


class IncidentNoteObject(ApiObject):
    """A note on an incident."""

    time_ms: int
    by: str
    text: str


class CaptureObject(ApiObject):
    """The frames as a capture file."""

    name: str
    text: str


class IncidentResponse(IncidentSummaryObject):
    """An incident as it was recorded, with what was added later."""

    before_s: float
    raised: dict[str, Any] = Field(description="the alarm, as the recording version of drivebus described it")
    view: dict[str, Any] | None = Field(description="the drive, as the recording version of drivebus described it")
    signals: dict[str, IncidentSeriesObject]
    states: list[IncidentStateObject]
    events: list[EventObject]
    frames: list[IncidentFrameObject]
    parameters: dict[str, ReadingObject] | None = Field(description="read afterwards, null where that failed")
    notes: list[IncidentNoteObject]
    capture: CaptureObject | None = Field(description="null where its file can't be read")
    capture_problem: LocalizedText | None = Field(description="reason why capture is null")


class IncidentNotesResponse(ApiObject):
    """All notes of the incident, oldest first."""

    notes: list[IncidentNoteObject]


INCIDENTS_LIST = Operation(
    name="incidents.list",
    right=Right.VIEW,
    method="GET",
    path="/incidents",
    params=TimeRangeParams,
    response=PageResponse[IncidentSummaryObject],
    summary=Text("Recorded incidents", "已有的故障记录"),
)

INCIDENTS_GET = Operation(
    name="incidents.get",
    right=Right.VIEW,
    method="GET",
    path="/incidents/{incident}",
    params=IncidentParams,
    response=IncidentResponse,
    summary=Text("One incident with everything recorded around it", "一份故障记录及当时的全部内容"),
)

INCIDENT_NOTE = Operation(
    name="incident.note",
    right=Right.OPERATE,
    method="POST",
    path="/incidents/{incident}/notes",
    params=IncidentNoteParams,
    response=IncidentNotesResponse,
    audit=Audit.BEST_EFFORT,
    summary=Text("Add a note to an incident", "为故障记录添加备注"),
)
