"""Operations on one drive: its state, parameters, motion, limits and waiver."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, StringConstraints
from pydantic_core import PydanticKnownError

from drivebus.drives.operations.hold import MAX_RAMP_HOLD_S
from drivebus.service.api.operations.drive_view import Direction, DriveObject
from drivebus.service.api.operations.models import ProfileObject
from drivebus.service.api.operations.operation import (
    PRINTABLE_PATTERN,
    ApiObject,
    Audit,
    DriveId,
    EmptyResponse,
    Frequency,
    IssuedId,
    LocalizedText,
    Name,
    Operation,
    OperationParams,
    Reason,
    require_printable,
)
from drivebus.service.api.operations.outcomes import ErrorObject, OutcomeObject, OutcomeResponse
from drivebus.service.auth.rights import Right
from drivebus.values import Text

ArmToken = Annotated[IssuedId | None, Field(examples=["5b1f0c52d1"])]


class DriveParams(OperationParams):
    """Drive that the operation acts on."""

    drive: DriveId


class RunParams(DriveParams):
    """A start. ``arm_token`` comes from ``drive.arm``, at most 10 s before; a remote start needs it."""

    frequency_hz: Frequency
    direction: Direction | None = Field(default=None, examples=["forward"])
    arm_token: ArmToken = None


class ArmParams(DriveParams):
    """First step of a start, or of a communication-loss test; the token is valid for that one only."""

    purpose: Literal["start", "comm_loss_test"] = Field(default="start", examples=["start"])


class SetFrequencyParams(DriveParams):
    """A new setpoint."""

    frequency_hz: Frequency


class RampHoldParams(DriveParams):
    """Time in seconds for which the output frequency stays where it is: 0.1 to 10."""

    seconds: Annotated[float, Field(ge=0.1, le=MAX_RAMP_HOLD_S, examples=[5.0])]


class StopParams(DriveParams):
    """A stop. ``assume_model``: send it also to a station that has not answered as the plant's model."""

    how: Literal["stop", "coast", "quick_stop"] = Field(default="stop", examples=["stop"])
    assume_model: bool = Field(default=False, examples=[False])


class JogParams(DriveParams):
    """A jog. It is a start: ``arm_token`` as for ``RunParams``."""

    direction: Direction = Field(default="forward", examples=["forward"])
    frequency_hz: Frequency | None = Field(default=None, examples=[25.0])
    arm_token: ArmToken = None


class ActiveJogParams(DriveParams):
    """A jog under way; ``jog`` comes from ``drive.jog``."""

    jog: Annotated[IssuedId, Field(examples=["jog-4"])]


class WaiverParams(DriveParams):
    """The reason for a waiver."""

    reason: Reason


class LimitsParams(DriveParams):
    """Frequency range in hertz and permitted directions. None has a default, which would loosen a limit left out."""

    minimum_hz: Annotated[Frequency, Field(examples=[5.0])]
    maximum_hz: Annotated[Frequency | None, Field(examples=[50.0])]
    forward: Annotated[bool, Field(examples=[True])]
    reverse: Annotated[bool, Field(examples=[False])]


class ParameterReadParams(DriveParams):
    """Parameters to read, by notation or name."""

    names: Annotated[list[Name], Field(min_length=1, max_length=64, examples=[["F0.1", "F1.07"]])]


LOOPBACK_TIMEOUT_S = 10  # of one test: other reads of its bus wait for the end


class LoopbackParams(DriveParams):
    """Number of loop-back requests, 1 to 100."""

    count: Annotated[int, Field(ge=1, le=100, examples=[10])] = 10


MAX_WRITES = 64  # parameters of one request


def _check_number_of_writes(values: Any) -> Any:
    """Check the number of values before each of them: pydantic would do it after all."""
    if isinstance(values, dict) and len(values) > MAX_WRITES:
        raise PydanticKnownError(
            "too_long", {"field_type": "Dictionary", "max_length": MAX_WRITES, "actual_length": len(values)}
        )
    return values


WordText = Annotated[str, StringConstraints(max_length=6, pattern="^[0-9][0-9A-FXHa-fxh]*$")]


