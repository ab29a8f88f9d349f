"""A checked file → the values that the plant works with."""

from __future__ import annotations

import os
from pathlib import Path

from drivebus.drives.memory import DriveLimits
from drivebus.plant.config.draft import Draft
from drivebus.plant.config.polling import line_of, paced
from drivebus.plant.config.schema import AlarmTable, DriveTable, PlantFile, TextIn
from drivebus.plant.model import (
    AlarmKind,
    AlarmSetting,
    AuditSetting,
    BusSetting,
    DriveSetting,
    GroupSetting,
    HistorySetting,
    InterlockAction,
    InterlockSetting,
    OnClientLost,
    OnRestart,
    OnServiceStop,
    PlantSetting,
    Priority,
    WebSetting,
)
from drivebus.profiles.model import Text


def plant(draft: Draft, source: str) -> PlantSetting:
    """The whole plant; every check has passed."""
    file = draft.file
    buses = tuple(bus(file, id) for id in file.bus)
    return PlantSetting(
        id=file.plant.id,
        title=_text(file.plant.title, file.plant.id),
        directory=draft.path(file.plant.directory) if file.plant.directory else state_directory(file.plant.id),
        buses=buses,
        drives=_drives(draft, buses),
        groups=tuple(_groups(file)),
        interlocks=tuple(_interlocks(file)),
        alarms=tuple(_alarm(draft, id, one) for id, one in file.alarm.items()),
        history=HistorySetting(**file.history.model_dump()),
        audit=_audit(draft),
        web=_web(draft),
        users=draft.path(file.plant.users) if file.plant.users else None,
        source=source,
    )


def state_directory(id: str) -> Path:
    """Where a plant keeps its state unless the file says otherwise."""
    base = os.environ.get("XDG_STATE_HOME")
    return (Path(base) if base else Path.home() / ".local" / "state") / "drivebus" / "plants" / id


def bus(file: PlantFile, id: str) -> BusSetting:
    one = file.bus[id]
    return BusSetting(id, one.link, one.baud, one.format, _text(one.title, id))


def drive(draft: Draft, id: str, one: DriveTable) -> DriveSetting:
    return DriveSetting(
        id=id,
        bus=one.bus,
        address=one.address,
        model=draft.model(one),
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


def free(draft: Draft) -> frozenset[str]:
    """Drives that ask for no periods: they take what their line has left."""
    return frozenset(id for id, one in draft.file.drive.items() if not one.signals and one.fastest_s is None)


def on_bus(draft: Draft, of: BusSetting) -> list[DriveSetting]:
    """The drives of a bus that can be spoken to, paced to their line."""
    drives = [(drive(draft, id, one), draft.dialects[id]) for id, one in draft.on(of.id) if id in draft.dialects]
    return paced(drives, line_of(of, drives[0][1].profile), free(draft)) if drives else []


def _drives(draft: Draft, buses: tuple[BusSetting, ...]) -> tuple[DriveSetting, ...]:
    found = {one.id: one for each in buses for one in on_bus(draft, each)}
    return tuple(found[id] for id in draft.file.drive)


def _groups(file: PlantFile) -> list[GroupSetting]:
    return [
        GroupSetting(
            id, tuple(one.drives), _text(one.title, id), one.stagger_s, one.at_once, one.leader, dict(one.ratios)
        )
        for id, one in file.group.items()
    ]


def _interlocks(file: PlantFile) -> list[InterlockSetting]:
    return [
        InterlockSetting(
            id, tuple(one.drives), one.require, InterlockAction(one.action), one.delay_s, _text(one.title, id)
        )
        for id, one in file.interlock.items()
    ]


def _alarm(draft: Draft, id: str, one: AlarmTable) -> AlarmSetting:
    return AlarmSetting(
        id=id,
        kind=AlarmKind(one.kind),
        drives=tuple(watched(draft, one)),
        signal=one.signal,
        threshold=one.threshold,
        hysteresis=one.hysteresis,
        delay_s=one.delay_s,
        priority=Priority(one.priority),
        title=_text(one.title, ""),
    )


def watched(draft: Draft, alarm: AlarmTable) -> list[str]:
    """The drives of an alarm; where it names a signal and no drives, every drive that is asked for that signal."""
    if alarm.drives or alarm.signal is None:
        return alarm.drives
    return [id for id, one in draft.file.drive.items() if alarm.signal in polled(draft, id, one)]


def polled(draft: Draft, id: str, one: DriveTable) -> list[str]:
    """The signals that a drive is asked for."""
    profile = draft.profiles.get(id)
    return list(one.signals) or ([] if profile is None else list(profile.signals))


def _audit(draft: Draft) -> AuditSetting:
    audit = draft.file.audit
    return AuditSetting(
        checkpoints=draft.path(audit.checkpoints) if audit.checkpoints else None,
        key=draft.path(audit.key) if audit.key else None,
    )


def _web(draft: Draft) -> WebSetting:
    web = draft.file.web
    return WebSetting(
        host=web.host,
        port=web.port,
        certificate=draft.path(web.certificate) if web.certificate else None,
        key=draft.path(web.key) if web.key else None,
        origins=tuple(web.origins),
        enabled=web.enabled,
    )


def _text(title: TextIn | None, id: str) -> Text:
    return Text(id, id) if title is None else Text(title.en, title.zh)
