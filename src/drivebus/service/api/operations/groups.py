"""Operations on a group of drives."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from drivebus.service.api.operations.drives import ArmResponse, ArmToken, Direction
from drivebus.service.api.operations.operation import (
    ApiObject,
    Audit,
    Frequency,
    Id,
    Operation,
    OperationParams,
)
from drivebus.service.auth.rights import Right
from drivebus.values import Text


class GroupParams(OperationParams):
    """Group that the operation acts on."""

    group: Annotated[Id, Field(examples=["fans"])]


class GroupStartParams(GroupParams):
    """A start of a group. The frequency is the leader's, or every drive's where the group has no leader."""

    frequency_hz: Frequency
    direction: Direction | None = Field(default=None, examples=["forward"])
    arm_token: ArmToken = None


class GroupSetFrequencyParams(GroupParams):
    """A new setpoint of a group."""

    frequency_hz: Frequency


class GroupsResponse(ApiObject):
    """All groups."""

    groups: list[dict[str, Any]]


class OutcomesResponse(ApiObject):
    """An outcome or an error for each drive."""

    outcomes: dict[str, dict[str, Any]]


GROUPS_LIST = Operation(
    name="groups.list",
    right=Right.VIEW,
    method="GET",
    path="/groups",
    response=GroupsResponse,
    summary=Text("All groups", "全部分组"),
)

GROUP_ARM = Operation(
    name="group.arm",
    right=Right.OPERATE,
    method="POST",
    path="/groups/{group}/arm",
    params=GroupParams,
    response=ArmResponse,
    audit=Audit.REQUIRED,
    summary=Text("First step of a group's start", "分组启动的第一步"),
)

GROUP_START = Operation(
    name="group.start",
    right=Right.OPERATE,
    method="POST",
    path="/groups/{group}/start",
    params=GroupStartParams,
    response=OutcomesResponse,
    audit=Audit.REQUIRED,
    moves_motors=True,
    summary=Text("Start a group, one drive after another", "逐台启动一个分组"),
)

GROUP_SET_FREQUENCY = Operation(
    name="group.set_frequency",
    right=Right.OPERATE,
    method="POST",
    path="/groups/{group}/set-frequency",
    params=GroupSetFrequencyParams,
    response=OutcomesResponse,
    audit=Audit.BEST_EFFORT,
    moves_motors=True,
    summary=Text("Change the set frequency of a group", "修改分组的设定频率"),
)

GROUP_STOP = Operation(
    name="group.stop",
    right=Right.STOP,
    method="POST",
    path="/groups/{group}/stop",
    params=GroupParams,
    response=OutcomesResponse,
    audit=Audit.AFTER,
    summary=Text("Stop a group", "停一个分组"),
)
