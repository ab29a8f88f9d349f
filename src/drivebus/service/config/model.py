"""What a ``plant.toml`` says: values only; ``plant.config`` makes them from the file and refuses what can't be."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

from drivebus.drives.context import DriveLimits
from drivebus.profiles.model import Text


class OnClientLost(StrEnum):
    """What becomes of a drive whose owner is gone (6.6)."""

    HOLD = "hold"
    """It goes on as it is; an alarm tells so."""
    STOP = "stop"


class OnServiceStop(StrEnum):
    """What becomes of a drive that this service started, when it ends in an orderly way (6.6)."""

    STOP = "stop"
    HOLD = "hold"


class OnRestart(StrEnum):
    """What a restarted service does about a drive that runs; it never starts anything (ruling 7)."""

    ADOPT = "adopt"
    """Watch it; an alarm tells that it runs without an owner."""
    STOP = "stop"


class AlarmPriority(StrEnum):
    """How urgent an alarm is."""

    CRITICAL = "critical"
    HIGH = "high"
    MEDIUM = "medium"
    LOW = "low"


@dataclass(frozen=True, slots=True)
class BusConfig:
    """One line: a LINK and its settings."""

    id: str
    link: str
    baud: int | None = None
    format: str | None = None
    title: Text = Text("", "")


@dataclass(frozen=True, slots=True)
class DriveConfig:
    """One drive of the plant."""

    id: str
    bus: str
    address: int
    model: str
    """A profile's name, or the path of a TOML file."""
    title: Text = Text("", "")
    encoding: str | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Answers to the family's open questions."""
    limits: DriveLimits = field(default_factory=DriveLimits)
    signals: Mapping[str, float] = field(default_factory=dict)
    """Signal → period in seconds, 0.05 and more; every signal of the profile at its own period where empty."""
    min_poll_interval_s: float = 0.0
    """No poll of this drive more often: as the file says, else what its line can do where no period is asked for."""
    on_client_lost: OnClientLost = OnClientLost.HOLD
    on_service_stop: OnServiceStop = OnServiceStop.STOP
    on_restart: OnRestart = OnRestart.ADOPT


@dataclass(frozen=True, slots=True)
class GroupConfig:
    """Drives that are started and stopped together."""

    id: str
    drives: tuple[str, ...]
    title: Text = Text("", "")
    start_interval_s: float = 0.0
    """At least so long between two starts."""
    max_concurrent_starts: int = 1
    """So many may accelerate at a time."""
    leader: str | None = None
    ratios: Mapping[str, float] = field(default_factory=dict)
    """Drive → its frequency / the leader's."""


class InterlockAction(StrEnum):
    """What a violated interlock does."""

    STOP = "stop"
    BLOCK_START = "block_start"


@dataclass(frozen=True, slots=True)
class InterlockConfig:
    """``drives`` may run only while ``require`` holds; where a value in it is not good, it does not hold."""

    id: str
    drives: tuple[str, ...]
    require: str
    """An expression over signals, e.g. ``pump-1.output_frequency > 5 Hz and fan-1.state == running``."""
    action: InterlockAction = InterlockAction.STOP
    delay_s: float = 0.0
    title: Text = Text("", "")


class AlarmKind(StrEnum):
    """What an alarm watches."""

    ABOVE = "above"
    BELOW = "below"
    FAULT = "fault"
    NO_RESPONSE = "no_response"
    STALE = "stale"


@dataclass(frozen=True, slots=True)
class AlarmConfig:
    """One alarm over one drive or several. ``fault`` and ``silent`` exist for every drive without being written."""

    id: str
    kind: AlarmKind
    drives: tuple[str, ...]
    """Every drive where empty."""
    signal: str | None = None
    threshold: float | None = None
    """In the signal's unit."""
    hysteresis: float = 0.0
    delay_s: float = 0.0
    priority: AlarmPriority = AlarmPriority.HIGH
    title: Text = Text("", "")


@dataclass(frozen=True, slots=True, kw_only=True)
class RetentionConfig:
    """Days for which samples and rollups stay in the history."""

    raw_days: float = 2.0
    rollup_1s_days: float = 7.0
    rollup_1min_days: float = 400.0
    rollup_1h_days: float = 4000.0


@dataclass(frozen=True, slots=True, kw_only=True)
class HistoryConfig:
    """Where samples go and how long they stay. ``url`` None is SQLite in the state directory."""

    url: str | None = None
    retention: RetentionConfig = RetentionConfig()
    max_size_mb: float = 10_000.0


@dataclass(frozen=True, slots=True)
class AuditConfig:
    """Where the audit trail's second file and its key lie; on another disk or machine they show more (S12)."""

    checkpoints: Path | None = None
    """``checkpoints.jsonl`` in the state directory where None."""
    key: Path | None = None
    """Beside the state directory, as ``<its name>.audit.key``, where None."""


@dataclass(frozen=True, slots=True)
class WebConfig:
    """Where the page and the API listen. Anything but loopback needs ``certificate`` and an administrator (S15)."""

    host: str = "127.0.0.1"
    port: int = 8080
    certificate: Path | None = None
    key: Path | None = None
    origins: tuple[str, ...] = ()
    """Further origins under which the page is reached (a reverse proxy's)."""
    enabled: bool = True


@dataclass(frozen=True, slots=True)
class PlantConfig:
    """A whole ``plant.toml``."""

    id: str
    title: Text
    directory: Path
    """State directory: history, audit, users, cases, sockets."""
    buses: tuple[BusConfig, ...]
    drives: tuple[DriveConfig, ...]
    groups: tuple[GroupConfig, ...] = ()
    interlocks: tuple[InterlockConfig, ...] = ()
    alarms: tuple[AlarmConfig, ...] = ()
    history: HistoryConfig = HistoryConfig()
    audit: AuditConfig = AuditConfig()
    web: WebConfig = WebConfig()
    users: Path | None = None
    """The users' store; ``users.json`` in the state directory where None."""
    source: str = ""
    """The file it was read from."""

    def drive(self, id: str) -> DriveConfig:
        """Raises KeyError."""
        return {drive.id: drive for drive in self.drives}[id]
