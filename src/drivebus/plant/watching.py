"""Four times a second: look at every drive, tell the hub, judge interlocks and alarms, end leases (G17, 6.6)."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterator
from functools import partial

from drivebus.bus.stations import Presence
from drivebus.drives.state import DriveState, DriveStatus
from drivebus.errors import DrivebusError
from drivebus.plant.alarms import Own
from drivebus.plant.failure import both
from drivebus.plant.groups import Groups
from drivebus.plant.jogs import Jogs
from drivebus.plant.lines import Line
from drivebus.plant.model import GroupSetting
from drivebus.plant.policies import Policies
from drivebus.plant.state import Plant
from drivebus.plant.units import Unit
from drivebus.plant.view import DriveView
from drivebus.plant.views import bus_view, drive_topic, drive_view, plant_topic
from drivebus.profiles.model import Text

LOOK_S = 0.25
SLOW_LOOKS = 4
"""Buses are looked at every so many looks."""
DISK_LOOKS = 40
Step = Callable[[], None]
BADGE_S = 3600.0
"""What a drive does when its host dies is read from it again after so long: it costs bus time."""
BADGE_AGAIN_S = 60.0
BADGE_DOUBTED_S = 2.0
LOG = logging.getLogger("drivebus.plant")


class Watching:
    """The plant's look-out."""

    def __init__(self, plant: Plant, groups: Groups, jogs: Jogs, policies: Policies) -> None:
        self.plant, self.groups, self.jogs, self.policies = plant, groups, jogs, policies
        self.views: dict[str, DriveView] = {}
        self._looks = 0
        self._disk: asyncio.Task[None] | None = None
        self._faults: dict[str, int] = {}
        self._open: dict[str, bool] = {}
        self.after_look: Callable[[float], None] = lambda now: None
        """Called after each look: what feeds the watchdog."""
        self._presence: dict[str, Presence] = {}
        self._reading: set[asyncio.Task[None]] = set()
        self._asked: dict[str, float] = {}

    async def run(self) -> None:
        """Until cancelled. In steps, so that no bus waits for a whole look; a step that fails is told and ends no other
        (a motor may be turning)."""
        while True:
            due = self.plant.now() + LOOK_S
            for step in self._steps():
                self._safely(step)
                await asyncio.sleep(0)
            await asyncio.sleep(max(0.0, due - self.plant.now()))

    def look(self) -> None:
        """Once, all of it."""
        for step in self._steps():
            self._safely(step)

    def _safely(self, step: Step) -> None:
        try:
            step()
        except Exception:
            LOG.exception("a look at the plant failed")

    def _steps(self) -> Iterator[Step]:
        plant, now_ms = self.plant, self.plant.wall_ms()
        for unit in tuple(plant.units.values()):
            yield partial(self._drive, unit)
        yield lambda: self.policies.interlocks(self.views, plant.now())
        yield lambda: self.policies.leases(plant.now())
        yield self.jogs.sweep
        for group in plant.setting.groups:
            yield partial(self._group, group)
        for line in tuple(plant.lines.values()) if self._looks % SLOW_LOOKS == 0 else ():
            yield partial(self._line, line)
        yield partial(self._whole, now_ms)
        self._looks += 1
        yield partial(self.after_look, plant.now())

    async def _room(self) -> None:
        """A disk that hangs holds a thread, no bus."""
        self.plant.disk = await asyncio.to_thread(self.plant.parts.disk)

    def _line(self, line: Line) -> None:
        if self.plant.lines.get(line.setting.id) is line:
            self._port(line, self.plant.now())
            self.plant.hub.publish(f"buses/{line.setting.id}", bus_view(self.plant, line))

    def _group(self, group: GroupSetting) -> None:
        if group in self.plant.setting.groups:
            self.plant.hub.publish(f"groups/{group.id}", self.groups.view(group))

    def _whole(self, now_ms: int) -> None:
        plant = self.plant
        if self._looks % DISK_LOOKS == 0 and (self._disk is None or self._disk.done()):
            self._disk = asyncio.create_task(self._room(), name="room on the disk")
        if plant.parts.history.ok:
            plant.calm(Own.STORE, about="history")
        else:
            plant.alarm(Own.STORE, about="history", reason=plant.parts.history.problem)
        plant.alarmed(plant.parts.alarms.tick(plant.now(), now_ms))
        plant.hub.publish("alarms", plant.parts.alarms.topic())
        plant.hub.publish("plant", plant_topic(plant))

    def ask_again(self, drive: str) -> None:
        """It is another drive now: nothing is known of it."""
        self._asked.pop(drive, None)
        self._presence.pop(drive, None)
        self._faults.pop(drive, None)

    def forget(self, drive: str) -> None:
        """It is no longer part of the plant."""
        self.views.pop(drive, None)
        self.plant.hub.remove(f"drives/{drive}")

    def _drive(self, unit: Unit) -> None:
        if self.plant.units.get(unit.id) is not unit:
            return
        now, now_ms = self.plant.now(), self.plant.wall_ms()
        status = unit.status()
        unit.feed(status.readings)
        view = self.views[unit.id] = drive_view(self.plant, unit, status)
        self._presence_of(unit)
        self._fault_of(unit, status)
        self.policies.found(unit, status)
        self.plant.alarmed(self.plant.parts.alarms.observe(view, now, now_ms))
        self.plant.parts.on_view(view, now, now_ms)
        self.plant.hub.publish(f"drives/{unit.id}", drive_topic(self.plant, view, status))
        self._badge(unit, status, now)

    def _presence_of(self, unit: Unit) -> None:
        """One line when it falls silent and one when it returns."""
        found = unit.bus.presence(unit.setting.address)
        before, self._presence[unit.id] = self._presence.get(unit.id), found
        if found is before or (before in (None, Presence.NEVER_SEEN) and found is not Presence.SILENT):
            return
        key = "plant.drive_silent" if found is Presence.SILENT else "plant.drive_back"
        self.plant.tell("presence", unit.id, key, drive=unit.id)

    def _fault_of(self, unit: Unit, status: DriveStatus) -> None:
        """A marker when it trips; the same fault after a silence is no new one."""
        fault = status.fault
        if fault is None:
            if status.state is not DriveState.UNKNOWN or "status" not in unit.profile.capabilities:
                self._faults.pop(unit.id, None)
        elif self._faults.get(unit.id) != fault.code:
            self._faults[unit.id] = fault.code
            key = "plant.drive_fault_says" if fault.label in fault.text.en else "plant.drive_fault"
            self.plant.tell("fault", unit.id, key, label=fault.label, fault=fault.text)

    def _port(self, line: Line, now: float) -> None:
        """A port that is gone, or another master on it: an alarm and one line when it begins and when it ends (F12)."""
        bus, plant = line.setting.id, self.plant
        is_open, was_open = line.bus.is_open, self._open.get(bus)
        if is_open:
            self._open[bus] = True
            plant.calm(Own.PORT, about=bus)
        elif was_open or line.problem is not None:
            self._open[bus] = False
            reason = line.problem or Text(**both("plant.bus_reopened"))
            plant.alarm(Own.PORT, about=bus, reason=reason)
        if was_open is not self._open.get(bus) and was_open is not None:
            plant.tell("presence", None, "plant.bus_open" if is_open else "plant.bus_lost", bus=bus)
        foreign = is_open and line.bus.core.listener.foreign_master(now)
        (plant.alarm if foreign else plant.calm)(Own.FOREIGN_MASTER, about=bus)

    # --- the badge ------------------------------------------------------------------------------------------------

    def _badge(self, unit: Unit, status: DriveStatus, now: float) -> None:
        """Read what the drive does when this host dies: once it is there, and once in a while."""
        if unit.bus.presence(unit.setting.address) is not Presence.ONLINE or unit.monitor is None:
            return
        asked = self._asked.get(unit.id)
        wait_s = BADGE_S if unit.host_dies_read_at is not None else BADGE_AGAIN_S
        wait_s = BADGE_DOUBTED_S if unit.badge_stale else wait_s
        if asked is not None and now - asked < wait_s:
            return
        self._asked[unit.id] = now
        task = asyncio.create_task(self._read_badge(unit), name=f"badge {unit.id}")
        self._reading.add(task)
        task.add_done_callback(self._reading.discard)

    async def _read_badge(self, unit: Unit) -> None:
        doubts = unit.badge_doubts
        try:
            report = await unit.drive.if_host_dies()
        except (DrivebusError, KeyError):
            return
        unit.found_host_dies(report, self.plant.now(), doubts)

    async def close(self) -> None:
        """No more reads of its own."""
        tasks = [*self._reading, *([self._disk] if self._disk is not None else [])]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