class ParameterWriteParams(DriveParams):
    """Parameters to write.

    A value is a number in the unit of the parameter, or a text: ``0010H`` and ``0x10`` are the raw word, ``0010`` the
    digits of a keypad.
    """

    values: Annotated[
        dict[
            Annotated[str, Field(min_length=1, max_length=100), AfterValidator(require_printable)],
            Annotated[float, Field(allow_inf_nan=False)] | WordText,
        ],
        Field(
            min_length=1,
            max_length=MAX_WRITES,
            examples=[{"F1.07": 12.5}],
            json_schema_extra={"propertyNames": {"minLength": 1, "maxLength": 100, "pattern": PRINTABLE_PATTERN}},
        ),
        BeforeValidator(_check_number_of_writes),
    ]
    save: bool = Field(
        default=False, examples=[False], description="write to EEPROM too, which needs the right save as well"
    )
    force: bool = Field(
        default=False, examples=[False], description="confirm a write that ConfirmationRequired refuses otherwise"
    )


class DrivesResponse(ApiObject):
    """All drives."""

    drives: list[DriveObject]


class StatisticsObject(ApiObject):
    """Counts of one drive since ``since_ms``; null: not known. ``faults``: number of each by its code."""

    running_h: float | None
    starts: int | None
    energy_kwh: float | None
    maximum_current_a: float | None
    maximum_temperature_c: float | None
    faults: dict[str, int]
    since_ms: int | None


class ReadingObject(ApiObject):
    """Reading of a parameter: its raw word, its value, wire address and text. ``reason`` says why it is not good."""

    raw: int | None
    value: float | int | str | None
    unit: str
    quality: Literal["good", "uncertain", "bad"]
    reason: str | None
    address_hex: str | None
    text: LocalizedText | None


class ParametersResponse(ApiObject):
    """Readings of parameters by the names that were given; in ``refused`` the error of each that the model lacks."""

    parameters: dict[str, ReadingObject]
    refused: dict[str, ErrorObject]


class IdentityResponse(ApiObject):
    """Identity that the drive reports: voltage class, power, the digits of each part, and what the bus controls."""

    voltage_class_v: int | None
    power_kw: float | None
    digits: dict[str, str]
    host_controls: bool | None
    host_sets_frequency: bool | None


class LoopbackResponse(ApiObject):
    """Result of a loop-back test: requests sent, round trips of those returned, repetitions, and the last error.

    ``complete`` is false where the time limit ended the test before its last request; ``text`` says all of it.
    """

    requests: int
    round_trips_ms: list[float]
    repetitions: int
    error: ErrorObject | None
    complete: bool
    text: LocalizedText


class ArmResponse(ApiObject):
    """The second step of a start needs ``arm_token`` within ``expires_s`` seconds."""

    arm_token: str
    expires_s: float


class CommandResponse(OutcomeResponse):
    """Result of a command, and of the share of its frequency for each running follower of the drive."""

    followers: dict[str, OutcomeObject | ErrorObject]


class JogResponse(ApiObject):
    """The motor turns while ``jog`` is renewed within ``lease_s`` seconds."""

    jog: str
    lease_s: float
    outcome: OutcomeObject


class JogRenewResponse(ApiObject):
    """Seconds within which the jog must be renewed again; ``remark`` where the drive reports the other direction."""

    lease_s: float
    remark: LocalizedText | None


class WaiverResponse(ApiObject):
    """Text of the waiver, with its author."""

    waiver: str


class LimitsResponse(ApiObject):
    """Frequency range in force: the limits that were set, within those of the plant file and the model.

    ``note``: that the drive runs above it now, which slows no motor, or null.
    """

    minimum_hz: float
    maximum_hz: float
    note: LocalizedText | None


DRIVES_LIST = Operation(
    name="drives.list",
    right=Right.VIEW,
    method="GET",
    path="/drives",
    response=DrivesResponse,
    summary=Text("Present state of all drives", "全部变频器的当前状态"),
)

DRIVES_GET = Operation(
    name="drives.get",
    right=Right.VIEW,
    method="GET",
    path="/drives/{drive}",
    params=DriveParams,
    response=DriveObject,
    summary=Text("Present state of one drive", "一台变频器的当前状态"),
)

