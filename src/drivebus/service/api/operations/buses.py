"""Operations on buses."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from drivebus.service.api.operations.operation import ApiObject, Id, Operation, OperationParams, PageSize
from drivebus.service.auth.rights import Right
from drivebus.values import Text


class BusParams(OperationParams):
    """Bus that the operation acts on."""

    bus: Annotated[Id, Field(examples=["line-1"])]


class FramesParams(BusParams):
    """Frames with a number above ``after``, of all stations or of one."""

    after: int = Field(default=0, ge=0, examples=[0])
    station: int | None = Field(default=None, ge=0, le=255, examples=[3])
    limit: PageSize = 200


class BusesResponse(ApiObject):
    """All buses."""

    buses: list[dict[str, Any]]


class FramesResponse(ApiObject):
    """Decoded frames; ``last`` is the value of ``after`` for the next request."""

    frames: list[dict[str, Any]]
    last: int


BUSES_LIST = Operation(
    name="buses.list",
    right=Right.VIEW,
    method="GET",
    path="/buses",
    response=BusesResponse,
    summary=Text("All buses: load, errors, reply times", "全部总线：负载、错误、应答时间"),
)

BUSES_GET = Operation(
    name="buses.get",
    right=Right.VIEW,
    method="GET",
    path="/buses/{bus}",
    params=BusParams,
    summary=Text("One bus", "一条总线"),
)

BUSES_FRAMES = Operation(
    name="buses.frames",
    right=Right.VIEW,
    method="GET",
    path="/buses/{bus}/frames",
    params=FramesParams,
    response=FramesResponse,
    summary=Text("Decoded frames of a bus", "一条总线上解码后的帧"),
)
