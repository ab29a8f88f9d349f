"""Operations on alarms: list, history, acknowledgement and shelving."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from drivebus.service.api.operations.history import TimeRangeParams
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
from drivebus.service.api.operations.outcomes import ChangesResponse
from drivebus.service.auth.rights import Right
from drivebus.service.config.model import AlarmPriority
from drivebus.values import Text

MAX_SELECTED_ALARMS = 1000


class AlarmParams(OperationParams):
    """Raised alarm that the operation acts on, by its id in ``alarms.list``."""

    alarm: Annotated[IssuedId, Field(examples=["a3"])]


class AlarmSelectionParams(OperationParams):
    """Raised alarms that the operation acts on, by their ids in ``alarms.list``; one audit record names them all."""

    alarms: Annotated[list[IssuedId], Field(min_length=1, max_length=MAX_SELECTED_ALARMS, examples=[["a3", "a4"]])]


Minutes = Annotated[int, Field(ge=1, le=1440, examples=[60])]


class ShelveParams(AlarmParams):
    """The shelving of an alarm."""

    minutes: Minutes
    reason: Reason


class ShelveSelectionParams(AlarmSelectionParams):
    """The shelving of several alarms, for the same time and reason."""

    minutes: Minutes
    reason: Reason


class AlarmObject(ApiObject):
    """An alarm; active until it is cleared and acknowledged.

    One that is raised again unacknowledged stays one object, with a new ``id`` and ``raised_ms``.
    """

    id: str
    setting: str = Field(description="id of its table in the plant file, or its kind")
    drive: str = Field(description="empty where it concerns none; subject is then a bus, an interlock or a file")
    priority: AlarmPriority
    kind: str
    title: LocalizedText
    text: LocalizedText
    remedy: LocalizedText
    value: float | int | str | None = Field(description="what raised it")
    subject: str
    raised_ms: int
    first_id: str = Field(description="id of the first time that it was raised as this object")
    first_raised_ms: int = Field(description="raised_ms of that time")
    count: int = Field(description="number of times that it was raised as this object")
    cleared_ms: int | None
    acknowledged_ms: int | None
    acknowledged_by: str | None
    shelved_until_ms: int | None
    shelved_by: str | None
    shelved_reason: str | None
    incident: str | None = Field(description="id of its record")
    drive_replaced: bool = Field(description="a reload has since removed its drive, or given the name to another motor")


class ActiveAlarmsResponse(ApiObject):
    """All active alarms."""

    active: list[AlarmObject]


class AlarmResponse(ApiObject):
    """Alarm that was changed, by its id."""

    alarm: str


class ShelvedAlarmResponse(AlarmResponse):
    """Alarm that was shelved, and the end of it."""

    shelved_until_ms: int


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
    reduces_hazard=True,
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
    reduces_hazard=True,
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
