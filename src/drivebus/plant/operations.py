"""Every operation that the plant offers, with its parameters and the right it needs: one table for the local socket,
the API, the page and the command line. Parameters are strict: no number in a string, nothing unknown (T19, S08).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from drivebus.plant.access.rights import Right

Id = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_-]{0,63}$")]
Name = Annotated[str, Field(min_length=1, max_length=100)]
Frequency = Annotated[float, Field(ge=0.0, le=1000.0, allow_inf_nan=False)]
Value = Annotated[float, Field(allow_inf_nan=False)]
Reason = Annotated[str, Field(min_length=3, max_length=500)]
TimeMs = Annotated[int, Field(ge=0, le=253_402_300_799_999)]
Cursor = Annotated[str, Field(max_length=200)]
Limit = Annotated[int, Field(ge=1, le=1000)]


class Params(BaseModel):
    """Parameters of an operation."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)


class Nothing(Params):
    pass


class OfDrive(Params):
    drive: Id


class OfGroup(Params):
    group: Id


class OfBus(Params):
    bus: Id


class Run(OfDrive):
    frequency_hz: Frequency
    direction: Literal["forward", "reverse"] | None = None
    arm: Name | None = None
    """What ``drive.arm`` gave, within 10 s; a remote user's start needs it."""


class SetFrequency(OfDrive):
    frequency_hz: Frequency


class StopDrive(OfDrive):
    how: Literal["stop", "coast", "quick_stop"] = "stop"


class Jog(OfDrive):
    direction: Literal["forward", "reverse"] = "forward"
    frequency_hz: Frequency | None = None
    arm: Name | None = None
    """As for a run: a jog is a start."""


class JogHeld(OfDrive):
    jog: Name


class Waiver(OfDrive):
    reason: Reason


class Limits(OfDrive):
    minimum_hz: Frequency = 0.0
    maximum_hz: Frequency | None = None
    forward: bool = True
    reverse: bool = True


class ReadParameters(OfDrive):
    names: Annotated[list[Name], Field(min_length=1, max_length=64)]


class WriteParameters(OfDrive):
    values: Annotated[dict[Name, Value], Field(min_length=1, max_length=64)]
    save: bool = False
    """To EEPROM; needs the right ``save`` instead of ``tune``."""


class GroupStart(OfGroup):
    frequency_hz: Frequency
    """The leader's, or everybody's where there is no leader."""
    direction: Literal["forward", "reverse"] | None = None
    arm: Name | None = None


class GroupSetFrequency(OfGroup):
    frequency_hz: Frequency


class Frames(OfBus):
    after: int = Field(default=0, ge=0)
    """Only frames with a larger number."""
    station: int | None = Field(default=None, ge=0, le=255)
    limit: Limit = 200


class Trend(Params):
    tags: Annotated[list[Name], Field(min_length=1, max_length=50)]
    from_ms: TimeMs
    to_ms: TimeMs
    points: int = Field(default=1000, ge=2, le=1000)


class Export(Params):
    tags: Annotated[list[Name], Field(min_length=1, max_length=50)]
    from_ms: TimeMs
    to_ms: TimeMs
    resolution: Literal["raw", "1s", "1min", "1h"] = "raw"
    format: Literal["csv", "parquet"] = "csv"
    cursor: Cursor | None = None
    """``next`` of the part before. A part fits one line of the socket; all parts after one another are the file."""


class Span(Params):
    from_ms: TimeMs = 0
    to_ms: TimeMs = 253_402_300_799_999
    drive: Id | None = None
    cursor: Cursor | None = None
    limit: Limit = 100


class OfAlarm(Params):
    alarm: Name
    """The id of one raised alarm, as ``alarms.list`` gives it."""


class Shelve(OfAlarm):
    minutes: int = Field(ge=1, le=1440)
    reason: Reason


class OfCase(Params):
    case: Name


class Configuration(Params):
    text: Annotated[str, Field(max_length=1_000_000)]


