"""Operations of the communication-loss test of a drive."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from drivebus.service.api.operations.drives import ArmToken, DriveParams
from drivebus.service.api.operations.operation import Audit, EmptyResponse, Frequency, Operation
from drivebus.service.api.operations.outcomes import OutcomeResponse
from drivebus.service.auth.rights import Right
from drivebus.values import Text


class CommLossTestParams(DriveParams):
    """A test. ``arm_token`` comes from ``drive.arm`` with the purpose ``comm_loss_test``; a remote test needs it.

    ``silence_s``: seconds without a request to the drive; null: its communication-loss time and 3 s, or 18 s where that
    can't be read.
    """

    frequency_hz: Frequency
    silence_s: Annotated[float, Field(ge=2.0, le=300.0, allow_inf_nan=False)] | None = Field(
        default=None, examples=[8.0]
    )
    arm_token: ArmToken = None


class CommLossTestResponse(OutcomeResponse):
    """Outcome of the start, and the seconds of silence that follow; the result appears in the drive's ``comm_loss``."""

    silence_s: float


COMM_LOSS_TEST = Operation(
    name="comm_loss.test",
    right=Right.LIMIT,
    method="POST",
    path="/drives/{drive}/comm-loss-test",
    params=CommLossTestParams,
    response=CommLossTestResponse,
    audit=Audit.REQUIRED,
    moves_motors=True,
    summary=Text(
        "Test the communication loss: start the drive, send it nothing, read and record what it did, stop it",
        "试验通信中断：启动变频器，停止发送，读取并记录其动作，然后停机",
    ),
)

COMM_LOSS_TEST_READ = Operation(
    name="comm_loss.test_read",
    right=Right.LIMIT,
    method="POST",
    path="/drives/{drive}/comm-loss-test/read",
    params=DriveParams,
    response=EmptyResponse,
    audit=Audit.BEST_EFFORT,
    summary=Text(
        "The motor was seen to stop: end the silence of a test and read the drive",
        "已看到电机停下：结束试验的静默并读取变频器",
    ),
)

COMM_LOSS_TEST_DISCARD = Operation(
    name="comm_loss.discard",
    right=Right.LIMIT,
    method="DELETE",
    path="/drives/{drive}/comm-loss-test",
    params=DriveParams,
    response=EmptyResponse,
    audit=Audit.REQUIRED,
    summary=Text("Discard the record of a communication-loss test", "删除通信中断试验的记录"),
)
