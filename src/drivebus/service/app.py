"""The plant: owns buses, drives, hub, leases, groups; does operations for whoever may. ``ServiceClient`` in process."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Sequence
from types import TracebackType
from typing import Any

from drivebus.bus import timer as timers
from drivebus.clock import Store, wall_ms
from drivebus.drives.store import FileStore
from drivebus.service.api.dispatcher import Dispatcher
from drivebus.service.api.frames import LazyFrame
from drivebus.service.api.queries import Queries
from drivebus.service.auth.actor import Actor, local_actor
from drivebus.service.config.bus_load import profile_of
from drivebus.service.config.model import BusConfig, DriveConfig, PlantConfig
from drivebus.service.control.drive_commands import DriveCommands
from drivebus.service.control.groups import GroupCommands
from drivebus.service.control.jogs import RemoteJogs
from drivebus.service.control.policies import StopPolicies
from drivebus.service.control.stops import StopCommands
from drivebus.service.live.hub import Hub
from drivebus.service.live.views import Sample
from drivebus.service.parts import OperationHandler, ServiceParts
from drivebus.service.runtime.bus import BusRuntime, TracedFrame
from drivebus.service.runtime.drive import DriveRuntime
from drivebus.service.runtime.plant import Plant
from drivebus.service.runtime.reload import ConfigReload
from drivebus.service.runtime.supervision import SupervisionCycle

Json = dict[str, Any]
SERVICE_ACTOR = local_actor("drivebus", "service")
"""Who acts where a policy acts."""


class Service:
    """One plant. ``async with Service(setting, parts)``; its loop is the loop of its buses."""

    def __init__(
        self,
        config: PlantConfig,
        parts: ServiceParts,
        *,
        store: Store | None = None,
        wall_ms: Callable[[], int] = wall_ms,
        drive_store: Store | None = None,
    ) -> None:
        """``store`` keeps waivers and limits; ``drive_store`` what was proved and worn (None: as ``Drive`` does)."""
        self._loop = asyncio.get_running_loop()
        self._timer = timers.acquire(self._loop)
        now = self._timer.now
        kept = store or FileStore(config.directory / "plant.json")
        self.plant = Plant(config, now, wall_ms, Hub(now, wall_ms), parts, kept)
        parts.on_plant(self.plant)
        self._drive_store = drive_store
        self.commands = DriveCommands(self.plant)
        self.groups = GroupCommands(self.plant, self.commands)
        self.stops = StopCommands(self.plant, self.commands)
        self.jogs = RemoteJogs(self.plant, self.commands)
        answers = Queries(self.plant, self.groups)
        handlers: dict[str, OperationHandler] = dict(parts.handlers)
        for room in (self.commands, self.groups, self.stops, self.jogs, answers, ConfigReload(self)):
            handlers |= room.handlers()
        motions = self.commands.motions() | self.groups.motions() | self.jogs.motions()
        self.dispatcher = Dispatcher(self.plant, handlers, motions)
        self.policies = StopPolicies(self.plant, self.dispatcher.call, SERVICE_ACTOR)
        self.supervision = SupervisionCycle(self.plant, self.groups, self.jogs, self.policies)
        self._supervision_task: asyncio.Task[None] | None = None

    # --- life ---------------------------------------------------------------------------------------------------

    async def start(self) -> None:
        """Open every bus that can be opened; nothing but reads is sent (ruling 7). Raises ConfigurationError."""
        self.plant.started_ms = self.plant.wall_ms()
        for bus in self.plant.config.buses:
            self.add_bus(bus, self.plant.config.drives)
        for drive in self.plant.config.drives:
            self.add_drive(drive)
        for line in self.plant.buses.values():
            line.start()
        self.supervision.run_once()
        self._supervision_task = asyncio.create_task(self.supervision.run(), name="watching")

    def add_bus(self, setting: BusConfig, drives: Sequence[DriveConfig]) -> BusRuntime:
        """A bus of the plant, not opened yet; ``drives``: of the whole plant."""
        first = next((profile_of(drive) for drive in drives if drive.bus == setting.id), None)
        line = BusRuntime(setting, first, self._on_bus_problem, self._on_frame)
        line.wall_ms = self.plant.wall_ms
        self.plant.buses[setting.id] = line
        return line

    def add_drive(self, setting: DriveConfig) -> DriveRuntime:
        """A drive of the plant."""
        unit = self.plant.buses[setting.bus].add_drive(setting, self._on_samples, self._drive_store)
        self.plant.drives[unit.id] = unit
        self.plant.restore(unit)
        return unit

    def _on_bus_problem(self, key: str, params: Json) -> None:
        self.plant.publish_event("presence", None, key, **params)

    def _on_frame(self, line: BusRuntime, seen: TracedFrame) -> None:
        topic = f"frames/{line.config.id}"
        if self.plant.hub.has_listener(topic):
            self.plant.hub.append(topic, LazyFrame(line, seen))

    def _on_samples(self, samples: list[Sample]) -> None:
        self.plant.parts.history.append(samples)

    async def stop(self) -> Json:
        """Stop what this service started (6.6), then let every bus go. Returns what became of each drive."""
        if self.plant.state != "running":
            return {}
        self.plant.state = "stopping"
        found = await self.stops.stop_started_drives(SERVICE_ACTOR)
        if self._supervision_task is not None:
            self._supervision_task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._supervision_task
        await self.jogs.close()
        await self.supervision.close()
        await self.policies.close()
        await self.plant.hub.close()
        self.plant.state = "ended"
        self.plant.drives.clear()
        await asyncio.gather(*(line.close() for line in self.plant.buses.values()))
        timers.release(self._loop)
        return found

    async def __aenter__(self) -> Service:
        await self.start()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.stop()

    # --- ServiceClient --------------------------------------------------------------------------------------------

    async def call(self, operation: str, params: Json, actor: Actor) -> Json:
        """See ``ServiceClient.call``."""
        return await self.dispatcher.call(operation, params, actor)

    def live(self, patterns: Sequence[str], actor: Actor, interval_s: float = 0.25) -> AsyncIterator[Json]:
        """See ``ServiceClient.live``. Raises Forbidden."""
        self.dispatcher.check_may_view(actor)
        return self.plant.hub.live(patterns, min(10.0, max(0.1, interval_s)))

    async def record(self, entry: Json, actor: Actor) -> None:
        """See ``ServiceClient.record``. Raises AuditUnavailable."""
        await self.dispatcher.record(entry, actor)