DRIVES_PROFILE = Operation(
    name="drives.profile",
    right=Right.VIEW,
    method="GET",
    path="/drives/{drive}/profile",
    params=DriveParams,
    response=ProfileObject,
    summary=Text(
        "Profile of a drive: signals, parameters, faults, caveats", "变频器的型号文件：信号、参数、故障、注意事项"
    ),
)

DRIVES_STATISTICS = Operation(
    name="drives.statistics",
    right=Right.VIEW,
    method="GET",
    path="/drives/{drive}/statistics",
    params=DriveParams,
    response=StatisticsObject,
    summary=Text("Hours, starts, energy and faults of a drive", "一台变频器的运行时间、启动次数、电能和故障"),
)

PARAMETERS_READ = Operation(
    name="parameters.read",
    right=Right.OPERATE,
    method="POST",
    path="/drives/{drive}/parameters/read",
    params=ParameterReadParams,
    response=ParametersResponse,
    summary=Text(
        "Read parameters over the bus. A name that the model does not have is in `refused`, with its error and similar "
        "names; the others are read",
        "通过总线读参数。型号没有的名称列在 `refused` 中，附错误和相近的名称；其余照常读取",
    ),
)

IDENTITY_READ = Operation(
    name="identity.read",
    right=Right.OPERATE,
    method="POST",
    path="/drives/{drive}/identity/read",
    params=DriveParams,
    response=IdentityResponse,
    summary=Text("Read over the bus what the drive reports about itself", "通过总线读取变频器的机型信息"),
)

LOOPBACK_TEST = Operation(
    name="loopback.test",
    right=Right.OPERATE,
    method="POST",
    path="/drives/{drive}/loopback/test",
    params=LoopbackParams,
    response=LoopbackResponse,
    cancellable=True,
    summary=Text(
        "Test the line with requests that the drive returns unchanged (Modbus function 08), for "
        f"{LOOPBACK_TIMEOUT_S} s at most; only models with a loop-back. Reads and changes nothing in the drive",
        f"用变频器原样返回的请求（Modbus 功能码 08）测试线路，最长 {LOOPBACK_TIMEOUT_S} s；仅限有回路测试的型号。"
        "不读取也不更改变频器中的任何内容",
    ),
)

PARAMETERS_WRITE = Operation(
    name="parameters.write",
    right=Right.WRITE_PARAMETERS,
    method="POST",
    path="/drives/{drive}/parameters/write",
    params=ParameterWriteParams,
    response=OutcomeResponse,
    audit=Audit.REQUIRED,
    summary=Text(
        "Write parameters, to RAM or with save to EEPROM; each is read back",
        "写参数，写入 RAM，或用 save 写入 EEPROM；逐个回读",
    ),
)

DRIVE_ARM = Operation(
    name="drive.arm",
    right=Right.OPERATE,
    method="POST",
    path="/drives/{drive}/arm",
    params=ArmParams,
    response=ArmResponse,
    audit=Audit.REQUIRED,
    summary=Text("First step of a start", "启动的第一步"),
)

DRIVE_RUN = Operation(
    name="drive.run",
    right=Right.OPERATE,
    method="POST",
    path="/drives/{drive}/run",
    params=RunParams,
    response=CommandResponse,
    audit=Audit.REQUIRED,
    moves_motors=True,
    summary=Text("Start a drive", "启动变频器"),
)

DRIVE_SET_FREQUENCY = Operation(
    name="drive.set_frequency",
    right=Right.OPERATE,
    method="POST",
    path="/drives/{drive}/set-frequency",
    params=SetFrequencyParams,
    response=CommandResponse,
    audit=Audit.BEST_EFFORT,
    moves_motors=True,
    summary=Text("Change the set frequency; starts nothing", "修改设定频率；不启动任何东西"),
)

DRIVE_PAUSE = Operation(
    name="drive.pause",
    right=Right.OPERATE,
    method="POST",
    path="/drives/{drive}/pause",
    params=DriveParams,
    response=OutcomeResponse,
    audit=Audit.BEST_EFFORT,
    summary=Text(
        "Pause the run: 0 Hz until the next start or stop; only models with a pause",
        "暂停运行：输出 0 Hz，直到下次启动或停机；仅限有暂停功能的型号",
    ),
)

