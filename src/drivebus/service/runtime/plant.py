"""Shared state of a running service: buses and drives, control, events, alarms and storage."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import Any, TypeVar

from drivebus.drives.context import DriveLimits
from drivebus.drives.outcome import Outcome, OutcomeStatus
from drivebus.drives.state import DriveStatus
from drivebus.drives.store import Store
from drivebus.errors import NotFound, ServiceError, Superseded
from drivebus.service.alarms import AlarmChange, AlarmEngine, SystemAlarm
from drivebus.service.alarms.model import WRITE_FAILURE_ALARMS
from drivebus.service.api.errors import localized
from drivebus.service.api.frames import frame_json
from drivebus.service.audit import AuditTrail
from drivebus.service.config.bus_load import profile_of
from drivebus.service.config.model import AlarmKind, BusConfig, DriveConfig, GroupConfig, PlantConfig, title_of
from drivebus.service.control.comm_loss_record import CommLossRecord
from drivebus.service.control.control_requests import ControlRequests
from drivebus.service.control.leases import ArmTokens, ControlLeases, arm_target_of_group, arm_target_of_test
from drivebus.service.control.waivers import CommLossWaiver
from drivebus.service.historian import Historian
from drivebus.service.interlocks.engine import InterlockEngine
from drivebus.service.live.hub import Hub
from drivebus.service.live.views import DriveView, Sample, StopKind, StopObject
from drivebus.service.process.logging_setup import log_event
from drivebus.service.runtime.bus import BusRuntime, TracedFrame
from drivebus.service.runtime.drive import DriveRuntime
from drivebus.service.runtime.failure_log import failure_logged
from drivebus.service.runtime.run_statistics import RunStatisticsStore
from drivebus.service.runtime.utc_clock import UtcClock
from drivebus.service.storage.settings import SETTINGS_FILE, DriveIdentity, StoredSettings
from drivebus.types import Json
from drivebus.values import Text

T = TypeVar("T")

MAX_NAMES_IN_ERROR = 20  # a plant may have hundreds of drives
SEPARATELY_LOGGED_ALARMS = frozenset({str(AlarmKind.NO_RESPONSE), str(AlarmKind.FAULT), str(SystemAlarm.PORT_LOST)})
"""Alarms whose cause is logged by an event of its own."""


@dataclass(slots=True)
class StopStatistics:
    """Stops of single drives since the service started; a stop of the plant counts once for each drive."""

    requested: int = 0
    confirmed: int = 0
    """Standstill was read."""
    acknowledged: int = 0
    """The drive acknowledged the stop; its state can't be read."""

    def count_outcome(self, outcome: Outcome) -> None:
        self.confirmed += outcome.status is OutcomeStatus.CONFIRMED
        self.acknowledged += outcome.status is OutcomeStatus.ACKNOWLEDGED

    def as_json(self) -> Json:
        return asdict(self)


@dataclass(slots=True, kw_only=True)
class GatewayStatus:
    """Process of one gateway."""

    id: str
    pid: int | None = None
    """None: it is about to be started, or started again after a pause."""
    starts: int = 0
    exit_code: int | None = None
    """Exit code of the last process that ended by itself; negative: the signal that ended it."""

    def as_json(self) -> Json:
        return {**asdict(self), "running": self.pid is not None}


class PlantListener:
    """Receiver of what happens in a plant: subclasses override what they need. No method may wait."""

    def on_event(self, event: Json) -> None: ...

    def on_alarm(self, change: AlarmChange) -> None: ...

    def on_samples(self, samples: Sequence[Sample]) -> None:
        """Handle new samples of one drive, at least one."""

    def on_view(self, view: DriveView) -> None:
        """Handle a new view of a drive, from every supervision cycle."""

    def on_drive_removed(self, drive: str) -> None:
        """Handle that a drive left its bus: a reload removed it, or gave its name to another motor."""

    def on_repeated_stop(self, drive: DriveRuntime, outcome: Outcome) -> None:
        """Handle that a drive has confirmed a stop when it was repeated."""

    def on_control_end(self, drive: str) -> None:
        """Handle that the session that controlled a drive no longer does; another one may control it by now."""

    def on_reload(self) -> None:
        """Handle a reload: the plant has another configuration."""


