"""Every operation that the plant offers, with its parameters and the right it needs: one table for the local socket,
the API, the page and the command line. Parameters are strict: no number in a string, nothing unknown (T19, S08).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from drivebus.service.auth.rights import Right

Id = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_-]{0,63}$")]
Name = Annotated[str, Field(min_length=1, max_length=100)]
Frequency = Annotated[float, Field(ge=0.0, le=1000.0, allow_inf_nan=False)]
ParameterValue = Annotated[float, Field(allow_inf_nan=False)]
Reason = Annotated[str, Field(min_length=3, max_length=500)]
TimeMs = Annotated[int, Field(ge=0, le=253_402_300_799_999)]
Cursor = Annotated[str, Field(max_length=200)]
PageSize = Annotated[int, Field(ge=1, le=1000)]


class OperationParams(BaseModel):
    """Parameters of an operation."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)


class NoParams(OperationParams):
    pass


class DriveParams(OperationParams):
    drive: Id


class GroupParams(OperationParams):
    group: Id


class BusParams(OperationParams):
    bus: Id


class RunParams(DriveParams):
    frequency_hz: Frequency
    direction: Literal["forward", "reverse"] | None = None
    arm: Name | None = None
    """What ``drive.arm`` gave, within 10 s; a remote user's start needs it."""


class SetFrequencyParams(DriveParams):
    frequency_hz: Frequency


class StopParams(DriveParams):
    how: Literal["stop", "coast", "quick_stop"] = "stop"


class JogParams(DriveParams):
    direction: Literal["forward", "reverse"] = "forward"
    frequency_hz: Frequency | None = None
    arm: Name | None = None
    """As for a run: a jog is a start."""


class ActiveJogParams(DriveParams):
    jog: Name


class WaiverParams(DriveParams):
    reason: Reason


class LimitsParams(DriveParams):
    minimum_hz: Frequency = 0.0
    maximum_hz: Frequency | None = None
    forward: bool = True
    reverse: bool = True


class ParameterReadParams(DriveParams):
    names: Annotated[list[Name], Field(min_length=1, max_length=64)]


class ParameterWriteParams(DriveParams):
    values: Annotated[dict[Name, ParameterValue], Field(min_length=1, max_length=64)]
    save: bool = False
    """To EEPROM; needs the right ``save`` instead of ``tune``."""


class GroupStartParams(GroupParams):
    frequency_hz: Frequency
    """The leader's, or everybody's where there is no leader."""
    direction: Literal["forward", "reverse"] | None = None
    arm: Name | None = None


class GroupSetFrequencyParams(GroupParams):
    frequency_hz: Frequency


class FramesParams(BusParams):
    after: int = Field(default=0, ge=0)
    """Only frames with a larger number."""
    station: int | None = Field(default=None, ge=0, le=255)
    limit: PageSize = 200


class TrendParams(OperationParams):
    tags: Annotated[list[Name], Field(min_length=1, max_length=50)]
    from_ms: TimeMs
    to_ms: TimeMs
    points: int = Field(default=1000, ge=2, le=1000)


class ExportParams(OperationParams):
    tags: Annotated[list[Name], Field(min_length=1, max_length=50)]
    from_ms: TimeMs
    to_ms: TimeMs
    resolution: Literal["raw", "1s", "1min", "1h"] = "raw"
    format: Literal["csv", "parquet"] = "csv"
    cursor: Cursor | None = None
    """``next`` of the part before. A part fits one line of the socket; all parts after one another are the file."""


class TimeRangeParams(OperationParams):
    from_ms: TimeMs = 0
    to_ms: TimeMs = 253_402_300_799_999
    drive: Id | None = None
    cursor: Cursor | None = None
    limit: PageSize = 100


class AlarmParams(OperationParams):
    alarm: Name
    """The id of one raised alarm, as ``alarms.list`` gives it."""


class ShelveParams(AlarmParams):
    minutes: int = Field(ge=1, le=1440)
    reason: Reason


class IncidentParams(OperationParams):
    case: Name


class ConfigurationParams(OperationParams):
    text: Annotated[str, Field(max_length=1_000_000)]