DRIVE_HOLD_RAMP = Operation(
    name="drive.hold_ramp",
    right=Right.OPERATE,
    method="POST",
    path="/drives/{drive}/hold-ramp",
    params=RampHoldParams,
    response=OutcomeResponse,
    audit=Audit.BEST_EFFORT,
    moves_motors=True,
    summary=Text(
        "Keep the output frequency where it is for some seconds; answered at the end",
        "输出频率保持不变若干秒；结束后应答",
    ),
)

DRIVE_STOP = Operation(
    name="drive.stop",
    right=Right.STOP,
    method="POST",
    path="/drives/{drive}/stop",
    params=StopParams,
    response=OutcomeResponse,
    audit=Audit.MEANWHILE,
    summary=Text("Stop a drive; needs no lease", "停一台变频器；不需要控制权"),
)

DRIVE_JOG = Operation(
    name="drive.jog",
    right=Right.OPERATE,
    method="POST",
    path="/drives/{drive}/jog",
    params=JogParams,
    response=JogResponse,
    audit=Audit.REQUIRED,
    moves_motors=True,
    summary=Text("Jog: the motor turns while the jog is renewed", "点动：持续续期时电机转动"),
)

DRIVE_JOG_RENEW = Operation(
    name="drive.jog_renew",
    right=Right.OPERATE,
    method="POST",
    path="/drives/{drive}/jog/renew",
    params=ActiveJogParams,
    response=JogRenewResponse,
    keepalive=True,
    summary=Text(
        "Keep a jog going while the key is pressed; `remark` is null unless the drive reports the other direction",
        "按住按键时保持点动；变频器报告的方向相反时 `remark` 有说明，否则为 null",
    ),
)

DRIVE_JOG_END = Operation(
    name="drive.jog_end",
    right=Right.STOP,
    method="POST",
    path="/drives/{drive}/jog/end",
    params=ActiveJogParams,
    response=OutcomeResponse,
    audit=Audit.MEANWHILE,
    summary=Text("End a jog", "结束点动"),
)

DRIVE_RESET = Operation(
    name="drive.reset",
    right=Right.OPERATE,
    method="POST",
    path="/drives/{drive}/reset",
    params=DriveParams,
    response=OutcomeResponse,
    audit=Audit.BEST_EFFORT,
    summary=Text("Reset a fault", "复位故障"),
)

START_INHIBIT_RELEASE = Operation(
    name="start_inhibit.release",
    right=Right.OPERATE,
    method="POST",
    path="/drives/{drive}/start-inhibit/release",
    params=DriveParams,
    response=EmptyResponse,
    audit=Audit.BEST_EFFORT,
    summary=Text("Allow starts again after a bus stop", "总线停止之后重新允许启动"),
)

WAIVER_GRANT = Operation(
    name="waiver.grant",
    right=Right.LIMIT,
    method="POST",
    path="/drives/{drive}/waiver",
    params=WaiverParams,
    response=WaiverResponse,
    audit=Audit.REQUIRED,
    summary=Text(
        "Record why starts are allowed although the drive would run on after a communication loss",
        "记录为何允许启动，尽管通信中断后变频器会继续运行",
    ),
)

WAIVER_REVOKE = Operation(
    name="waiver.revoke",
    right=Right.LIMIT,
    method="DELETE",
    path="/drives/{drive}/waiver",
    params=DriveParams,
    response=EmptyResponse,
    audit=Audit.REQUIRED,
    reduces_hazard=True,
    summary=Text("Revoke the waiver", "撤销豁免"),
)

DRIVE_LIMITS = Operation(
    name="drive.limits",
    right=Right.LIMIT,
    method="PUT",
    path="/drives/{drive}/limits",
    params=LimitsParams,
    response=LimitsResponse,
    audit=Audit.REQUIRED,
    summary=Text(
        "Set all limits of a drive together: each must be given, so that none is loosened because it was left out; "
        "`maximum_hz` null is that of the configuration",
        "一次设置变频器的全部限值：每项都须写明，以免漏写一项就放宽该项；`maximum_hz` 为 null 表示采用配置中的值",
    ),
)
