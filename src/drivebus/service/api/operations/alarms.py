"""Operations on alarms, incidents and the audit trail: what happened, and its acknowledgement."""

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
    LocalizedText,
    Name,
    Operation,
    OperationParams,
    PageResponse,
    Reason,
)
from drivebus.service.api.operations.outcomes import ChangesResponse, ExchangeObject
from drivebus.service.auth.rights import Right
from drivebus.service.config.model import AlarmPriority
from drivebus.values import Text

MAX_SELECTED_ALARMS = 1000


class AlarmParams(OperationParams):
    """Raised alarm that the operation acts on, by its id in ``alarms.list``."""

    alarm: Annotated[Name, Field(examples=["a3"])]


class AlarmSelectionParams(OperationParams):
    """Raised alarms that the operation acts on, by their ids in ``alarms.list``; one audit record names them all."""

    alarms: Annotated[list[Name], Field(min_length=1, max_length=MAX_SELECTED_ALARMS, examples=[["a3", "a4"]])]


Minutes = Annotated[int, Field(ge=1, le=1440, examples=[60])]


class ShelveParams(AlarmParams):
    """The shelving of an alarm."""

    minutes: Minutes
    reason: Reason


class ShelveSelectionParams(AlarmSelectionParams):
    """The shelving of several alarms, for the same time and reason."""

    minutes: Minutes
    reason: Reason


class IncidentParams(OperationParams):
    """Incident that the operation returns."""

    incident: Annotated[Name, Field(examples=["000017-fan-1"])]


class IncidentNoteParams(IncidentParams):
    """Note on an incident: what was found, what was done."""

    note: Reason


class AlarmObject(ApiObject):
    """An alarm; active until it is cleared and acknowledged. ``value``: what raised it; ``incident``: id of its record.

    ``setting``: id of its table in the plant file, or its ``kind``. ``drive`` is empty where it concerns none;
    ``subject`` is then a bus, an interlock or a file.
    """

    id: str
    setting: str
    drive: str
    priority: AlarmPriority
    kind: str
    title: LocalizedText
    text: LocalizedText
    remedy: LocalizedText
    value: float | int | str | None
    subject: str
    raised_ms: int
    cleared_ms: int | None
    acknowledged_ms: int | None
    acknowledged_by: str | None
    shelved_until_ms: int | None
    shelved_by: str | None
    shelved_reason: str | None
    incident: str | None


class ActiveAlarmsResponse(ApiObject):
    """All active alarms."""

    active: list[AlarmObject]


class AlarmResponse(ApiObject):
    """Alarm that was changed, by its id."""

    alarm: str


class ShelvedAlarmResponse(AlarmResponse):
    """Alarm that was shelved, and the end of it."""

    shelved_until_ms: int


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
    """An incident as it was recorded, with what was added later.

    ``raised`` and ``view`` are the alarm and the drive as that version of drivebus described them. ``parameters`` were
    read afterwards, null where that failed.
    """

    before_s: float
    raised: dict[str, Any]
    view: dict[str, Any] | None
    signals: dict[str, IncidentSeriesObject]
    states: list[IncidentStateObject]
    events: list[EventObject]
    frames: list[IncidentFrameObject]
    parameters: dict[str, ReadingObject] | None
    notes: list[IncidentNoteObject]
    capture: CaptureObject


class IncidentNotesResponse(ApiObject):
    """All notes of the incident, oldest first."""

    notes: list[IncidentNoteObject]


class AuditActorObject(ApiObject):
    """User of a record, with the session and the address of the client."""

    name: str
    session: str
    address: str | None


class AuditRecordObject(ApiObject):
    """A record with its sentences. ``of``: number of the record of the request whose outcome this is."""

    n: int
    time_ms: int
    who: AuditActorObject
    what: str
    target: str | None
    params: dict[str, Any]
    frames: list[ExchangeObject]
    outcome: str | None
    of: int | None
    hash: str
    text: LocalizedText
    outcome_text: LocalizedText | None


class AuditProblemObject(ApiObject):
    """A deviation; ``line`` 0 stands for the whole file. Its other members depend on its ``kind``."""

    kind: str
    file: str
    line: int
    text: LocalizedText


