"""Live topics of a plant: the objects of drives, buses, groups and the plant, and when they are published."""

from __future__ import annotations

from importlib.metadata import version

from drivebus.bus.statistics import StationStatistics
from drivebus.drives.state import DriveStatus
from drivebus.errors import DrivebusError
from drivebus.service.api.errors import error_to_json, localized
from drivebus.service.config.model import GroupConfig
from drivebus.service.control.groups import GroupCommands
from drivebus.service.control.start_blockers import start_blockers_json
from drivebus.service.live.views import DriveView, SignalView, fault_json, text_json
from drivebus.service.runtime.bus import BusRuntime
from drivebus.service.runtime.drive import DriveRuntime
from drivebus.service.runtime.plant import Plant
from drivebus.types import Json

SERVICE_VERSION = version("drivebus")  # read once: an update replaces the files of the running service


class LivePublisher:
    """Publisher of live topics and samples. The supervision cycle calls it; drives also with every new status."""

    def __init__(self, plant: Plant, groups: GroupCommands) -> None:
        self._plant, self._groups = plant, groups

    def on_status(self, drive: DriveRuntime, status: DriveStatus) -> None:
        """Take in a new status of a drive's monitor."""
        self._record_samples(drive, status)
        if self._plant.drives.get(drive.id) is drive and self._plant.hub.subscriber_count:
            self._publish(drive_view(self._plant, drive, status))

    def publish_drive(self, drive: DriveRuntime, status: DriveStatus) -> DriveView:
        """Publish a drive in a supervision cycle: readings that became old, and what its monitor does not report."""
        self._record_samples(drive, status)
        view = drive_view(self._plant, drive, status)
        self._publish(view)
        return view

    def _record_samples(self, drive: DriveRuntime, status: DriveStatus) -> None:
        self._plant.record_samples(drive.new_samples(status.readings, self._plant.wall_ms()))

    def _publish(self, view: DriveView) -> None:
        content = view.as_json()
        del content["time_ms"]
        self._plant.hub.publish(f"drives/{view.id}", content)

    def publish_bus(self, bus: BusRuntime) -> None:
        self._plant.hub.publish(f"buses/{bus.config.id}", bus_view(bus))

    def publish_group(self, group: GroupConfig) -> None:
        self._plant.hub.publish(f"groups/{group.id}", self._groups.group_view(group))

    def publish_plant(self) -> None:
        """Publish the topics ``alarms`` and ``plant``."""
        self._plant.hub.publish("alarms", self._plant.alarms.as_json())
        self._plant.hub.publish("plant", plant_topic(self._plant))


def drive_view(plant: Plant, runtime: DriveRuntime, status: DriveStatus | None = None) -> DriveView:
    """Return the present view of a drive."""
    status, now, config = status or runtime.status(), plant.now(), runtime.config
    lease = plant.leases.get(runtime.id, now)
    request = plant.control_requests.get(runtime.id)
    minimum, maximum = runtime.drive.range_hz
    return DriveView(
        id=runtime.id,
        title=config.title,
        bus=config.bus,
        address=config.address,
        model=runtime.profile.model,
        grade=runtime.profile.grade,
        capabilities=tuple(sorted(runtime.profile.capabilities)),
        groups=tuple(group.id for group in plant.groups_of(runtime.id)),
        presence=str(runtime.bus.presence(config.address)),
        state=str(status.state),
        state_reason=status.reason,
        direction=None if status.direction is None else str(status.direction),
        fault=fault_json(status.fault),
        commanded_hz=runtime.commanded_hz,
        minimum_hz=minimum,
        maximum_hz=maximum,
        above_limit_hz=runtime.above_limit_hz(status),
        setpoint_cap_hz=runtime.drive.setpoint_cap_hz,
        comm_loss=runtime.comm_loss.view,
        lease=None if lease is None else lease.view(plant.clock),
        control_request=None if request is None else request.view(plant.clock),
        start_inhibited=runtime.bus.start_inhibited(config.address),
        last_stop=runtime.last_stop,
        stop_pending=runtime.drive.stop_pending,
        start_blockers=tuple(start_blockers_json(plant, runtime)),
        alarms=dict(plant.alarms.counts(runtime.id)),
        signals={name: SignalView.of(reading, plant.clock) for name, reading in status.readings.items()},
        directions=_directions(runtime),
        time_ms=plant.clock.now_ms(),
        state_time_ms=plant.clock.utc_ms(status.at),
        poll_interval_s=min((poll.period_s for poll in runtime.polls), default=None) if runtime.bus.is_open else None,
        requested_interval_s=min((runtime.profile.signals[name].period_s for name in runtime.signals), default=None),
        unusable_reply=_unusable_reply_json(status),
        jog_frequency=runtime.profile.jog_frequency,
    )


