"""Operations on the plant as a whole: its state, its statistics, the stop of everything, its configuration."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from drivebus.service.api.operations.groups import OutcomesResponse
from drivebus.service.api.operations.operation import ApiObject, Audit, Operation, OperationParams
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


class StatisticsResponse(ApiObject):
    """Counts since the service started; ``drives`` holds each drive's own, as its path ``statistics`` gives them."""

    stops: StopCountsObject
    history: dict[str, Any]
    drives: dict[str, dict[str, Any]]


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


PLANT_GET = Operation(
    name="plant.get",
    right=Right.VIEW,
    method="GET",
    path="/plant",
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
    audit=Audit.AFTER,
    summary=Text("Stop every drive on every bus", "停所有总线上的所有变频器"),
)

CONFIGURATION_GET = Operation(
    name="configuration.get",
    right=Right.CONFIGURE,
    method="GET",
    path="/configuration",
    summary=Text("The plant's configuration", "工厂的配置"),
)

CONFIGURATION_CHECK = Operation(
    name="configuration.check",
    right=Right.CONFIGURE,
    method="POST",
    path="/configuration/check",
    params=ConfigurationParams,
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
    audit=Audit.REQUIRED,
    summary=Text("Read the configuration file again and apply the difference", "重新读取配置文件并应用差异"),
)
