"""Operations on the history: trends, exports and events."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from drivebus.clock import MAX_TIME_MS
from drivebus.service.api.operations.operation import (
    ApiObject,
    Cursor,
    DriveId,
    LocalizedText,
    Name,
    Operation,
    OperationParams,
    PageResponse,
    PageSize,
    TimeMs,
)
from drivebus.service.auth.rights import Right
from drivebus.values import Text

FromMs = Annotated[TimeMs, Field(examples=[1_700_000_000_000])]
ToMs = Annotated[TimeMs, Field(examples=[1_700_003_600_000])]
Tags = Annotated[list[Name], Field(min_length=1, max_length=50, examples=[["fan-1.output_frequency"]])]


UTC = "UTC"
"""Time zone of an export that names none."""


class TrendParams(OperationParams):
    """A trend: tags, time range in milliseconds since 1970, greatest number of points."""

    tags: Tags
    from_ms: FromMs
    to_ms: ToMs
    points: int = Field(default=1000, ge=2, le=1000, examples=[500])


class ExportParams(OperationParams):
    """A part of an export; all parts one after another are the file."""

    tags: Tags
    from_ms: FromMs
    to_ms: ToMs
    resolution: Literal["raw", "1s", "1min", "1h"] = Field(default="raw", examples=["1s"])
    format: Literal["csv", "parquet"] = Field(default="csv", examples=["csv"])
    layout: Literal["long", "wide"] = Field(
        default="long",
        examples=["wide"],
        description="for CSV; wide: one column a tag (rollups: the mean) and one row a time, without bad values",
    )
    timezone: str = Field(
        default=UTC,
        pattern=r"^[A-Za-z][A-Za-z0-9_+/-]{0,63}$",
        examples=[UTC],
        description="IANA name of the zone of the times in CSV, such as Asia/Shanghai",
    )
    cursor: Cursor | None = Field(default=None, description="next of the part before")


class TimeRangeParams(OperationParams):
    """Entries of a time range, of all drives or of one, newest first."""

    from_ms: FromMs = 0
    to_ms: ToMs = MAX_TIME_MS
    drive: DriveId | None = Field(default=None, examples=["fan-1"])
    cursor: Cursor | None = None
    limit: PageSize = 100


class EventObject(ApiObject):
    """A command, fault, alarm or change; ``outcome`` is that of a command."""

    id: str
    time_ms: int
    kind: str
    drive: str | None
    text: LocalizedText
    actor: str | None
    outcome: str | None


class TagObject(ApiObject):
    """A signal of a drive that has samples."""

    tag: str
    drive: str
    signal: str
    unit: str
    text: LocalizedText


class TagsResponse(ApiObject):
    """All tags of the history."""

    tags: list[TagObject]


class TrendSeriesObject(ApiObject):
    """Series of one tag: at most 1,000 points; null is a gap. ``q``: 0 good, 1 uncertain, 2 bad."""

    t: list[int]
    min: list[float | None]
    mean: list[float | None]
    max: list[float | None]
    q: list[int]


class TrendResponse(ApiObject):
    """A trend: one series for each tag."""

    resolution: Literal["raw", "1s", "1min", "1h"]
    series: dict[str, TrendSeriesObject]


HISTORY_TAGS = Operation(
    name="history.tags",
    right=Right.VIEW,
    method="GET",
    path="/history/tags",
    response=TagsResponse,
    summary=Text("Tags that the history keeps", "历史库保存的测点"),
)

HISTORY_TREND = Operation(
    name="history.trend",
    right=Right.VIEW,
    method="GET",
    path="/history/trend",
    params=TrendParams,
    response=TrendResponse,
    summary=Text("A trend, at most 1,000 points a signal", "趋势，每个信号最多 1000 点"),
)

HISTORY_EXPORT = Operation(
    name="history.export",
    right=Right.VIEW,
    method="GET",
    path="/history/export",
    params=ExportParams,
    media_types=("text/csv", "application/vnd.apache.parquet"),
    summary=Text("A file of samples", "样本文件"),
)

HISTORY_EVENTS = Operation(
    name="history.events",
    right=Right.VIEW,
    method="GET",
    path="/history/events",
    params=TimeRangeParams,
    response=PageResponse[EventObject],
    summary=Text("Commands, faults and alarms of a time range", "一段时间内的命令、故障和报警"),
)