def _unusable_reply_json(status: DriveStatus) -> Json | None:
    return error_to_json(status.unusable_reply) if isinstance(status.unusable_reply, DrivebusError) else None


def _directions(runtime: DriveRuntime) -> tuple[str, ...]:
    can, limits = runtime.profile.capabilities, runtime.drive.limits
    allowed = (("forward", limits.forward and "run" in can), ("reverse", limits.reverse and "reverse" in can))
    return tuple(way for way, may in allowed if may)


def bus_view(bus_runtime: BusRuntime) -> Json:
    """Return the topic of a bus. Its figures include the failures of its stations."""
    bus, config = bus_runtime.bus, bus_runtime.config
    statistics = bus.statistics()
    own = [
        _station_json(runtime, statistics.stations[runtime.config.address]) for runtime in bus_runtime.drives.values()
    ]
    return {
        "id": config.id,
        "title": text_json(config.title),
        "port": config.port,
        "serial": str(bus.settings),
        "is_open": bus.is_open and not bus.is_closed,
        "problem": None
        if bus_runtime.problem is None
        else localized(bus_runtime.problem.key, bus_runtime.problem.params),
        "slow_adapter": None
        if (slow_adapter := bus_runtime.adapter_latency()) is None
        else localized("ports.latency_cost", slow_adapter.text_params(bus_runtime.title)),
        "load_percent": round(statistics.load_percent, 1),
        "occupied_percent": round(statistics.occupied_percent, 1),
        "transactions_per_s": round(statistics.transactions_per_s, 1),
        "error_rate": round(statistics.error_rate, 4),
        "transactions": statistics.transactions,
        "replies": statistics.replies,
        "errors": dict(statistics.errors),
        "counters": dict(statistics.counters),
        "reply_p50_s": statistics.reply_p50_s,
        "reply_p95_s": statistics.reply_p95_s,
        "reply_p99_s": statistics.reply_p99_s,
        "foreign_master": bus.foreign_master,
        "stop_bound_s": bus_runtime.stop_bound_s(),
        "stations": own,
    }


def _station_json(runtime: DriveRuntime, station: StationStatistics) -> Json:
    return {
        "address": runtime.config.address,
        "drive": runtime.id,
        "presence": str(runtime.bus.presence(runtime.config.address)),
        "refresh_s": max((poll.period_s for poll in runtime.polls), default=None),
        "error_rate": round(station.error_rate, 4),
        "reply_p50_s": station.reply_p50_s,
        "reply_p95_s": station.reply_p95_s,
        "errors": dict(station.errors),
        "counters": dict(station.counters),
        "load_percent": round(station.load_percent, 2),
    }


def plant_topic(plant: Plant) -> Json:
    """Return the content of the topic ``plant``: state, last stop of everything, disk, clock, gateways."""
    return {
        "id": plant.config.id,
        "title": text_json(plant.config.title),
        "state": plant.state,
        "stop_all": plant.last_stop_all,
        "notice": plant.notice,
        "version": SERVICE_VERSION,
        "started_ms": plant.started_ms,
        "audit_ok": plant.audit.ok,
        "history_ok": plant.historian.ok,
        "write_failures": plant.write_failures(),
        "disk": plant.disk_space,
        "clock_synchronized": plant.clock_synchronized,
        "gateways": [plant.gateways[name].as_json() for name in sorted(plant.gateways)],
    }
