"""Composition root of the service: storage, plant, operations and supervision of one configuration."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from types import TracebackType

from drivebus.bus import timer as timers
from drivebus.clock import wall_ms
from drivebus.errors import Superseded
from drivebus.service.alarms import AlarmEngine, SystemAlarm
from drivebus.service.alarms.log import ALARM_LOG_FILE
from drivebus.service.alarms.service import AlarmService
from drivebus.service.api.dispatcher import Dispatcher
from drivebus.service.api.handlers import bound_handlers
from drivebus.service.api.queries import Queries
from drivebus.service.audit.chain import AUDIT_FILE
from drivebus.service.audit.records import SESSION_ENDED
from drivebus.service.auth.actor import SERVICE_NAME, Actor, local_actor
from drivebus.service.config.model import PlantConfig
from drivebus.service.control.comm_loss_test import CommLossTests
from drivebus.service.control.control_commands import ControlCommands
from drivebus.service.control.drive_commands import DriveCommands
from drivebus.service.control.groups import GroupCommands
from drivebus.service.control.jogs import RemoteJogs
from drivebus.service.control.policies import StopPolicies
from drivebus.service.control.selections import SelectionCommands
from drivebus.service.control.stops import StopCommands
from drivebus.service.incidents.service import IncidentService
from drivebus.service.interlocks.engine import InterlockEngine
from drivebus.service.live.hub import Hub
from drivebus.service.live.publisher import LivePublisher
from drivebus.service.process.systemd import SystemdNotifier
from drivebus.service.runtime.failure_log import failure_logged
from drivebus.service.runtime.fairness import encode_json_cooperatively
from drivebus.service.runtime.plant import Plant
from drivebus.service.runtime.reload import ConfigReload
from drivebus.service.runtime.supervision import SupervisionCycle
from drivebus.service.runtime.utc_clock import UtcClock
from drivebus.service.storage.storage import Storage
from drivebus.types import Json

SERVICE_ACTOR = local_actor(SERVICE_NAME, "service")
"""Actor of what the service does by itself: policies, interlocks, its own end."""


@asynccontextmanager
async def build_service(
    config: PlantConfig, storage: Storage | None = None, *, watchdog: SystemdNotifier | None = None
) -> AsyncIterator[Service]:
    """Open the storage of a configuration, yield its service (not started), and close the storage."""
    storage = storage or Storage.of(config)
    await storage.open(config)
    try:
        yield Service(config, storage, watchdog=watchdog)
    finally:
        await storage.close()


class Service:
    """Many buses in one process: the ``ServiceClient`` of its own process. ``async with service`` starts and stops it.

    Its loop is the loop of its buses.
    """

    def __init__(
        self,
        config: PlantConfig,
        storage: Storage,
        *,
        wall_ms: Callable[[], int] = wall_ms,
        watchdog: SystemdNotifier | None = None,
    ) -> None:
        self._loop = asyncio.get_running_loop()
        self._timer = timers.acquire(self._loop)
        now = self._timer.now
        clock = UtcClock(now, wall_ms)
        self._alarm_log = storage.alarm_log
        earlier_alarms = storage.alarm_log.load()
        self.plant = Plant(
            config=config,
            now=now,
            wall_ms=wall_ms,
            clock=clock,
            hub=Hub(clock.now_ms),
            audit=storage.audit,
            historian=storage.historian,
            run_statistics=storage.run_statistics,
            alarms=AlarmEngine(
                config.alarms,
                config.drives,
                storage.alarm_log.put,
                earlier_alarms,
                first_number=storage.alarm_log.next_number,
                now=now(),
                now_ms=wall_ms(),
            ),
            interlocks=InterlockEngine(config.interlocks),
            store=storage.settings,
            drive_store=storage.drives,
        )
        self.commands = DriveCommands(self.plant)
        self.control = ControlCommands(self.plant)
        self.groups = GroupCommands(self.plant, self.commands)
        self.stops = StopCommands(self.plant, self.commands, SERVICE_ACTOR)
        self.jogs = RemoteJogs(self.plant, self.commands)
        self.comm_loss_tests = CommLossTests(self.plant, self.commands)
        self.incidents = IncidentService(self.plant, storage.incidents)
        self.publisher = LivePublisher(self.plant, self.groups)
        self.reload = ConfigReload(self.plant, self.publisher)
        handlers = bound_handlers(
            (
                self.commands,
                self.control,
                self.groups,
                self.stops,
                self.jogs,
                self.comm_loss_tests,
                SelectionCommands(self.plant, self.commands),
                Queries(self.plant, self.groups),
                self.reload,
                AlarmService(self.plant, storage.alarm_log),
                self.incidents,
            )
        )
        self.dispatcher = Dispatcher(self.plant, handlers)
        self.policies = StopPolicies(self.plant, self.dispatcher.call, SERVICE_ACTOR)
        self.supervision = SupervisionCycle(
            self.plant,
            self.publisher,
            jogs=self.jogs,
            policies=self.policies,
            control=self.control,
            storage=storage,
            incidents=self.incidents,
            watchdog=watchdog,
        )
        self._supervision_task: asyncio.Task[None] | None = None

    # --- life ---------------------------------------------------------------------------------------------------

    async def start(self) -> None:
        """Open every bus that can be opened; nothing but reads is sent. Raises ConfigurationError."""
        plant = self.plant
        plant.started_ms = plant.wall_ms()
        if plant.audit.records_missing:
            plant.raise_alarm(SystemAlarm.AUDIT_INCOMPLETE, subject=AUDIT_FILE)
        if plant.audit.key_replaced:
            plant.raise_alarm(SystemAlarm.AUDIT_KEY_REPLACED, subject=plant.audit.paths.key.name)
        if plant.audit.head_missing:
            plant.raise_alarm(SystemAlarm.AUDIT_HEAD_MISSING, subject=plant.audit.paths.head.name)
        plant.report_damaged(ALARM_LOG_FILE, self._alarm_log.damaged_copy)
        for bus in plant.config.buses:
            plant.add_bus(bus, plant.config.drives)
        for drive in plant.config.drives:
            plant.add_drive(drive, self.publisher.on_status)
        plant.report_lost_limits()
        for runtime in plant.buses.values():
            runtime.start()
        self.supervision.run_once()
        self._supervision_task = asyncio.create_task(self.supervision.run(), name="supervision")

    async def stop(self) -> Json:
        """Stop what this service started, then close every bus. Return the outcome of each drive's stop."""
        if self.plant.state != "running":
            return {}
        self.plant.state = "stopping"
        self.reload.close()
        for runtime in self.plant.drives.values():
            with failure_logged():
                runtime.withdraw_commands(Superseded("plant.stopping"))
        outcomes = await self.stops.stop_started_drives()
        if self._supervision_task is not None:
            self._supervision_task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._supervision_task
        await self.jogs.close()
        await self.comm_loss_tests.close()
        await self.supervision.close()
        await self.policies.close()
        self.plant.hub.close()
        await asyncio.sleep(0)  # let the streams send their end
        self.plant.state = "ended"
        self.plant.drives.clear()
        await asyncio.gather(*(runtime.close() for runtime in self.plant.buses.values()))
        await self.incidents.close()
        await self.dispatcher.aggregator.close()
        timers.release(self._loop)
        return outcomes

    async def __aenter__(self) -> Service:
        await self.start()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.stop()

    # --- ServiceClient ------------------------------------------------------------------------------------------

    async def call(self, operation: str, params: Json, actor: Actor) -> Json:
        """See ``ServiceClient.call``."""
        return await self.dispatcher.call(operation, params, actor)

    async def call_json(self, operation: str, params: Json, actor: Actor) -> bytes:
        """See ``ServiceClient.call_json``."""
        return await encode_json_cooperatively(await self.call(operation, params, actor))

    def live(self, stream: str, actor: Actor) -> AsyncIterator[Json]:
        """See ``ServiceClient.live``. Raises PermissionDenied."""
        self.dispatcher.check_may_view(actor)
        return self.plant.hub.subscribe(stream)

    async def record(self, entry: Json, actor: Actor) -> None:
        """See ``ServiceClient.record``. Raises AuditUnavailable."""
        await self.dispatcher.record(entry, actor)

    async def end_control(self, reason: str, actor: Actor) -> None:
        """See ``ServiceClient.end_control``. Raises AuditUnavailable, after control has ended."""
        self.plant.control_requests.end_session(actor.session, self.plant.now())
        drives = [*self.jogs.end_control(actor.session), *self.policies.end_control(actor.session, reason)]
        if drives:
            params = {"ended_by": reason, "drives": [*dict.fromkeys(drives)]}
            await self.record({"what": SESSION_ENDED, "params": params, "outcome": "done"}, actor)
