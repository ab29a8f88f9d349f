"""Operations on the control of a drive: leases, and requests to the session that has one."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from drivebus.service.api.operations.drives import DriveParams
from drivebus.service.api.operations.operation import ApiObject, Audit, EmptyResponse, IssuedId, Operation, Reason
from drivebus.service.api.operations.outcomes import ChangesResponse
from drivebus.service.api.operations.selections import SelectionParams
from drivebus.service.auth.rights import Right
from drivebus.service.live.views import ControlRequestObject, LeaseObject
from drivebus.values import Text


class ControlRequestParams(DriveParams):
    """A request for control, to the session that has it."""

    reason: Reason | None = None


class ControlRequestsParams(SelectionParams):
    """A request for control of several drives, to each session that has it."""

    reason: Reason | None = None


class ControlAnswerParams(DriveParams):
    """Request for control that is answered, by its ``id``: a later one is not answered by mistake."""

    request: Annotated[IssuedId, Field(examples=["request-7"])]


class LeaseResponse(ApiObject):
    """A control lease, its full duration in seconds, and the open request for control, if any."""

    lease: LeaseObject
    ttl_s: float
    control_request: ControlRequestObject | None


LEASE_TAKE = Operation(
    name="lease.take",
    right=Right.OPERATE,
    method="POST",
    path="/drives/{drive}/lease",
    params=DriveParams,
    response=LeaseResponse,
    audit=Audit.BEST_EFFORT,
    summary=Text(
        "Take control of a drive: only this session may command it", "取得一台变频器的控制权，只有本会话可以命令它"
    ),
)

LEASE_RENEW = Operation(
    name="lease.renew",
    right=Right.STOP,  # a session that became idle in front of a running drive keeps it, and may stop it
    method="POST",
    path="/drives/{drive}/lease/renew",
    params=DriveParams,
    response=LeaseResponse,
    keepalive=True,
    background=True,
    summary=Text("Keep control of a drive for ten seconds more", "把控制权再保持十秒"),
)

LEASE_RELEASE = Operation(
    name="lease.release",
    right=Right.OPERATE,
    method="DELETE",
    path="/drives/{drive}/lease",
    params=DriveParams,
    response=EmptyResponse,
    audit=Audit.BEST_EFFORT,
    reduces_hazard=True,
    summary=Text("Release control of a drive", "交还控制权"),
)

CONTROL_REQUEST_MAKE = Operation(
    name="control_request.make",
    right=Right.OPERATE,
    method="POST",
    path="/drives/{drive}/control-request",
    params=ControlRequestParams,
    response=LeaseResponse,
    audit=Audit.BEST_EFFORT,
    summary=Text(
        "Ask the session that controls a drive for its control; the request ends after 60 s without an answer. "
        "The answer is in `control_request` of the drive",
        "向控制某台变频器的会话请求移交控制权；60 s 内无答复即失效。答复见该变频器的 `control_request`",
    ),
)

CONTROL_REQUEST_GRANT = Operation(
    name="control_request.grant",
    right=Right.OPERATE,
    method="POST",
    path="/drives/{drive}/control-request/grant",
    params=ControlAnswerParams,
    response=EmptyResponse,
    audit=Audit.BEST_EFFORT,
    summary=Text(
        "Hand control of a drive over to the session that asks for it; the drive goes on as it is",
        "把控制权移交给提出请求的会话；变频器保持原状态",
    ),
)

CONTROL_REQUEST_DECLINE = Operation(
    name="control_request.decline",
    right=Right.OPERATE,
    method="POST",
    path="/drives/{drive}/control-request/decline",
    params=ControlAnswerParams,
    response=EmptyResponse,
    audit=Audit.BEST_EFFORT,
    summary=Text("Keep control of a drive: decline the request for it", "保留控制权：谢绝移交请求"),
)

CONTROL_REQUEST_WITHDRAW = Operation(
    name="control_request.withdraw",
    right=Right.OPERATE,
    method="DELETE",
    path="/drives/{drive}/control-request",
    params=DriveParams,
    response=EmptyResponse,
    audit=Audit.BEST_EFFORT,
    summary=Text("Withdraw this session's request for control", "撤回本会话的移交请求"),
)

CONTROL_REQUESTS_MAKE = Operation(
    name="control_requests.make",
    right=Right.OPERATE,
    method="POST",
    path="/control-requests",
    params=ControlRequestsParams,
    response=ChangesResponse,
    audit=Audit.BEST_EFFORT,
    summary=Text(
        "Ask each session that controls one of these drives for its control, as one request: its `id` is the same for "
        "all; `done`, `unchanged` where it is the session's own, or an error for each",
        "向控制这些变频器的各会话请求移交控制权，作为同一请求（`id` 相同）；"
        "每台的结果为 `done`、`unchanged`（已由本会话控制）或错误",
    ),
)

CONTROL_REQUESTS_WITHDRAW = Operation(
    name="control_requests.withdraw",
    right=Right.OPERATE,
    method="POST",
    path="/control-requests/withdraw",
    params=SelectionParams,
    response=ChangesResponse,
    audit=Audit.BEST_EFFORT,
    summary=Text(
        "Withdraw this session's requests for control of these drives; `done` or `unchanged` for each",
        "撤回本会话对这些变频器的移交请求；每台的结果为 `done` 或 `unchanged`",
    ),
)
