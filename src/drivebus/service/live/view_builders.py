"""What every surface sees: views of drives, buses, groups and the plant, made from what is known now."""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

from drivebus.drives.state import DriveStatus
from drivebus.service.api.errors import localized
from drivebus.service.control.permissives import start_blockers_json
from drivebus.service.live.topics import AgeingValue
from drivebus.service.live.views import DriveView, SignalView, fault_json, text_json
from drivebus.service.runtime.bus import BusRuntime
from drivebus.service.runtime.drive import DriveRuntime
from drivebus.service.runtime.plant import Plant

Json = dict[str, Any]


def drive_view(plant: Plant, unit: DriveRuntime, status: DriveStatus | None = None) -> DriveView:
    """One drive now."""
    status, now, setting = status or unit.status(), plant.now(), unit.config
    lease = plant.leases.get(unit.id, now)
    minimum, maximum = unit.drive.range_hz
    return DriveView(
        unit.id,
        setting.title,
        setting.bus,
        setting.address,
        unit.profile.model,
        unit.profile.grade,
        tuple(sorted(unit.profile.capabilities)),
        tuple(group.id for group in plant.groups_of(unit.id)),
        str(unit.bus.presence(setting.address)),
        str(status.state),
        status.reason,
        None if status.direction is None else str(status.direction),
        fault_json(status.fault),
        unit.commanded_hz,
        minimum,
        maximum,
        unit.comm_loss,
        None if lease is None else lease.view(now),
        unit.bus.start_inhibited(setting.address),
        unit.drive.stop_pending,
        tuple(start_blockers_json(plant, unit)),
        dict(plant.parts.alarms.counts(unit.id)),
        {name: SignalView.of(reading, now) for name, reading in status.readings.items()},
        _directions(unit),
        None if status.at is None else now - status.at,
        unit.profile.jog_frequency,
    )


def _directions(unit: DriveRuntime) -> tuple[str, ...]:
    can, limits = unit.profile.capabilities, unit.drive.limits
    allowed = (("forward", limits.forward and "run" in can), ("reverse", limits.reverse and "reverse" in can))
    return tuple(way for way, may in allowed if may)


def drive_topic(plant: Plant, view: DriveView, status: DriveStatus) -> Json:
    """The same for the hub, with everything that only grows older as something that counts by itself."""
    content = _without(view.as_json(), "state_age_s")
    lease = plant.leases.get(view.id, plant.now())
    if lease is not None:
        owner = {"owner": lease.actor.name, "session": lease.actor.session}
        content["lease"] = AgeingValue(owner, "expires_in_s", lease.expires_at, left=True)
    content["signals"] = {
        name: AgeingValue(_without(content["signals"][name], "age_s"), "age_s", reading.source_time)
        for name, reading in status.readings.items()
    }
    return content


def _without(fields: Json, name: str) -> Json:
    return {key: value for key, value in fields.items() if key != name}


def bus_view(plant: Plant, line: BusRuntime) -> Json:
    """One bus now. A bus counts the failures of its stations as its own too."""
    bus, setting = line.bus, line.config
    found = bus.statistics()
    own = [_station_json(unit, found.stations[unit.config.address]) for unit in line.drives.values()]
    return {
        "id": setting.id,
        "title": text_json(setting.title),
        "link": setting.link,
        "line": str(bus.settings),
        "is_open": bus.is_open and not bus.is_closed,
        "problem": None if line.problem is None else localized(line.problem.key, line.problem.params),
        "load_percent": round(found.load_percent, 1),
        "occupied_percent": round(found.occupied_percent, 1),
        "transactions_per_s": round(found.transactions_per_s, 1),
        "error_rate": round(found.error_rate, 4),
        "transactions": found.transactions,
        "replies": found.replies,
        "errors": dict(found.errors),
        "counters": dict(found.counters),
        "reply_p50_s": found.reply_p50_s,
        "reply_p95_s": found.reply_p95_s,
        "reply_p99_s": found.reply_p99_s,
        "foreign_master": bus.core.unsolicited.has_foreign_master(plant.now()),
        "stop_bound_s": line.stop_bound_s(),
        "stations": own,
    }


def _station_json(unit: DriveRuntime, found: Any) -> Json:
    return {
        "address": unit.config.address,
        "drive": unit.id,
        "presence": str(unit.bus.presence(unit.config.address)),
        "refresh_s": max((poll.period_s for poll in unit.polls), default=None),
        "error_rate": round(found.error_rate, 4),
        "reply_p50_s": found.reply_p50_s,
        "reply_p95_s": found.reply_p95_s,
        "errors": dict(found.errors),
        "counters": dict(found.counters),
        "load_percent": round(found.load_percent, 2),
    }


def plant_topic(plant: Plant) -> Json:
    """Topic ``plant``."""
    return {
        "id": plant.config.id,
        "title": text_json(plant.config.title),
        "state": plant.state,
        "stop_all": plant.last_stop_all,
        "version": version("drivebus"),
        "started_ms": plant.started_ms,
        "audit_ok": plant.parts.trail.ok,
        "history_ok": plant.parts.history.ok,
        "disk": plant.disk_space,
    }
