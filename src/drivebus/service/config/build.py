"""Parsed plant file and the configuration built from it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from drivebus import profiles
from drivebus.drives.context import DriveLimits
from drivebus.drives.dialects.base import Dialect
from drivebus.errors import ProfileError
from drivebus.ports.url import PortUrl
from drivebus.profiles.diagnostics import Diagnostic
from drivebus.profiles.load import model_name
from drivebus.profiles.model import DriveProfile
from drivebus.service.config.bus_load import serial_settings_of, with_sufficient_interval
from drivebus.service.config.gateways import installed_gateways
from drivebus.service.config.model import (
    AlarmConfig,
    AlarmKind,
    AlarmPriority,
    AuditConfig,
    BusConfig,
    DriveConfig,
    GatewayConfig,
    GroupConfig,
    HistoryConfig,
    InterlockAction,
    InterlockConfig,
    OnClientLost,
    OnRestart,
    OnServiceStop,
    PlantConfig,
    RetentionConfig,
)
from drivebus.service.config.schema import AlarmTable, DriveTable, HistoryTable, PlantFile, Title
from drivebus.user_directories import expand_home, user_state_directory
from drivebus.values import Text


@dataclass(slots=True, kw_only=True)
class ParsedPlant:
    """Well-formed part of a plant file. The checks fill in profiles, ports and dialects."""

    file: PlantFile
    raw: Mapping[str, Any]
    """The whole file: a table with a fault is still known by its id."""
    base: Path
    """Folder that relative paths start from."""
    may_read_model: Callable[[Path], bool] = lambda path: True
    """Whether a profile file may be read; other files are reported, without a word about their content."""
    unread_models: set[str] = field(default_factory=set)
    """Drives whose profile file may not be read."""
    profiles: dict[str, DriveProfile] = field(default_factory=dict)
    """Drive → profile, where it could be loaded."""
    profile_errors: dict[str, ProfileError] = field(default_factory=dict)
    """Drive → error of loading its profile."""
    port_urls: dict[str, PortUrl] = field(default_factory=dict)
    dialects: dict[str, Dialect] = field(default_factory=dict)

    def known_ids(self, table: str) -> list[str]:
        """Return the ids of ``[bus.…]`` or ``[drive.…]``, including those of faulty tables."""
        section = self.raw.get(table)
        return [str(name) for name in section] if isinstance(section, Mapping) else []

    def drive_tables_of(self, bus: str) -> Iterator[tuple[str, DriveTable]]:
        """Yield the drives of a bus in the order of the file, which is the order of the cable."""
        return ((name, drive) for name, drive in self.file.drive.items() if drive.bus == bus)

    def model_of(self, drive: DriveTable) -> str:
        """Return a model's name as the profiles spell it, or the absolute path of a profile file."""
        if not is_model_path(drive.model):
            return model_name(drive.model)
        return str((self.base / expand_home(drive.model)).resolve())

    def resolve_path(self, text: str) -> Path:
        return self.named_path(text).resolve()

    def named_path(self, text: str) -> Path:
        """Return an absolute path without following links."""
        return (self.base / expand_home(text)).absolute()

    def read_profiles(self) -> None:
        """Load the profile of every drive; each model is read once."""
        read: dict[str, DriveProfile | ProfileError] = {}
        for name, drive in self.file.drive.items():
            model = self.model_of(drive)
            if is_model_path(drive.model) and not self.may_read_model(Path(model)):
                self.unread_models.add(name)
                continue
            if model not in read:
                try:
                    read[model] = profiles.load(model)
                except ProfileError as error:
                    read[model] = error
            profile = read[model]
            if isinstance(profile, DriveProfile):
                self.profiles[name] = profile
            else:
                self.profile_errors[name] = profile


def is_model_path(model: str) -> bool:
    return model.endswith(".toml") or "/" in model or "\\" in model


def plant_config(parsed: ParsedPlant, source: str, warnings: Iterable[Diagnostic]) -> PlantConfig:
    """Build the configuration of a plant that has passed every check."""
    file = parsed.file
    buses = tuple(bus_config(file, id) for id in file.bus)
    return PlantConfig(
        id=file.plant.id,
        title=_text(file.plant.title, file.plant.id),
        directory=parsed.resolve_path(file.plant.directory) if file.plant.directory else state_directory(file.plant.id),
        buses=buses,
        drives=_drives(parsed, buses),
        groups=tuple(_groups(file)),
        interlocks=tuple(_interlocks(file)),
        alarms=tuple(_alarm(parsed, id, table) for id, table in file.alarm.items()),
        history=_history(file.history),
        audit=_audit(parsed),
        gateways=tuple(_gateways(parsed)),
        users=parsed.resolve_path(file.plant.users) if file.plant.users else None,
        source=source,
        named_paths=tuple(
            parsed.named_path(text) for text in (file.plant.directory, file.plant.users, file.audit.key) if text
        ),
        named_audit_files=tuple(parsed.named_path(text) for text in (file.audit.checkpoints, file.audit.head) if text),
        warnings=tuple(warnings),
    )