@dataclass(frozen=True, slots=True)
class Operation:
    """One thing that can be asked of the plant."""

    name: str
    right: Right
    params: type[OperationParams] = NoParams
    mutates: bool = False
    """Audited, with its outcome; never reached by GET (S03)."""
    keepalive: bool = False
    """It keeps something from ending: too late is as bad as not at all."""

    @property
    def is_stop(self) -> bool:
        """It only takes motion away: nothing is asked or recorded before it (6.5)."""
        return self.mutates and self.right is Right.STOP

    @property
    def yields(self) -> bool:
        """Its turn (``plant.turns``): what only asks. Whatever does something comes in as it was sent, so that a stop
        finds, and voids, all that was asked before it (6.5)."""
        return not (self.mutates or self.keepalive)


_ALL = (
    Operation("plant.get", Right.VIEW),
    Operation("plant.statistics", Right.VIEW),
    Operation("drives.list", Right.VIEW),
    Operation("drives.get", Right.VIEW, DriveParams),
    Operation("drives.profile", Right.VIEW, DriveParams),
    Operation("drives.statistics", Right.VIEW, DriveParams),
    Operation("parameters.read", Right.OPERATE, ParameterReadParams),
    Operation("parameters.write", Right.WRITE_PARAMETERS, ParameterWriteParams, mutates=True),
    Operation("lease.take", Right.OPERATE, DriveParams, mutates=True),
    Operation(
        "lease.renew", Right.STOP, DriveParams, keepalive=True
    ),  # who sits idle before a running drive may stop it
    Operation("lease.release", Right.OPERATE, DriveParams, mutates=True),
    Operation("drive.arm", Right.OPERATE, DriveParams, mutates=True),
    Operation("drive.run", Right.OPERATE, RunParams, mutates=True),
    Operation("drive.set_frequency", Right.OPERATE, SetFrequencyParams, mutates=True),
    Operation("drive.stop", Right.STOP, StopParams, mutates=True),
    Operation("drive.jog", Right.OPERATE, JogParams, mutates=True),
    Operation("drive.jog_renew", Right.OPERATE, ActiveJogParams, keepalive=True),
    Operation("drive.jog_end", Right.STOP, ActiveJogParams, mutates=True),
    Operation("drive.reset", Right.OPERATE, DriveParams, mutates=True),
    Operation("drive.release", Right.OPERATE, DriveParams, mutates=True),
    Operation("drive.waiver", Right.LIMIT, WaiverParams, mutates=True),
    Operation("drive.unwaive", Right.LIMIT, DriveParams, mutates=True),
    Operation("drive.limits", Right.LIMIT, LimitsParams, mutates=True),
    Operation("groups.list", Right.VIEW),
    Operation("group.arm", Right.OPERATE, GroupParams, mutates=True),
    Operation("group.start", Right.OPERATE, GroupStartParams, mutates=True),
    Operation("group.set_frequency", Right.OPERATE, GroupSetFrequencyParams, mutates=True),
    Operation("group.stop", Right.STOP, GroupParams, mutates=True),
    Operation("plant.stop", Right.STOP, mutates=True),
    Operation("buses.list", Right.VIEW),
    Operation("buses.get", Right.VIEW, BusParams),
    Operation("buses.frames", Right.VIEW, FramesParams),
    Operation("history.tags", Right.VIEW),
    Operation("history.trend", Right.VIEW, TrendParams),
    Operation("history.export", Right.VIEW, ExportParams),
    Operation("history.markers", Right.VIEW, TimeRangeParams),
    Operation("alarms.list", Right.VIEW),
    Operation("alarms.history", Right.VIEW, TimeRangeParams),
    Operation("alarm.acknowledge", Right.OPERATE, AlarmParams, mutates=True),
    Operation("alarm.shelve", Right.OPERATE, ShelveParams, mutates=True),
    Operation("alarm.unshelve", Right.OPERATE, AlarmParams, mutates=True),
    Operation("cases.list", Right.VIEW, TimeRangeParams),
    Operation("cases.get", Right.VIEW, IncidentParams),
    Operation("audit.list", Right.AUDIT, TimeRangeParams),
    Operation("audit.verify", Right.AUDIT),
    Operation("configuration.get", Right.CONFIGURE),
    Operation("configuration.check", Right.CONFIGURE, ConfigurationParams),
    Operation("configuration.reload", Right.CONFIGURE, mutates=True),
)

OPERATIONS: dict[str, Operation] = {operation.name: operation for operation in _ALL}