@dataclass(kw_only=True)
class Plant:
    """Shared state of a running service. ``now`` is monotonic; ``wall_ms`` (UTC milliseconds) is for labels only."""

    config: PlantConfig
    now: Callable[[], float]
    wall_ms: Callable[[], int]
    clock: UtcClock
    hub: Hub
    audit: AuditTrail
    historian: Historian
    run_statistics: RunStatisticsStore
    alarms: AlarmEngine
    interlocks: InterlockEngine
    store: Store
    """Waivers and limits, which outlive the process."""
    drive_store: Store | None
    """Calibrations and EEPROM write counts; None: the default of ``Drive``."""
    views: dict[str, DriveView] = field(default_factory=dict)
    """Newest view of each drive."""
    buses: dict[str, BusRuntime] = field(default_factory=dict)
    drives: dict[str, DriveRuntime] = field(default_factory=dict)
    leases: ControlLeases = field(init=False)
    control_requests: ControlRequests = field(default_factory=ControlRequests)
    arm_tokens: ArmTokens = field(default_factory=ArmTokens)
    stop_counts: Counter[str] = field(default_factory=Counter)
    """Drive → number of its stop requests: a command with an older count is superseded. A reload keeps it."""
    control_end_counts: Counter[str] = field(default_factory=Counter)
    """Drive → how often a session has ceased to control it."""
    state: str = "running"
    started_ms: int = 0
    last_stop_all: Json | None = None
    notice: Json | None = None
    """Text in both languages that the page shows to every user; the demo describes its steps with it."""
    gateways: dict[str, GatewayStatus] = field(default_factory=dict)
    """Gateways that run or are restarted, by name."""
    disk_space: Json = field(default_factory=dict)
    """Free space of the state directory, in MiB."""
    clock_synchronized: bool | None = None
    """Whether the clock of this computer is synchronized; None while unknown."""
    command_count: int = 0
    """Number of the last command, for its id."""
    event_count: int = 0
    stop_statistics: StopStatistics = field(default_factory=StopStatistics)
    _listeners: list[PlantListener] = field(default_factory=list)
    _last_command_at: float = float("-inf")
    """Monotonic time of the last command that may have changed any drive."""
    _last_commands_at: dict[str, float] = field(default_factory=dict)
    """Drive → monotonic time of the last command that may have changed this drive."""

    def __post_init__(self) -> None:
        self.leases = ControlLeases(self._on_control_end)

    def subscribe(self, listener: PlantListener) -> None:
        """Notify ``listener`` of everything that happens from now on."""
        self._listeners.append(listener)

    # --- buses and drives ---------------------------------------------------------------------------------------

    def add_bus(self, config: BusConfig, drives: Sequence[DriveConfig]) -> BusRuntime:
        """Add a bus, not opened yet. ``drives``: of the whole plant; the first one's profile completes its settings."""
        profile = next((profile_of(drive) for drive in drives if drive.bus == config.id), None)
        bus = BusRuntime(
            config, profile, wall_ms=self.wall_ms, on_problem=self._on_bus_problem, on_frame=self._on_frame
        )
        self.buses[config.id] = bus
        return bus

    def add_drive(self, config: DriveConfig, on_status: Callable[[DriveRuntime, DriveStatus], None]) -> DriveRuntime:
        """Add a drive to its bus. ``on_status`` is called with each new status of its monitor."""
        drive = self.buses[config.bus].add_drive(
            config, on_status=on_status, on_repeated_stop=self._on_repeated_stop, store=self.drive_store
        )
        drive.added_at = self.now()
        self.drives[drive.id] = drive
        self.restore(drive)
        return drive

    def _on_repeated_stop(self, drive: DriveRuntime, outcome: Outcome) -> None:
        for listener in self._listeners:
            with failure_logged():
                listener.on_repeated_stop(drive, outcome)

    def _on_bus_problem(self, key: str, params: Json) -> None:
        self.publish_event("presence", None, key, **params)

    def _on_frame(self, bus: BusRuntime, frame: TracedFrame) -> None:
        topic = f"frames/{bus.config.id}"
        if self.hub.has_subscriber(topic):
            self.hub.append(topic, partial(frame_json, bus, frame))

    def put_view(self, view: DriveView) -> None:
        """Take in the view of a drive that a supervision cycle has made."""
        self.views[view.id] = view
        self.run_statistics.on_view(view, self.now(), self.wall_ms())
        for listener in self._listeners:
            listener.on_view(view)

    def remove_drive(self, drive: str) -> None:
        """Discard what is known of a drive that is no longer part of the plant."""
        self.leases.remove_drive(drive)
        self.control_requests.remove_drive(drive)
        self.views.pop(drive, None)
        self._last_commands_at.pop(drive, None)
        self.hub.remove(f"drives/{drive}")
        self.notify_drive_removed(drive)

    def notify_drive_removed(self, drive: str) -> None:
        """Call the listeners after a drive left its bus, for good or to be replaced."""
        for listener in self._listeners:
            listener.on_drive_removed(drive)

    def notify_reload(self) -> None:
        """Call the listeners after ``config`` was replaced and applied."""
        for listener in self._listeners:
            listener.on_reload()

    def record_samples(self, samples: Sequence[Sample]) -> None:
        """Pass the new samples of one drive to the historian and the listeners."""
        if samples:
            self.historian.append(samples)
            for listener in self._listeners:
                listener.on_samples(samples)

    def drive_runtime(self, id: str) -> DriveRuntime:
        """Return the runtime of a drive. Raises NotFound."""
        return _lookup(self.drives, "drive", id)

    def bus_runtime(self, id: str) -> BusRuntime:
        """Return the runtime of a bus. Raises NotFound."""
        return _lookup(self.buses, "bus", id)

    def group(self, id: str) -> GroupConfig:
        """Return the configuration of a group. Raises NotFound."""
        return _lookup({group.id: group for group in self.config.groups}, "group", id)

    def selected(self, drives: Iterable[str], group: str | None, *, everything: bool) -> list[DriveRuntime]:
        """Return drives by name, those of a group, or every one. Raises NotFound; ServiceError for none."""
        names = [*drives, *(() if group is None else self.group(group).drives), *(self.drives if everything else ())]
        if not names:
            raise ServiceError("plant.no_selection")
        return [self.drive_runtime(id) for id in dict.fromkeys(names)]

    def bus_of(self, runtime: DriveRuntime) -> BusRuntime:
        return self.buses[runtime.config.bus]

    def groups_of(self, id: str) -> list[GroupConfig]:
        return [group for group in self.config.groups if id in group.drives]

    def followers(self, leader: str) -> list[tuple[GroupConfig, DriveRuntime]]:
        """Return the drives that follow a leader's frequency: those of its group that this service started."""
        found = [(group, id) for group in self.groups_of(leader) if group.leader == leader for id in group.drives]
        return [
            (group, self.drive_runtime(id))
            for group, id in found
            if id != leader and self.drive_runtime(id).started_by_service
        ]

    def record_command(self, drives: Collection[str]) -> None:
        """Record that a command, stop or setting was done or failed; empty ``drives``: it may have changed any.

        A drive that a reload has removed meanwhile is left out.
        """
        now = self.now()
        self._last_commands_at.update({drive: now for drive in drives if drive in self.drives})
        if not drives:
            self._last_command_at = now

    def last_command_at(self, drive: str) -> float:
        """Return the monotonic time of the last command that may have changed a drive: older views may not show it."""
        return max(self._last_command_at, self._last_commands_at.get(drive, self._last_command_at))

    def command_id(self, word: str) -> str:
        """Return an id for a command, unique while the service runs."""
        self.command_count += 1
        return f"{word}-{self.command_count}"

    def publish_event(
        self,
        kind: str,
        drive: str | None,
        key: str,
        /,
        *,
        actor: str | None = None,
        outcome: str | None = None,
        **params: Any,
    ) -> None:
        """Publish an event: to live clients, the history and the log."""
        self.publish_event_text(kind, drive, localized(key, params), actor, outcome)

    def publish_event_text(
        self, kind: str, drive: str | None, text: Json, actor: str | None, outcome: str | None, *, log: bool = True
    ) -> None:
        """Publish an event whose text is ready in both languages."""
        self.event_count += 1
        event = {
            "id": f"{self.started_ms}-{self.event_count}",
            "time_ms": self.wall_ms(),
            "kind": kind,
            "drive": drive,
            "text": text,
            "actor": actor,
            "outcome": outcome,
        }
        self.hub.append("events", event)
        self.historian.put_event(event)
        for listener in self._listeners:
            listener.on_event(event)
        if log:
            log_event(event)

    def raise_alarm(self, kind: SystemAlarm, drive: str = "", **params: Any) -> None:
        """Raise a system alarm. ``params`` as for ``AlarmEngine.raise_alarm``."""
        self.publish_alarms(self.alarms.raise_alarm(kind, drive, self.wall_ms(), **params))

    def clear_alarm(self, kind: SystemAlarm, drive: str = "", *, subject: str = "") -> None:
        """Clear a system alarm; there may be none."""
        self.publish_alarms(self.alarms.clear_alarm(kind, drive, self.wall_ms(), subject=subject))

    def report_damaged(self, subject: str, copy: str) -> None:
        """Raise the alarm of what was put aside as ``copy`` at this start; clear it where ``copy`` is empty."""
        if copy:
            self.raise_alarm(SystemAlarm.FILE_DAMAGED, subject=subject, copy=copy)
        else:
            self.clear_alarm(SystemAlarm.FILE_DAMAGED, subject=subject)

    def write_failures(self) -> list[str]:
        """Return the files, and the history, that can't be written at present."""
        return sorted(
            alarm.subject
            for alarm in self.alarms.active()
            if alarm.kind in WRITE_FAILURE_ALARMS and alarm.cleared_ms is None
        )

    def publish_alarms(self, changes: Sequence[AlarmChange]) -> None:
        """Publish changes of alarms as events, except the link to an incident, which the alarm itself shows."""
        for change in changes:
            for listener in self._listeners:
                listener.on_alarm(change)
        for word, alarm in ((change.action, change.alarm) for change in changes if change.action != "incident"):
            suffix = "_again" if word == "raised" and alarm.count > 1 else ""
            text = localized(f"plant.alarm_{word}{suffix}", {"text": alarm.text, "count": alarm.count})
            actor = {"acknowledged": alarm.acknowledged_by, "shelved": alarm.shelved_by}.get(word)
            self.publish_event_text(
                "alarm", alarm.drive or None, text, actor, word, log=alarm.kind not in SEPARATELY_LOGGED_ALARMS
            )

    def record_stop_request(self, *runtimes: DriveRuntime, by: str, kind: StopKind) -> None:
        """Record a stop request of these drives by the user ``by``; revoke the arm tokens of them and their groups."""
        for runtime in runtimes:
            self.revoke_arm_tokens(runtime.id)
            runtime.last_stop, runtime.stop_record = StopObject(kind, by, self.wall_ms()), None
            self.stop_counts[runtime.id] += 1
            self.stop_statistics.requested += 1

    def revoke_arm_tokens(self, drive: str) -> None:
        """Invalidate the arm tokens of a drive and of its groups."""
        groups = (arm_target_of_group(group.id) for group in self.groups_of(drive))
        self.arm_tokens.revoke(drive, arm_target_of_test(drive), *groups)

    def _on_control_end(self, drive: str) -> None:
        """Withdraw what was not sent yet of a session that no longer controls a drive, and its arm tokens."""
        self.control_end_counts[drive] += 1
        self.revoke_arm_tokens(drive)
        if drive in self.drives:
            with failure_logged():
                self.drives[drive].withdraw_commands(Superseded("plant.control_ended_meanwhile", drive=drive))
        for listener in self._listeners:
            with failure_logged():
                listener.on_control_end(drive)

    # --- what outlives the process ------------------------------------------------------------------------------

    def restore(self, runtime: DriveRuntime) -> None:
        """Restore the stored waiver and limits of a drive. Where they can't be read, it has no waiver and no limits.

        Limits also hold for another motor of this name, because they can only narrow those of the configuration.
        """
        settings = StoredSettings.of(self.store, runtime.id)
        self._restore_waiver(runtime, settings.waiver)
        self._restore_comm_loss_record(runtime, settings.comm_loss_record)
        runtime.limits_lost = settings.limits_lost
        own = settings.limits
        runtime.set_limits(None if own is None else narrow_limits(own, runtime.config.limits))
        set_for = settings.limits_set_for
        if set_for == DriveIdentity.of(runtime.config, self.bus_of(runtime).config):
            set_for = None
        before, runtime.limits_set_for = runtime.limits_set_for, set_for
        if set_for not in (None, before):
            self.publish_event("configuration", runtime.id, "plant.limits_of_another", **asdict(set_for))

    def report_above_limit(self, runtime: DriveRuntime) -> Json | None:
        """Return a note, and publish it, where a drive runs above its new limit; None where it does not."""
        frequency_hz = runtime.above_limit_hz(runtime.status_or_none())
        if frequency_hz is None:
            return None
        params: Json = {"frequency_hz": round(frequency_hz, 2), "maximum_hz": runtime.drive.range_hz[1]}
        self.publish_event("configuration", runtime.id, "plant.above_limit", **params)
        return localized("plant.above_limit_of", {"drive": title_of(runtime.config), **params})

    def report_lost_limits(self) -> None:
        """Raise an alarm while the limits of a drive are lost with their file, else clear it."""
        lost = [runtime.id for runtime in self.drives.values() if runtime.limits_lost]
        if lost:
            self.raise_alarm(SystemAlarm.SETTINGS_LOST, subject=SETTINGS_FILE, drives=Text.join_names(lost))
        else:
            self.clear_alarm(SystemAlarm.SETTINGS_LOST, subject=SETTINGS_FILE)

    def _restore_waiver(self, runtime: DriveRuntime, waiver: CommLossWaiver | None) -> None:
        """Restore a waiver; one that was recorded for another drive of this name is ignored and becomes an event."""
        fits = waiver is not None and waiver.applies_to(runtime.config, self.bus_of(runtime).config)
        runtime.comm_loss.waiver = waiver.text if waiver is not None and fits else None
        runtime.comm_loss.waiver_of_another = None if fits else waiver
        if runtime.comm_loss.waiver_of_another is not None:
            self.publish_event(
                "waiver", runtime.id, "plant.waiver_ignored", **runtime.comm_loss.waiver_of_another.recorded_for
            )

    def _restore_comm_loss_record(self, runtime: DriveRuntime, record: CommLossRecord | None) -> None:
        """Restore the record of a communication-loss test; one of another drive of this name becomes an event."""
        runtime.comm_loss.record = record
        if record is not None and not record.is_of(runtime.config, self.bus_of(runtime).config):
            runtime.comm_loss.record = None
            self.publish_event(
                "waiver",
                runtime.id,
                "plant.comm_loss_record_ignored",
                model=record.model,
                port=record.port,
                address=record.address,
            )


def narrow_limits(own: DriveLimits, file: DriveLimits) -> DriveLimits:
    """Return limits that satisfy both an engineer's and the configuration's."""
    highest = [value for value in (own.maximum_hz, file.maximum_hz) if value is not None]
    return DriveLimits(
        max(own.minimum_hz, file.minimum_hz),
        min(highest, default=None),
        own.forward and file.forward,
        own.reverse and file.reverse,
        file.eeprom_writes_per_day,
    )


def _lookup(by_id: dict[str, T], kind: str, id: str) -> T:
    if id not in by_id:
        names = [*list(by_id)[:MAX_NAMES_IN_ERROR], *(["…"] if len(by_id) > MAX_NAMES_IN_ERROR else [])]
        raise NotFound(f"plant.no_{kind}", id=id, known=tuple(names) or "-")
    return by_id[id]