def state_directory(id: str) -> Path:
    """Return the default state directory of a plant."""
    return user_state_directory() / "plants" / id


def bus_config(file: PlantFile, id: str) -> BusConfig:
    table = file.bus[id]
    return BusConfig(id, table.port, table.baud, table.format, _text(table.title, id))


def drive_config(parsed: ParsedPlant, id: str, table: DriveTable) -> DriveConfig:
    return DriveConfig(
        id=id,
        bus=table.bus,
        address=table.address,
        model=parsed.model_of(table),
        title=_text(table.title, id),
        encoding=table.encoding,
        options=dict(table.options),
        limits=DriveLimits(**table.limits.model_dump()),
        signals=dict(table.signals),
        min_poll_interval_s=table.min_poll_interval_s or 0.0,
        on_client_lost=OnClientLost(table.on_client_lost),
        on_service_stop=OnServiceStop(table.on_service_stop),
        on_restart=OnRestart(table.on_restart),
    )


def drives_without_interval(parsed: ParsedPlant) -> frozenset[str]:
    """Return the drives without a configured poll interval: they share what their bus has left."""
    return frozenset(id for id, table in parsed.file.drive.items() if table.min_poll_interval_s is None)


def drives_on_bus(parsed: ParsedPlant, bus: BusConfig) -> list[DriveConfig]:
    """Return the drives of a bus with a dialect, with poll intervals that the bus can carry."""
    drives = [
        (drive_config(parsed, id, table), parsed.dialects[id])
        for id, table in parsed.drive_tables_of(bus.id)
        if id in parsed.dialects
    ]
    return (
        with_sufficient_interval(drives, serial_settings_of(bus, drives[0][1].profile), drives_without_interval(parsed))
        if drives
        else []
    )


def _drives(parsed: ParsedPlant, buses: tuple[BusConfig, ...]) -> tuple[DriveConfig, ...]:
    drives = {drive.id: drive for bus in buses for drive in drives_on_bus(parsed, bus)}
    return tuple(drives[id] for id in parsed.file.drive)


def _groups(file: PlantFile) -> list[GroupConfig]:
    return [
        GroupConfig(
            id=id,
            drives=tuple(table.drives),
            title=_text(table.title, id),
            start_interval_s=table.start_interval_s,
            max_concurrent_starts=table.max_concurrent_starts,
            leader=table.leader,
            ratios=dict(table.ratios),
        )
        for id, table in file.group.items()
    ]


def _interlocks(file: PlantFile) -> list[InterlockConfig]:
    return [
        InterlockConfig(
            id=id,
            drives=tuple(table.drives),
            require=table.require,
            action=InterlockAction(table.action),
            delay_s=table.delay_s,
            title=_text(table.title, id),
        )
        for id, table in file.interlock.items()
    ]


def _alarm(parsed: ParsedPlant, id: str, table: AlarmTable) -> AlarmConfig:
    return AlarmConfig(
        id=id,
        kind=AlarmKind(table.kind),
        drives=tuple(alarm_drives(parsed, table)),
        signal=table.signal,
        threshold=table.threshold,
        hysteresis=table.hysteresis,
        delay_s=table.delay_s,
        priority=AlarmPriority(table.priority),
        title=_text(table.title, ""),
    )


def alarm_drives(parsed: ParsedPlant, alarm: AlarmTable) -> list[str]:
    """Return the drives of an alarm: those named, else every drive that polls its signal."""
    if alarm.drives or alarm.signal is None:
        return alarm.drives
    return [id for id, table in parsed.file.drive.items() if alarm.signal in polled_signals(parsed, id, table)]


def polled_signals(parsed: ParsedPlant, id: str, table: DriveTable) -> list[str]:
    """Return the signals that a drive polls."""
    profile = parsed.profiles.get(id)
    return list(table.signals) or ([] if profile is None else list(profile.signals))


def _history(table: HistoryTable) -> HistoryConfig:
    retention = RetentionConfig(**table.retention.model_dump())
    return HistoryConfig(url=table.url, retention=retention, max_size_mb=table.max_size_mb)


def _audit(parsed: ParsedPlant) -> AuditConfig:
    audit = parsed.file.audit
    return AuditConfig(
        checkpoints=parsed.resolve_path(audit.checkpoints) if audit.checkpoints else None,
        key=parsed.resolve_path(audit.key) if audit.key else None,
        head=parsed.resolve_path(audit.head) if audit.head else None,
    )


def _gateways(parsed: ParsedPlant) -> Iterator[GatewayConfig]:
    for name, table in parsed.file.gateway.configured():
        gateway = installed_gateways()[name]
        settings = gateway.settings(table, parsed.named_path)
        yield GatewayConfig(
            id=name,
            module=gateway.module,
            settings=settings,
            enabled=table.enabled,
            extra=gateway.extra,
            certificates=tuple(gateway.certificates(settings)),
            address=gateway.address(settings),
            listens_at=gateway.listens_at(settings),
        )


def _text(title: Title | None, id: str) -> Text:
    return Text.from_mapping(title or {"en": id})
