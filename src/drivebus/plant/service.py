"""The plant: owns buses, drives, hub, leases, groups; does operations for whoever may. ``PlantClient`` in process."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Sequence
from types import TracebackType
from typing import Any

from drivebus.bus import timer as timers
from drivebus.drives.store import FileStore
from drivebus.plant.actor import Actor, local
from drivebus.plant.answers import Answers
from drivebus.plant.commands import Commands
from drivebus.plant.config.polling import profile_of
from drivebus.plant.desk import Desk
from drivebus.plant.frames import Framed
from drivebus.plant.groups import Groups
from drivebus.plant.hub import Hub
from drivebus.plant.jogs import Jogs
from drivebus.plant.lines import Line, Seen
from drivebus.plant.model import BusSetting, DriveSetting, PlantSetting
from drivebus.plant.parts import Handler, Parts
from drivebus.plant.policies import Policies
from drivebus.plant.reloading import Reloading
from drivebus.plant.state import Plant
from drivebus.plant.stopping import Stopping
from drivebus.plant.units import Unit
from drivebus.plant.view import Sample
from drivebus.plant.watching import Watching
from drivebus.seams import Store, wall_ms

Json = dict[str, Any]
SERVICE = local("drivebus", "service")
"""Who acts where a policy acts."""


class Service:
    """One plant. ``async with Service(setting, parts)``; its loop is the loop of its buses."""

    def __init__(
        self,
        setting: PlantSetting,
        parts: Parts,
        *,
        store: Store | None = None,
        wall_ms: Callable[[], int] = wall_ms,
        drive_store: Store | None = None,
    ) -> None:
        """``store`` keeps waivers and limits; ``drive_store`` what was proved and worn (None: as ``Drive`` does)."""
        self._loop = asyncio.get_running_loop()
        self._timer = timers.acquire(self._loop)
        now = self._timer.now
        kept = store or FileStore(setting.directory / "plant.json")
        self.plant = Plant(setting, now, wall_ms, Hub(now, wall_ms), parts, kept)
        parts.on_plant(self.plant)
        self._drive_store = drive_store
        self.commands = Commands(self.plant)
        self.groups = Groups(self.plant, self.commands)
        self.stopping = Stopping(self.plant, self.commands)
        self.jogs = Jogs(self.plant, self.commands)
        answers = Answers(self.plant, self.groups)
        handlers: dict[str, Handler] = dict(parts.handlers)
        for room in (self.commands, self.groups, self.stopping, self.jogs, answers, Reloading(self)):
            handlers |= room.handlers()
        motions = self.commands.motions() | self.groups.motions() | self.jogs.motions()
        self.desk = Desk(self.plant, handlers, motions)
        self.policies = Policies(self.plant, self.desk.call, SERVICE)
        self.watching = Watching(self.plant, self.groups, self.jogs, self.policies)
        self._tick: asyncio.Task[None] | None = None

    # --- life ---------------------------------------------------------------------------------------------------

    async def start(self) -> None:
        """Open every bus that can be opened; nothing but reads is sent (ruling 7). Raises ConfigurationError."""
        self.plant.started_ms = self.plant.wall_ms()
        for bus in self.plant.setting.buses:
            self.add_bus(bus, self.plant.setting.drives)
        for drive in self.plant.setting.drives:
            self.add_drive(drive)
        for line in self.plant.lines.values():
            line.start()
        self.watching.look()
        self._tick = asyncio.create_task(self.watching.run(), name="watching")

    def add_bus(self, setting: BusSetting, drives: Sequence[DriveSetting]) -> Line:
        """A bus of the plant, not opened yet; ``drives``: of the whole plant."""
        first = next((profile_of(drive) for drive in drives if drive.bus == setting.id), None)
        line = Line(setting, first, self._line_told, self._frame)
        line.wall_ms = self.plant.wall_ms
        self.plant.lines[setting.id] = line
        return line

    def add_drive(self, setting: DriveSetting) -> Unit:
        """A drive of the plant."""
        unit = self.plant.lines[setting.bus].add(setting, self._sampled, self._drive_store)
        self.plant.units[unit.id] = unit
        self.plant.recall(unit)
        return unit

    def _line_told(self, key: str, params: Json) -> None:
        self.plant.tell("presence", None, key, **params)

    def _frame(self, line: Line, seen: Seen) -> None:
        topic = f"frames/{line.setting.id}"
        if self.plant.hub.watched(topic):
            self.plant.hub.append(topic, Framed(line, seen))

    def _sampled(self, samples: list[Sample]) -> None:
        self.plant.parts.history.append(samples)

    async def stop(self) -> Json:
        """Stop what this service started (6.6), then let every bus go. Returns what became of each drive."""
        if self.plant.state != "running":
            return {}
        self.plant.state = "stopping"
        found = await self.stopping.started_by_us(SERVICE)
        if self._tick is not None:
            self._tick.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._tick
        await self.jogs.close()
        await self.watching.close()
        await self.policies.close()
        await self.plant.hub.close()
        self.plant.state = "ended"
        self.plant.units.clear()
        await asyncio.gather(*(line.close() for line in self.plant.lines.values()))
        timers.release(self._loop)
        return found

    async def __aenter__(self) -> Service:
        await self.start()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.stop()

    # --- PlantClient --------------------------------------------------------------------------------------------

    async def call(self, operation: str, params: Json, actor: Actor) -> Json:
        """See ``PlantClient.call``."""
        return await self.desk.call(operation, params, actor)

    def live(self, patterns: Sequence[str], actor: Actor, interval_s: float = 0.25) -> AsyncIterator[Json]:
        """See ``PlantClient.live``. Raises Forbidden."""
        self.desk.may_look(actor)
        return self.plant.hub.live(patterns, min(10.0, max(0.1, interval_s)))

    async def record(self, entry: Json, actor: Actor) -> None:
        """See ``PlantClient.record``. Raises AuditUnavailable."""
        await self.desk.record(entry, actor)
