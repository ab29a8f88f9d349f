"""Operations on alarms, incidents and the audit trail: what happened, and its acknowledgement."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from drivebus.service.api.operations.history import TimeRangeParams
from drivebus.service.api.operations.operation import (
    ApiObject,
    Audit,
    Name,
    Operation,
    OperationParams,
    PageResponse,
    Reason,
)
from drivebus.service.auth.rights import Right
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


class ActiveAlarmsResponse(ApiObject):
    """All active alarms."""

    active: list[dict[str, Any]]


class AlarmOutcomesResponse(ApiObject):
    """Result for each alarm by its id: ``done``, ``unchanged``, or an error; another user may have been faster."""

    outcomes: dict[str, dict[str, Any]]


class AuditVerificationResponse(ApiObject):
    """Result of a verification of the audit trail."""

    ok: bool
    entries: int
    problems: list[dict[str, Any]]


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
    response=PageResponse,
    summary=Text("Alarms of a time range", "一段时间内的报警"),
)

ALARM_ACKNOWLEDGE = Operation(
    name="alarm.acknowledge",
    right=Right.OPERATE,
    method="POST",
    path="/alarms/{alarm}/acknowledge",
    params=AlarmParams,
    audit=Audit.BEST_EFFORT,
    summary=Text("Acknowledge an alarm", "确认报警"),
)

ALARM_SHELVE = Operation(
    name="alarm.shelve",
    right=Right.OPERATE,
    method="POST",
    path="/alarms/{alarm}/shelve",
    params=ShelveParams,
    audit=Audit.BEST_EFFORT,
    summary=Text("Shelve an alarm for a while", "暂时搁置报警"),
)

ALARM_UNSHELVE = Operation(
    name="alarm.unshelve",
    right=Right.OPERATE,
    method="POST",
    path="/alarms/{alarm}/unshelve",
    params=AlarmParams,
    audit=Audit.BEST_EFFORT,
    summary=Text("End the shelving of an alarm", "取消搁置"),
)

ALARMS_ACKNOWLEDGE = Operation(
    name="alarms.acknowledge",
    right=Right.OPERATE,
    method="POST",
    path="/alarms/acknowledge",
    params=AlarmSelectionParams,
    response=AlarmOutcomesResponse,
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
    response=AlarmOutcomesResponse,
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
    response=AlarmOutcomesResponse,
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
    response=PageResponse,
    summary=Text("Recorded incidents", "已记录的故障停机"),
)

INCIDENTS_GET = Operation(
    name="incidents.get",
    right=Right.VIEW,
    method="GET",
    path="/incidents/{incident}",
    params=IncidentParams,
    summary=Text("One incident with everything recorded around it", "一次故障停机及当时的全部记录"),
)

INCIDENT_NOTE = Operation(
    name="incident.note",
    right=Right.OPERATE,
    method="POST",
    path="/incidents/{incident}/notes",
    params=IncidentNoteParams,
    audit=Audit.BEST_EFFORT,
    summary=Text("Add a note to an incident", "为故障停机记录添加备注"),
)

AUDIT_LIST = Operation(
    name="audit.list",
    right=Right.AUDIT,
    method="GET",
    path="/audit",
    params=TimeRangeParams,
    response=PageResponse,
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
