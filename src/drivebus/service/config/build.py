"""A checked file → the values that the plant works with."""

from __future__ import annotations

import os
from pathlib import Path

from drivebus.drives.context import DriveLimits
from drivebus.profiles.model import Text
from drivebus.service.config.model import (
    AlarmConfig,
    AlarmKind,
    AlarmPriority,
    AuditConfig,
    BusConfig,
    DriveConfig,
    GroupConfig,
    HistoryConfig,
    InterlockAction,
    InterlockConfig,
    OnClientLost,
    OnRestart,
    OnServiceStop,
    PlantConfig,
    WebConfig,
)
from drivebus.service.config.parsed import ParsedPlant
from drivebus.service.config.polling import serial_settings_of, with_sufficient_interval
from drivebus.service.config.schema import AlarmTable, DriveTable, PlantFile, TitleIn


def plant_config(draft: ParsedPlant, source: str) -> PlantConfig:
    """The whole plant; every check has passed."""
    file = draft.file
    buses = tuple(bus_config(file, id) for id in file.bus)
    return PlantConfig(
        id=file.plant.id,
        title=_text(file.plant.title, file.plant.id),
        directory=draft.resolve_path(file.plant.directory) if file.plant.directory else state_directory(file.plant.id),
        buses=buses,
        drives=_drives(draft, buses),
        groups=tuple(_groups(file)),
        interlocks=tuple(_interlocks(file)),
        alarms=tuple(_alarm(draft, id, one) for id, one in file.alarm.items()),
        history=HistoryConfig(**file.history.model_dump()),
        audit=_audit(draft),
        web=_web(draft),
        users=draft.resolve_path(file.plant.users) if file.plant.users else None,
        source=source,
    )


def state_directory(id: str) -> Path:
    """Where a plant keeps its state unless the file says otherwise."""
    base = os.environ.get("XDG_STATE_HOME")
    return (Path(base) if base else Path.home() / ".local" / "state") / "drivebus" / "plants" / id


def bus_config(file: PlantFile, id: str) -> BusConfig:
    one = file.bus[id]
    return BusConfig(id, one.link, one.baud, one.format, _text(one.title, id))


def drive_config(draft: ParsedPlant, id: str, one: DriveTable) -> DriveConfig:
    return DriveConfig(
        id=id,
        bus=one.bus,
        address=one.address,
        model=draft.model_of(one),
        title=_text(one.title, id),
        encoding=one.encoding,
        settings=dict(one.settings),
        limits=DriveLimits(**one.limits.model_dump()),
        signals=dict(one.signals),
        fastest_s=one.fastest_s or 0.0,
        on_client_lost=OnClientLost(one.on_client_lost),
        on_service_stop=OnServiceStop(one.on_service_stop),
        on_restart=OnRestart(one.on_restart),
    )


def unpaced_drives(draft: ParsedPlant) -> frozenset[str]:
    """Drives that ask for no periods: they take what their line has left."""
    return frozenset(id for id, one in draft.file.drive.items() if not one.signals and one.fastest_s is None)


def drives_on_bus(draft: ParsedPlant, of: BusConfig) -> list[DriveConfig]:
    """The drives of a bus that can be spoken to, paced to their line."""
    drives = [
        (drive_config(draft, id, one), draft.dialects[id]) for id, one in draft.drives_on(of.id) if id in draft.dialects
    ]
    return (
        with_sufficient_interval(drives, serial_settings_of(of, drives[0][1].profile), unpaced_drives(draft))
        if drives
        else []
    )


def _drives(draft: ParsedPlant, buses: tuple[BusConfig, ...]) -> tuple[DriveConfig, ...]:
    found = {one.id: one for each in buses for one in drives_on_bus(draft, each)}
    return tuple(found[id] for id in draft.file.drive)


def _groups(file: PlantFile) -> list[GroupConfig]:
    return [
        GroupConfig(
            id, tuple(one.drives), _text(one.title, id), one.stagger_s, one.at_once, one.leader, dict(one.ratios)
        )
        for id, one in file.group.items()
    ]


def _interlocks(file: PlantFile) -> list[InterlockConfig]:
    return [
        InterlockConfig(
            id, tuple(one.drives), one.require, InterlockAction(one.action), one.delay_s, _text(one.title, id)
        )
        for id, one in file.interlock.items()
    ]


def _alarm(draft: ParsedPlant, id: str, one: AlarmTable) -> AlarmConfig:
    return AlarmConfig(
        id=id,
        kind=AlarmKind(one.kind),
        drives=tuple(alarm_drives(draft, one)),
        signal=one.signal,
        threshold=one.threshold,
        hysteresis=one.hysteresis,
        delay_s=one.delay_s,
        priority=AlarmPriority(one.priority),
        title=_text(one.title, ""),
    )


def alarm_drives(draft: ParsedPlant, alarm: AlarmTable) -> list[str]:
    """The drives of an alarm; where it names a signal and no drives, every drive that is asked for that signal."""
    if alarm.drives or alarm.signal is None:
        return alarm.drives
    return [id for id, one in draft.file.drive.items() if alarm.signal in polled_signals(draft, id, one)]


def polled_signals(draft: ParsedPlant, id: str, one: DriveTable) -> list[str]:
    """The signals that a drive is asked for."""
    profile = draft.profiles.get(id)
    return list(one.signals) or ([] if profile is None else list(profile.signals))


def _audit(draft: ParsedPlant) -> AuditConfig:
    audit = draft.file.audit
    return AuditConfig(
        checkpoints=draft.resolve_path(audit.checkpoints) if audit.checkpoints else None,
        key=draft.resolve_path(audit.key) if audit.key else None,
    )


def _web(draft: ParsedPlant) -> WebConfig:
    web = draft.file.web
    return WebConfig(
        host=web.host,
        port=web.port,
        certificate=draft.resolve_path(web.certificate) if web.certificate else None,
        key=draft.resolve_path(web.key) if web.key else None,
        origins=tuple(web.origins),
        enabled=web.enabled,
    )


def _text(title: TitleIn | None, id: str) -> Text:
    return Text(id, id) if title is None else Text(title.en, title.zh)
