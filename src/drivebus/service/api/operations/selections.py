"""Operations on several drives at once: release after a bus stop, waivers."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from drivebus.service.api.operations.operation import Audit, DriveId, Operation, OperationParams, Reason
from drivebus.service.api.operations.outcomes import ChangesResponse
from drivebus.service.auth.rights import Right
from drivebus.service.ids import Id
from drivebus.values import Text

MAX_SELECTED_DRIVES = 1000


class SelectionParams(OperationParams):
    """Drives by name, those of a group, or ``all``; together where several are given."""

    drives: Annotated[list[DriveId], Field(max_length=MAX_SELECTED_DRIVES, examples=[["fan-1", "fan-2"]])] = []
    group: Id | None = Field(default=None, examples=["fans"])
    all: bool = Field(default=False, examples=[False])


class WaiversParams(SelectionParams):
    """The reason for the waivers of several drives."""

    reason: Reason


START_INHIBITS_RELEASE = Operation(
    name="start_inhibits.release",
    right=Right.OPERATE,
    method="POST",
    path="/start-inhibits/release",
    params=SelectionParams,
    response=ChangesResponse,
    audit=Audit.BEST_EFFORT,
    summary=Text(
        "Allow starts of several drives again after a bus stop; `done`, `unchanged` or an error for each",
        "总线停止之后重新允许多台变频器启动；每台的结果为 `done`、`unchanged` 或错误",
    ),
)

WAIVERS_GRANT = Operation(
    name="waivers.grant",
    right=Right.LIMIT,
    method="POST",
    path="/waivers",
    params=WaiversParams,
    response=ChangesResponse,
    audit=Audit.REQUIRED,
    summary=Text(
        "Record the same waiver for several drives; `unchanged` where a drive needs none or has one",
        "为多台变频器记录同一豁免；不需要或已有豁免的为 `unchanged`",
    ),
)
