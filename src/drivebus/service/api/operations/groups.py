"""Operations on a group of drives."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from drivebus.service.api.operations.drive_view import Direction
from drivebus.service.api.operations.drives import ArmResponse, ArmToken
from drivebus.service.api.operations.operation import (
    ApiObject,
    Audit,
    Frequency,
    LocalizedText,
    Operation,
    OperationParams,
)
from drivebus.service.api.operations.outcomes import OutcomesResponse
from drivebus.service.auth.rights import Right
from drivebus.service.ids import Id
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


class GroupProgressObject(ApiObject):
    """A start that is under way: number of drives that have been started, of all."""

    started: int
    of: int


class GroupObject(ApiObject):
    """A group with its state. It accepts no frequency where ``maximum_hz`` is below ``minimum_hz``."""

    id: str
    title: LocalizedText
    drives: list[str]
    leader: str | None
    ratios: dict[str, float] = Field(description="each follower's share of the leader's frequency")
    minimum_hz: float = Field(description="by the limits of each drive at its ratio")
    maximum_hz: float = Field(description="by the limits and setpoint_cap_hz of each drive at its ratio")
    state: Literal["starting", "unknown", "running", "mixed", "stopped"]
    progress: GroupProgressObject | None


class GroupsResponse(ApiObject):
    """All groups."""

    groups: list[GroupObject]


GROUPS_LIST = Operation(
    name="groups.list",
    right=Right.VIEW,
    method="GET",
    path="/groups",
    response=GroupsResponse,
    summary=Text("All groups", "全部组"),
)

GROUP_ARM = Operation(
    name="group.arm",
    right=Right.OPERATE,
    method="POST",
    path="/groups/{group}/arm",
    params=GroupParams,
    response=ArmResponse,
    audit=Audit.REQUIRED,
    summary=Text("First step of a group's start", "组启动的第一步"),
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
    summary=Text("Start a group, one drive after another", "逐台启动一个组"),
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
    summary=Text("Change the set frequency of a group", "修改组的设定频率"),
)

GROUP_STOP = Operation(
    name="group.stop",
    right=Right.STOP,
    method="POST",
    path="/groups/{group}/stop",
    params=GroupParams,
    response=OutcomesResponse,
    audit=Audit.MEANWHILE,
    summary=Text("Stop a group", "停一个组"),
)
