"""Configuration of a plant: the values of a checked ``plant.toml``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

from drivebus.drives.context import DriveLimits
from drivebus.profiles.diagnostics import Diagnostic
from drivebus.values import Text

USER_FILE = "users.json"
"""Name of the user file in the state directory, where the configuration gives no path of it."""


class OnClientLost(StrEnum):
    """Policy for a drive whose control lease has ended without release."""

    HOLD = "hold"
    """It keeps running, with an alarm."""
    STOP = "stop"


class OnServiceStop(StrEnum):
    """Policy for a drive started by this service when the service stops in an orderly way."""

    STOP = "stop"
    HOLD = "hold"


class OnRestart(StrEnum):
    """Policy for a drive that runs when the service starts. The service never starts anything by itself."""

    ADOPT = "adopt"
    """Observe it, with an alarm that it runs without control lease."""
    STOP = "stop"


class AlarmPriority(StrEnum):
    """Priority of an alarm (ISA-18.2)."""

    CRITICAL = "critical"
    HIGH = "high"
    MEDIUM = "medium"
    LOW = "low"


@dataclass(frozen=True, slots=True)
class BusConfig:
    """Bus of a plant: port URL and serial settings."""

    id: str
    port: str
    baud: int | None = None
    format: str | None = None
    title: Text = Text("", "")


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveConfig:
    """Drive of a plant."""

    id: str
    bus: str
    address: int
    model: str
    """Name of a profile, or path of a TOML file."""
    title: Text = Text("", "")
    encoding: str | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    """Values of the model's undocumented options."""
    limits: DriveLimits = field(default_factory=DriveLimits)
    signals: Mapping[str, float] = field(default_factory=dict)
    """Signal → period in seconds, at least 0.05; if empty, every signal of the profile at its own period."""
    min_poll_interval_s: float = 0.0
    """Shortest interval of this drive's polls, configured or chosen for what the bus can carry."""
    on_client_lost: OnClientLost = OnClientLost.HOLD
    on_service_stop: OnServiceStop = OnServiceStop.STOP
    on_restart: OnRestart = OnRestart.ADOPT


@dataclass(frozen=True, slots=True, kw_only=True)
class GroupConfig:
    """Drives that are started in sequence and stopped together."""

    id: str
    drives: tuple[str, ...]
    title: Text = Text("", "")
    start_interval_s: float = 0.0
    """Shortest time between two starts, in seconds."""
    max_concurrent_starts: int = 1
    """Drives that may accelerate at the same time."""
    leader: str | None = None
    ratios: Mapping[str, float] = field(default_factory=dict)
    """Drive → ratio of its frequency to the leader's."""


def title_of(item: BusConfig | DriveConfig | GroupConfig | InterlockConfig) -> Text:
    """Return the title, in each language that it lacks the other one's; without a title the id."""
    texts = {language: text for language, text in item.title.by_language().items() if text}
    return Text.from_mapping(texts or {"en": item.id})


class InterlockAction(StrEnum):
    """Action of a violated interlock."""

    STOP = "stop"
    BLOCK_START = "block_start"


@dataclass(frozen=True, slots=True, kw_only=True)
class InterlockConfig:
    """Condition under which ``drives`` may run; a value without good quality violates it."""

    id: str
    drives: tuple[str, ...]
    require: str
    """Expression over signals, e.g. ``pump-1.output_frequency > 5 Hz and fan-1.state == running``."""
    action: InterlockAction = InterlockAction.STOP
    delay_s: float = 0.0
    title: Text = Text("", "")


class AlarmKind(StrEnum):
    """Condition of an alarm."""

    ABOVE = "above"
    BELOW = "below"
    FAULT = "fault"
    NO_RESPONSE = "no_response"
    STALE = "stale"


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmConfig:
    """Alarm for one or several drives. ``fault`` and ``no_response`` exist for every drive by default."""

    id: str
    kind: AlarmKind
    drives: tuple[str, ...]
    """Every drive if empty."""
    signal: str | None = None
    threshold: float | None = None
    """In the unit of the signal."""
    hysteresis: float = 0.0
    delay_s: float = 0.0
    priority: AlarmPriority = AlarmPriority.HIGH
    title: Text = Text("", "")


@dataclass(frozen=True, slots=True, kw_only=True)
class RetentionConfig:
    """Days for which samples and rollups are kept."""

    raw_days: float = 2.0
    rollup_1s_days: float = 7.0
    rollup_1min_days: float = 400.0
    rollup_1h_days: float = 4000.0


@dataclass(frozen=True, slots=True, kw_only=True)
class HistoryConfig:
    """Database and size of the history. ``url`` None: SQLite in the state directory."""

    url: str | None = None
    retention: RetentionConfig = RetentionConfig()
    max_size_mb: float = 10_000.0


@dataclass(frozen=True, slots=True)
class AuditConfig:
    """Checkpoint file, key and head of the audit trail. On another disk or machine they detect more."""

    checkpoints: Path | None = None
    """None: ``checkpoints.jsonl`` in the state directory."""
    key: Path | None = None
    """None: ``<state directory>.audit.key``."""
    head: Path | None = None
    """None: ``<state directory>.audit.head``."""


@dataclass(frozen=True, slots=True)
class CertificateFiles:
    """TLS certificate of a gateway, and its private key, as PEM files."""

    certificate: Path
    key: Path


@dataclass(frozen=True, slots=True, kw_only=True)
class GatewayConfig:
    """Gateway of a plant."""

    id: str
    """Its name, as in ``[gateway.<name>]``."""
    module: str
    """Module that its process runs."""
    settings: Any
    """Settings of its process: a frozen dataclass that only the gateway defines and reads."""
    enabled: bool = True
    extra: str | None = None
    """Extra of the package drivebus whose libraries its process imports."""
    certificates: tuple[CertificateFiles, ...] = ()
    address: str | None = None
    """Where users open it; None where it has no address, or gets it at its start."""
    listens_at: tuple[str, int] | None = None
    """Host and TCP port that its process listens at."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantConfig:
    """Configuration of a whole plant."""

    id: str
    title: Text
    directory: Path
    """State directory: history, audit trail, users, incidents, sockets."""
    buses: tuple[BusConfig, ...]
    drives: tuple[DriveConfig, ...]
    groups: tuple[GroupConfig, ...] = ()
    interlocks: tuple[InterlockConfig, ...] = ()
    alarms: tuple[AlarmConfig, ...] = ()
    history: HistoryConfig = HistoryConfig()
    audit: AuditConfig = AuditConfig()
    gateways: tuple[GatewayConfig, ...] = ()
    users: Path | None = None
    """User file; None: ``USER_FILE`` in the state directory."""
    source: str = ""
    """File from which it was loaded."""
    named_paths: tuple[Path, ...] = field(default=(), compare=False)
    """State directory, user file and audit key as that file names them, links not followed."""
    named_audit_files: tuple[Path, ...] = field(default=(), compare=False)
    """Checkpoints and head of the audit trail as that file names them, links not followed."""
    warnings: tuple[Diagnostic, ...] = field(default=(), compare=False)
    """Values of the file that are valid and probably a mistake."""

    @property
    def user_file(self) -> Path:
        """Path of the user file."""
        return self.users or self.directory / USER_FILE

    def drive(self, id: str) -> DriveConfig:
        """Return a drive. Raises KeyError."""
        return {drive.id: drive for drive in self.drives}[id]

    def gateway(self, id: str) -> GatewayConfig:
        """Return a gateway. Raises KeyError."""
        return {gateway.id: gateway for gateway in self.gateways}[id]
