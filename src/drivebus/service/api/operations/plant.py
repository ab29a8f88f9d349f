"""Operations on the plant as a whole: its state, its statistics, the stop of everything, its configuration."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from drivebus.service.api.operations.drives import StatisticsObject
from drivebus.service.api.operations.operation import ApiObject, Audit, LocalizedText, Operation, OperationParams
from drivebus.service.api.operations.outcomes import OutcomesResponse
from drivebus.service.auth.rights import Right
from drivebus.values import Text


class ConfigurationParams(OperationParams):
    """The text of a ``plant.toml``."""

    text: Annotated[str, Field(max_length=1_000_000, examples=['[plant]\nid = "hall-2"\n'])]


class StopCountsObject(ApiObject):
    """Stops of single drives; a stop of everything is one of each drive. A stop in neither of the last two was not
    confirmed in time.
    """

    requested: int
    confirmed: int
    acknowledged: int


class HistorianObject(ApiObject):
    """Whether the history is written, the problem if not, and the numbers of its samples; lost ones are gaps."""

    ok: bool
    problem: LocalizedText | None
    queued: int
    samples: int
    lost_samples: int
    lost_notes: int


class StatisticsResponse(ApiObject):
    """Counts since the service started; ``drives`` holds each drive's own."""

    stops: StopCountsObject
    history: HistorianObject
    drives: dict[str, StatisticsObject]


class BusStopObject(ApiObject):
    """Result of a stop on one bus. ``confirmed``: every drive reported standstill; ``acknowledged``: drives that
    accepted the stop and cannot report standstill; ``unconfirmed``: drives that must be checked.
    """

    confirmed: bool
    acknowledged: list[str]
    unconfirmed: list[str]
    took_s: float | None


class StopAllResponse(OutcomesResponse):
    """Result of a stop of everything: by drive and by bus."""

    buses: dict[str, BusStopObject]


class LastStopAllObject(ApiObject):
    """Last stop of everything, by bus."""

    time_ms: int
    actor: str
    buses: dict[str, BusStopObject]


class DiskObject(ApiObject):
    """Space of the disk that holds the plant's state; empty while it can't be read."""

    free_mb: int | None = None
    total_mb: int | None = None


class GatewayObject(ApiObject):
    """Process of a gateway; without ``pid`` it is about to be started. ``exit_code``: of the last that ended itself."""

    id: str
    pid: int | None
    starts: int
    exit_code: int | None
    running: bool


class PlantResponse(ApiObject):
    """State of the plant. ``stop_all``: the last stop of everything since the service started.

    ``write_failures``: the files, and the history, that can't be written at present; each has an alarm with the reason.
    ``clock_synchronized``: whether the clock of the computer is synchronized, as its Linux reports it; null: not known.
    """

    id: str
    title: LocalizedText
    state: str
    stop_all: LastStopAllObject | None
    notice: LocalizedText | None
    version: str
    started_ms: int
    audit_ok: bool
    history_ok: bool
    write_failures: list[str]
    disk: DiskObject
    clock_synchronized: bool | None
    gateways: list[GatewayObject]


class ConfigurationResponse(ApiObject):
    """Text of the plant file without passwords, and its path; it may be newer than what runs."""

    text: str
    source: str


class DifferenceObject(ApiObject):
    """Names of what was added, changed and removed; empty where the text has faults."""

    added: list[str] = []
    changed: list[str] = []
    removed: list[str] = []


class DiagnosticObject(ApiObject):
    """A fault of a configuration: its line, its key and what stands there."""

    line: int | None
    key: str
    found: str
    text: LocalizedText


class ConfigurationCheckResponse(ApiObject):
    """Every fault of a configuration, or what it would change. ``notes``: gateways that would move or end."""

    diagnostics: list[DiagnosticObject]
    difference: DifferenceObject
    notes: list[LocalizedText]


class ReloadResponse(ApiObject):
    """Difference that the reload applied; ``restart`` names the settings that take effect at the next start only.
    ``notes``: gateways that move or end, drives that run above a new limit.
    """

    difference: DifferenceObject
    restart: list[str]
    notes: list[LocalizedText]


PLANT_GET = Operation(
    name="plant.get",
    right=Right.VIEW,
    method="GET",
    path="/plant",
    response=PlantResponse,
    summary=Text("The plant: state, version, the last stop of everything", "工厂：状态、版本、最近一次全部停机"),
)

PLANT_STATISTICS = Operation(
    name="plant.statistics",
    right=Right.VIEW,
    method="GET",
    path="/statistics",
    response=StatisticsResponse,
    summary=Text(
        "Counts since the service started: stops, samples of the history, each drive's hours and starts",
        "服务启动以来的计数：停机、历史样本、每台变频器的小时数和启动次数",
    ),
)

PLANT_STOP = Operation(
    name="plant.stop",
    right=Right.STOP,
    method="POST",
    path="/stop",
    response=StopAllResponse,
    audit=Audit.MEANWHILE,
    summary=Text("Stop every drive on every bus", "停所有总线上的所有变频器"),
)

CONFIGURATION_GET = Operation(
    name="configuration.get",
    right=Right.CONFIGURE,
    method="GET",
    path="/configuration",
    response=ConfigurationResponse,
    summary=Text("The plant's configuration", "工厂的配置"),
)

CONFIGURATION_CHECK = Operation(
    name="configuration.check",
    right=Right.CONFIGURE,
    method="POST",
    path="/configuration/check",
    params=ConfigurationParams,
    response=ConfigurationCheckResponse,
    cancellable=True,
    summary=Text(
        "Check a configuration without using it: one at a time, at most 1,000 drives and 20 s, beside the buses",
        "检查配置，但不采用：同时只检查一份，最多 1000 台变频器、20 s，不影响总线",
    ),
)

CONFIGURATION_RELOAD = Operation(
    name="configuration.reload",
    right=Right.CONFIGURE,
    method="POST",
    path="/configuration/reload",
    response=ReloadResponse,
    audit=Audit.REQUIRED,
    summary=Text("Read the configuration file again and apply the difference", "重新读取配置文件并应用差异"),
)