class AuditVerificationResponse(ApiObject):
    """Result of a verification of the audit trail. ``found``: number of all problems; ``problems``: the first ones.

    ``keyed``: the key was there, so that forged checkpoints are found. ``covered``: last record before a checkpoint;
    later ones can be cut off undetected. ``head``: newest checkpoint; without it removed checkpoints are not found.
    """

    ok: bool
    entries: int
    checkpoints: int
    keyed: bool
    covered: int
    head: int | None
    found: int
    problems: list[AuditProblemObject]


ALARMS_LIST = Operation(
    name="alarms.list",
    right=Right.VIEW,
    method="GET",
    path="/alarms",
    response=ActiveAlarmsResponse,
    summary=Text("Active alarms", "当前报警"),
)

ALARMS_HISTORY = Operation(
    name="alarms.history",
    right=Right.VIEW,
    method="GET",
    path="/alarms/history",
    params=TimeRangeParams,
    response=PageResponse[AlarmObject],
    summary=Text("Alarms of a time range", "一段时间内的报警"),
)

ALARM_ACKNOWLEDGE = Operation(
    name="alarm.acknowledge",
    right=Right.OPERATE,
    method="POST",
    path="/alarms/{alarm}/acknowledge",
    params=AlarmParams,
    response=AlarmResponse,
    audit=Audit.BEST_EFFORT,
    summary=Text("Acknowledge an alarm", "确认报警"),
)

ALARM_SHELVE = Operation(
    name="alarm.shelve",
    right=Right.OPERATE,
    method="POST",
    path="/alarms/{alarm}/shelve",
    params=ShelveParams,
    response=ShelvedAlarmResponse,
    audit=Audit.BEST_EFFORT,
    summary=Text("Shelve an alarm for a while", "暂时搁置报警"),
)

ALARM_UNSHELVE = Operation(
    name="alarm.unshelve",
    right=Right.OPERATE,
    method="POST",
    path="/alarms/{alarm}/unshelve",
    params=AlarmParams,
    response=AlarmResponse,
    audit=Audit.BEST_EFFORT,
    summary=Text("End the shelving of an alarm", "取消搁置"),
)

ALARMS_ACKNOWLEDGE = Operation(
    name="alarms.acknowledge",
    right=Right.OPERATE,
    method="POST",
    path="/alarms/acknowledge",
    params=AlarmSelectionParams,
    response=ChangesResponse,
    audit=Audit.BEST_EFFORT,
    summary=Text(
        "Acknowledge several alarms; `done`, `unchanged` or an error for each",
        "确认多条报警；每条的结果为 `done`、`unchanged` 或错误",
    ),
)

ALARMS_SHELVE = Operation(
    name="alarms.shelve",
    right=Right.OPERATE,
    method="POST",
    path="/alarms/shelve",
    params=ShelveSelectionParams,
    response=ChangesResponse,
    audit=Audit.BEST_EFFORT,
    summary=Text(
        "Shelve several alarms for the same time and reason; `done` or an error for each",
        "以同一时间和原因搁置多条报警；每条的结果为 `done` 或错误",
    ),
)

ALARMS_UNSHELVE = Operation(
    name="alarms.unshelve",
    right=Right.OPERATE,
    method="POST",
    path="/alarms/unshelve",
    params=AlarmSelectionParams,
    response=ChangesResponse,
    audit=Audit.BEST_EFFORT,
    summary=Text(
        "End the shelving of several alarms; `done`, `unchanged` or an error for each",
        "取消多条报警的搁置；每条的结果为 `done`、`unchanged` 或错误",
    ),
)

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

AUDIT_LIST = Operation(
    name="audit.list",
    right=Right.AUDIT,
    method="GET",
    path="/audit",
    params=TimeRangeParams,
    response=PageResponse[AuditRecordObject],
    summary=Text("The audit trail", "审计记录"),
)

AUDIT_VERIFY = Operation(
    name="audit.verify",
    right=Right.AUDIT,
    method="GET",
    path="/audit/verify",
    response=AuditVerificationResponse,
    cancellable=True,
    summary=Text("Verify that the audit trail is complete", "检查审计记录是否完整"),
)