@dataclass(frozen=True, slots=True)
class Operation:
    """One thing that can be asked of the plant."""

    name: str
    right: Right
    params: type[Params] = Nothing
    changes: bool = False
    """Audited, with its outcome; never reached by GET (S03)."""
    renews: bool = False
    """It keeps something from ending: too late is as bad as not at all."""

    @property
    def stops(self) -> bool:
        """It only takes motion away: nothing is asked or recorded before it (6.5)."""
        return self.changes and self.right is Right.STOP

    @property
    def waits(self) -> bool:
        """Its turn (``plant.turns``): what only asks. Whatever does something comes in as it was sent, so that a stop
        finds, and voids, all that was asked before it (6.5)."""
        return not (self.changes or self.renews)


_ALL = (
    Operation("plant.get", Right.VIEW),
    Operation("plant.statistics", Right.VIEW),
    Operation("drives.list", Right.VIEW),
    Operation("drives.get", Right.VIEW, OfDrive),
    Operation("drives.profile", Right.VIEW, OfDrive),
    Operation("drives.statistics", Right.VIEW, OfDrive),
    Operation("parameters.read", Right.OPERATE, ReadParameters),
    Operation("parameters.write", Right.TUNE, WriteParameters, changes=True),
    Operation("lease.take", Right.OPERATE, OfDrive, changes=True),
    Operation("lease.renew", Right.STOP, OfDrive, renews=True),  # who sits idle before a running drive may stop it
    Operation("lease.release", Right.OPERATE, OfDrive, changes=True),
    Operation("drive.arm", Right.OPERATE, OfDrive, changes=True),
    Operation("drive.run", Right.OPERATE, Run, changes=True),
    Operation("drive.set_frequency", Right.OPERATE, SetFrequency, changes=True),
    Operation("drive.stop", Right.STOP, StopDrive, changes=True),
    Operation("drive.jog", Right.OPERATE, Jog, changes=True),
    Operation("drive.jog_renew", Right.OPERATE, JogHeld, renews=True),
    Operation("drive.jog_end", Right.STOP, JogHeld, changes=True),
    Operation("drive.reset", Right.OPERATE, OfDrive, changes=True),
    Operation("drive.release", Right.OPERATE, OfDrive, changes=True),
    Operation("drive.waiver", Right.LIMIT, Waiver, changes=True),
    Operation("drive.unwaive", Right.LIMIT, OfDrive, changes=True),
    Operation("drive.limits", Right.LIMIT, Limits, changes=True),
    Operation("groups.list", Right.VIEW),
    Operation("group.arm", Right.OPERATE, OfGroup, changes=True),
    Operation("group.start", Right.OPERATE, GroupStart, changes=True),
    Operation("group.set_frequency", Right.OPERATE, GroupSetFrequency, changes=True),
    Operation("group.stop", Right.STOP, OfGroup, changes=True),
    Operation("plant.stop", Right.STOP, changes=True),
    Operation("buses.list", Right.VIEW),
    Operation("buses.get", Right.VIEW, OfBus),
    Operation("buses.frames", Right.VIEW, Frames),
    Operation("history.tags", Right.VIEW),
    Operation("history.trend", Right.VIEW, Trend),
    Operation("history.export", Right.VIEW, Export),
    Operation("history.markers", Right.VIEW, Span),
    Operation("alarms.list", Right.VIEW),
    Operation("alarms.history", Right.VIEW, Span),
    Operation("alarm.acknowledge", Right.OPERATE, OfAlarm, changes=True),
    Operation("alarm.shelve", Right.OPERATE, Shelve, changes=True),
    Operation("alarm.unshelve", Right.OPERATE, OfAlarm, changes=True),
    Operation("cases.list", Right.VIEW, Span),
    Operation("cases.get", Right.VIEW, OfCase),
    Operation("audit.list", Right.AUDIT, Span),
    Operation("audit.verify", Right.AUDIT),
    Operation("configuration.get", Right.CONFIGURE),
    Operation("configuration.check", Right.CONFIGURE, Configuration),
    Operation("configuration.reload", Right.CONFIGURE, changes=True),
)

OPERATIONS: dict[str, Operation] = {operation.name: operation for operation in _ALL}
