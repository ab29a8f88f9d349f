"""Schema of a ``plant.toml``: strict pydantic models; what concerns several keys at once is in ``check``.

Everything that can be referred to is a table with its id in the header (``[drive.fan-1]``), so that no id is used
twice and every issue has a line. Each key is described in the catalogues, ``plant_config.key.<table>.<key>``.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from drivebus.drives.eeprom_budget import DEFAULT_EEPROM_WRITES_PER_DAY
from drivebus.profiles.schema import LanguageCode, StrictTable, table_of_text
from drivebus.service.config.model import AlarmKind, HistoryConfig
from drivebus.service.ids import Id

PLANT_FILE_FORMAT = 1
"""Newest file format that this version reads."""
MIN_PERIOD_S = 0.05
"""Shortest poll period: about one transaction at 9600 baud."""
_DAY_S = 86_400.0

Seconds = Annotated[float, Field(ge=0, le=_DAY_S)]
Period = Annotated[float, Field(ge=MIN_PERIOD_S, le=_DAY_S)]
Hertz = Annotated[float, Field(ge=0, le=1000)]
Days = Annotated[float, Field(gt=0, le=100_000)]
ShortText = Annotated[str, Field(min_length=1, max_length=200)]
Expression = Annotated[str, Field(min_length=1, max_length=2000)]
PathText = Annotated[str, Field(min_length=1, max_length=4096)]
OptionValue = str | int | float | bool


Title = Annotated[dict[LanguageCode, ShortText], BeforeValidator(table_of_text)]
"""Title by language. A plain string, or a table of one language, serves for all."""


class PlantTable(StrictTable):
    id: Id
    title: Title | None = None
    directory: PathText | None = None
    users: PathText | None = None


class BusTable(StrictTable):
    port: Annotated[str, Field(min_length=1, max_length=1000)]
    baud: Annotated[int | None, Field(ge=50, le=4_000_000)] = None
    format: str | None = None
    title: Title | None = None


class LimitsTable(StrictTable):
    minimum_hz: Hertz = 0.0
    maximum_hz: Hertz | None = None
    forward: bool = True
    reverse: bool = True
    eeprom_writes_per_day: Annotated[int, Field(ge=0, le=10_000)] = DEFAULT_EEPROM_WRITES_PER_DAY


class DriveTable(StrictTable):
    bus: Id
    address: Annotated[int, Field(ge=0, le=255)]
    model: PathText
    title: Title | None = None
    encoding: str | None = None
    options: dict[str, OptionValue] = {}
    limits: LimitsTable = LimitsTable()
    signals: dict[str, Period] = {}
    min_poll_interval_s: Annotated[float | None, Field(ge=0, le=_DAY_S)] = None
    on_client_lost: Literal["hold", "stop"] = "hold"
    on_service_stop: Literal["stop", "hold"] = "stop"
    on_restart: Literal["adopt", "stop"] = "adopt"


class GroupTable(StrictTable):
    drives: Annotated[list[Id], Field(min_length=1)]
    title: Title | None = None
    start_interval_s: Seconds = 0.0
    max_concurrent_starts: Annotated[int, Field(ge=1, le=1000)] = 1
    leader: Id | None = None
    ratios: dict[Id, Annotated[float, Field(ge=0.01, le=100)]] = {}


class InterlockTable(StrictTable):
    drives: Annotated[list[Id], Field(min_length=1)]
    require: Expression
    action: Literal["stop", "block_start"] = "stop"
    delay_s: Seconds = 0.0
    title: Title | None = None


AlarmKindName = Literal["above", "below", "fault", "no_response", "stale"]
assert set(AlarmKindName.__args__) == set(AlarmKind)  # type: ignore[attr-defined]


class AlarmTable(StrictTable):
    kind: AlarmKindName
    drives: list[Id] = []
    signal: str | None = None
    threshold: float | None = None
    hysteresis: Annotated[float, Field(ge=0)] = 0.0
    delay_s: Seconds = 0.0
    priority: Literal["critical", "high", "medium", "low"] = "high"
    title: Title | None = None


_HISTORY = HistoryConfig()


class RetentionTable(StrictTable):
    raw_days: Days = _HISTORY.retention.raw_days
    rollup_1s_days: Days = _HISTORY.retention.rollup_1s_days
    rollup_1min_days: Days = _HISTORY.retention.rollup_1min_days
    rollup_1h_days: Days = _HISTORY.retention.rollup_1h_days


class HistoryTable(StrictTable):
    url: Annotated[str, Field(max_length=1000)] | None = None
    max_size_mb: Annotated[float, Field(ge=10, le=100_000_000)] = _HISTORY.max_size_mb
    retention: RetentionTable = RetentionTable()


class AuditTable(StrictTable):
    checkpoints: PathText | None = None
    key: PathText | None = None
    head: PathText | None = None


class GatewayTable(StrictTable):
    """Base of the table of every gateway, ``[gateway.<name>]``."""

    enabled: bool = True


class GatewayTables(StrictTable):
    """Tables of the gateways: ``plant_file_schema`` makes the subclass with a field for each installed one."""

    def configured(self) -> Iterator[tuple[str, GatewayTable]]:
        """Yield name and table of every gateway that has one, written or by default."""
        return ((name, table) for name, table in self if isinstance(table, GatewayTable))


class PlantFile(StrictTable):
    """Whole file. ``service.config.gateways.plant_file_schema`` adds the tables of the installed gateways."""

    format: int
    plant: PlantTable
    bus: dict[Id, BusTable] = {}
    drive: dict[Id, DriveTable] = {}
    group: dict[Id, GroupTable] = {}
    interlock: dict[Id, InterlockTable] = {}
    alarm: dict[Id, AlarmTable] = {}
    history: HistoryTable = HistoryTable()
    audit: AuditTable = AuditTable()
    gateway: GatewayTables = GatewayTables()
