"""Four times a second: look at every drive, tell the hub, judge interlocks and alarms, end leases (G17, 6.6)."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterator
from functools import partial

from drivebus.bus.station import Presence
from drivebus.drives.state import DriveState, DriveStatus
from drivebus.errors import DrivebusError
from drivebus.profiles.model import Text
from drivebus.service.alarms import SystemAlarm
from drivebus.service.api.errors import localized
from drivebus.service.config.model import GroupConfig
from drivebus.service.control.groups import GroupCommands
from drivebus.service.control.jogs import RemoteJogs
from drivebus.service.control.policies import StopPolicies
from drivebus.service.live.view_builders import bus_view, drive_topic, drive_view, plant_topic
from drivebus.service.live.views import DriveView
from drivebus.service.runtime.bus import BusRuntime
from drivebus.service.runtime.drive import DriveRuntime
from drivebus.service.runtime.plant import Plant

CYCLE_S = 0.25
BUS_VIEW_CYCLES = 4
"""Buses are looked at every so many looks."""
DISK_CHECK_CYCLES = 40
Step = Callable[[], None]
COMM_LOSS_READ_INTERVAL_S = 3600.0
"""What a drive does when its host dies is read from it again after so long: it costs bus time."""
COMM_LOSS_RETRY_S = 60.0
COMM_LOSS_REREAD_S = 2.0
LOG = logging.getLogger("drivebus.service")


class SupervisionCycle:
    """The plant's look-out."""

    def __init__(self, plant: Plant, groups: GroupCommands, jogs: RemoteJogs, policies: StopPolicies) -> None:
        self.plant, self.groups, self.jogs, self.policies = plant, groups, jogs, policies
        self.views: dict[str, DriveView] = {}
        self._cycles = 0
        self._disk_task: asyncio.Task[None] | None = None
        self._faults: dict[str, int] = {}
        self._was_open: dict[str, bool] = {}
        self.after_cycle: Callable[[float], None] = lambda now: None
        """Called after each look: what feeds the watchdog."""
        self._presence: dict[str, Presence] = {}
        self._comm_loss_reads: set[asyncio.Task[None]] = set()
        self._comm_loss_requested_at: dict[str, float] = {}

    async def run(self) -> None:
        """Until cancelled. In steps, so that no bus waits for a whole look; a step that fails is told and ends no other
        (a motor may be turning)."""
        while True:
            due = self.plant.now() + CYCLE_S
            for step in self._steps():
                self._run_step(step)
                await asyncio.sleep(0)
            await asyncio.sleep(max(0.0, due - self.plant.now()))

    def run_once(self) -> None:
        """Once, all of it."""
        for step in self._steps():
            self._run_step(step)

    def _run_step(self, step: Step) -> None:
        try:
            step()
        except Exception:
            LOG.exception("a look at the plant failed")

    def _steps(self) -> Iterator[Step]:
        plant, now_ms = self.plant, self.plant.wall_ms()
        for unit in tuple(plant.drives.values()):
            yield partial(self._supervise_drive, unit)
        yield lambda: self.policies.enforce_interlocks(self.views, plant.now())
        yield lambda: self.policies.expire_leases(plant.now())
        yield self.jogs.expire
        for group in plant.config.groups:
            yield partial(self._publish_group, group)
        for line in tuple(plant.buses.values()) if self._cycles % BUS_VIEW_CYCLES == 0 else ():
            yield partial(self._supervise_bus, line)
        yield partial(self._supervise_plant, now_ms)
        self._cycles += 1
        yield partial(self.after_cycle, plant.now())

    async def _check_disk(self) -> None:
        """A disk that hangs holds a thread, no bus."""
        self.plant.disk_space = await asyncio.to_thread(self.plant.parts.disk)

    def _supervise_bus(self, line: BusRuntime) -> None:
        if self.plant.buses.get(line.config.id) is line:
            self._supervise_port(line, self.plant.now())
            self.plant.hub.publish(f"buses/{line.config.id}", bus_view(self.plant, line))

    def _publish_group(self, group: GroupConfig) -> None:
        if group in self.plant.config.groups:
            self.plant.hub.publish(f"groups/{group.id}", self.groups.group_view(group))

    def _supervise_plant(self, now_ms: int) -> None:
        plant = self.plant
        if self._cycles % DISK_CHECK_CYCLES == 0 and (self._disk_task is None or self._disk_task.done()):
            self._disk_task = asyncio.create_task(self._check_disk(), name="room on the disk")
        if plant.parts.history.ok:
            plant.clear_alarm(SystemAlarm.STORAGE_FAILURE, subject="history")
        else:
            plant.raise_alarm(SystemAlarm.STORAGE_FAILURE, subject="history", reason=plant.parts.history.problem)
        plant.publish_alarms(plant.parts.alarms.expire_shelves(plant.now(), now_ms))
        plant.hub.publish("alarms", plant.parts.alarms.as_json())
        plant.hub.publish("plant", plant_topic(plant))

    def reset_drive(self, drive: str) -> None:
        """It is another drive now: nothing is known of it."""
        self._comm_loss_requested_at.pop(drive, None)
        self._presence.pop(drive, None)
        self._faults.pop(drive, None)

    def remove_drive(self, drive: str) -> None:
        """It is no longer part of the plant."""
        self.views.pop(drive, None)
        self.plant.hub.remove(f"drives/{drive}")

    def _supervise_drive(self, unit: DriveRuntime) -> None:
        if self.plant.drives.get(unit.id) is not unit:
            return
        now, now_ms = self.plant.now(), self.plant.wall_ms()
        status = unit.status()
        unit.sample(status.readings)
        view = self.views[unit.id] = drive_view(self.plant, unit, status)
        self._report_presence(unit)
        self._report_fault(unit, status)
        self.policies.on_status(unit, status)
        self.plant.publish_alarms(self.plant.parts.alarms.observe(view, now, now_ms))
        self.plant.parts.on_view(view, now, now_ms)
        self.plant.hub.publish(f"drives/{unit.id}", drive_topic(self.plant, view, status))
        self._schedule_comm_loss_read(unit, status, now)

    def _report_presence(self, unit: DriveRuntime) -> None:
        """One line when it falls silent and one when it returns."""
        found = unit.bus.presence(unit.config.address)
        before, self._presence[unit.id] = self._presence.get(unit.id), found
        if found is before or (before in (None, Presence.NEVER_SEEN) and found is not Presence.OFFLINE):
            return
        key = "plant.drive_silent" if found is Presence.OFFLINE else "plant.drive_back"
        self.plant.publish_event("presence", unit.id, key, drive=unit.id)

    def _report_fault(self, unit: DriveRuntime, status: DriveStatus) -> None:
        """A marker when it trips; the same fault after a silence is no new one."""
        fault = status.fault
        if fault is None:
            if status.state is not DriveState.UNKNOWN or "status" not in unit.profile.capabilities:
                self._faults.pop(unit.id, None)
        elif self._faults.get(unit.id) != fault.code:
            self._faults[unit.id] = fault.code
            key = "plant.drive_fault_says" if fault.label in fault.text.en else "plant.drive_fault"
            self.plant.publish_event("fault", unit.id, key, label=fault.label, fault=fault.text)

    def _supervise_port(self, line: BusRuntime, now: float) -> None:
        """A port that is gone, or another master on it: an alarm and one line when it begins and when it ends (F12)."""
        bus, plant = line.config.id, self.plant
        is_open, was_open = line.bus.is_open, self._was_open.get(bus)
        if is_open:
            self._was_open[bus] = True
            plant.clear_alarm(SystemAlarm.PORT_LOST, subject=bus)
        elif was_open or line.problem is not None:
            self._was_open[bus] = False
            reason = line.problem or Text(**localized("plant.bus_reopened"))
            plant.raise_alarm(SystemAlarm.PORT_LOST, subject=bus, reason=reason)
        if was_open is not self._was_open.get(bus) and was_open is not None:
            plant.publish_event("presence", None, "plant.bus_open" if is_open else "plant.bus_lost", bus=bus)
        foreign = is_open and line.bus.core.unsolicited.has_foreign_master(now)
        (plant.raise_alarm if foreign else plant.clear_alarm)(SystemAlarm.FOREIGN_MASTER, subject=bus)

    # --- the badge ------------------------------------------------------------------------------------------------

    def _schedule_comm_loss_read(self, unit: DriveRuntime, status: DriveStatus, now: float) -> None:
        """Read what the drive does when this host dies: once it is there, and once in a while."""
        if unit.bus.presence(unit.config.address) is not Presence.ONLINE or unit.monitor is None:
            return
        asked = self._comm_loss_requested_at.get(unit.id)
        wait_s = COMM_LOSS_READ_INTERVAL_S if unit.comm_loss_read_at is not None else COMM_LOSS_RETRY_S
        wait_s = COMM_LOSS_REREAD_S if unit.comm_loss_stale else wait_s
        if asked is not None and now - asked < wait_s:
            return
        self._comm_loss_requested_at[unit.id] = now
        task = asyncio.create_task(self._read_comm_loss(unit), name=f"badge {unit.id}")
        self._comm_loss_reads.add(task)
        task.add_done_callback(self._comm_loss_reads.discard)

    async def _read_comm_loss(self, unit: DriveRuntime) -> None:
        doubts = unit.comm_loss_writes
        try:
            report = await unit.drive.comm_loss_behaviour()
        except (DrivebusError, KeyError):
            return
        unit.set_comm_loss(report, self.plant.now(), doubts)

    async def close(self) -> None:
        """No more reads of its own."""
        tasks = [*self._comm_loss_reads, *([self._disk_task] if self._disk_task is not None else [])]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
