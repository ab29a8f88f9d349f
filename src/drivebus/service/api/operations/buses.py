"""Operations on buses."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from drivebus.bus.trace import TraceKind
from drivebus.service.api.operations.drive_view import PresenceName
from drivebus.service.api.operations.operation import (
    ApiObject,
    LocalizedText,
    Operation,
    OperationParams,
    PageSize,
)
from drivebus.service.auth.rights import Right
from drivebus.service.ids import Id
from drivebus.values import Text


class BusParams(OperationParams):
    """Bus that the operation acts on."""

    bus: Annotated[Id, Field(examples=["line-1"])]


class FramesParams(BusParams):
    """Frames with a number above ``after``, of all stations or of one."""

    after: int = Field(default=0, ge=0, examples=[0])
    station: int | None = Field(default=None, ge=0, le=255, examples=[3])
    limit: PageSize = 200


class StationObject(ApiObject):
    """A drive on a bus. ``refresh_s``: longest period of what is polled; ``errors`` and ``counters`` by name."""

    address: int
    drive: str
    presence: PresenceName
    refresh_s: float | None
    error_rate: float
    reply_p50_s: float | None
    reply_p95_s: float | None
    errors: dict[str, int]
    counters: dict[str, int]
    load_percent: float


class BusObject(ApiObject):
    """A bus with its figures, which include those of its stations. ``problem``: why it is not open."""

    id: str
    title: LocalizedText
    port: str
    serial: str
    is_open: bool
    problem: LocalizedText | None
    slow_adapter: LocalizedText | None
    load_percent: float
    occupied_percent: float
    transactions_per_s: float
    error_rate: float
    transactions: int
    replies: int
    errors: dict[str, int]
    counters: dict[str, int]
    reply_p50_s: float | None
    reply_p95_s: float | None
    reply_p99_s: float | None
    foreign_master: bool
    stop_bound_s: float | None
    stations: list[StationObject]


class BusesResponse(ApiObject):
    """All buses."""

    buses: list[BusObject]


class FrameErrorObject(ApiObject):
    """Reason for the rejection of a frame."""

    code: str
    text: LocalizedText


class FrameObject(ApiObject):
    """A decoded frame: its number, UTC milliseconds, seconds of the service's monotonic clock, its bytes as hex."""

    n: int
    time_ms: int
    time_s: float
    kind: TraceKind
    station: int | None
    hex: str
    text: LocalizedText
    error: FrameErrorObject | None


class FramesResponse(ApiObject):
    """Decoded frames; ``last`` is the value of ``after`` for the next request."""

    frames: list[FrameObject]
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
    response=BusObject,
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
