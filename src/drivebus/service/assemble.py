"""The real rooms around the plant process, put together for one state directory."""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any

from drivebus.profiles.model import Text
from drivebus.service.alarms import AlarmEngine, SystemAlarm
from drivebus.service.alarms.log import AlarmLog
from drivebus.service.api import operations as ask
from drivebus.service.audit import AuditTrail
from drivebus.service.auth.actor import Actor
from drivebus.service.config.bus_load import profile_of
from drivebus.service.config.model import PlantConfig
from drivebus.service.historian import Historian
from drivebus.service.incidents import IncidentStore
from drivebus.service.incidents.service import AlarmIncidentService
from drivebus.service.interlocks.engine import InterlockEngine
from drivebus.service.live.views import DriveView, Sample
from drivebus.service.parts import OperationHandler, ServiceParts
from drivebus.service.runtime.plant import Plant
from drivebus.service.runtime.run_statistics_store import RunStatisticsStore

Json = dict[str, Any]


class SampleTee:
    """The history, with the flight recorder listening."""

    def __init__(self, history: Historian, keeping: AlarmIncidentService) -> None:
        self._historian, self._incidents = history, keeping

    @property
    def ok(self) -> bool:
        return self._historian.ok

    @property
    def problem(self) -> str | None:
        return self._historian.writer.problem

    def append(self, samples: Sequence[Sample]) -> None:
        self._historian.append(samples)
        self._incidents.on_samples(samples)


class ServiceStores:
    """Audit trail, history and alarms on disk. ``open`` before the service starts, ``close`` after it has ended."""

    def __init__(self, config: PlantConfig, now: Callable[[], float], wall_ms: Callable[[], int]) -> None:
        self.config, self._now, self._wall_ms = config, now, wall_ms
        self.trail = AuditTrail(config.directory, config.audit.checkpoints, config.audit.key)
        self.history = Historian(config.history, config.directory, wall_ms=wall_ms)
        self.run_statistics = RunStatisticsStore(self.history)
        self.alarm_log = AlarmLog(config.directory / "alarms.jsonl")
        self.incidents = AlarmIncidentService(self.alarm_log, IncidentStore(config.directory / "incidents"), now)
        self.incidents.stores[self.trail.paths.current.name] = lambda: self.trail.error
        self.incidents.stores[self.trail.paths.checkpoints.name] = lambda: self.trail.checkpoint_error
        self.alarms: AlarmEngine | None = None

    async def open(self) -> ServiceParts:
        """Never fails for a disk: what can't be written is told by ``ok``."""
        await self.trail.open()
        await self.history.open()
        self.history.set_labels(signal_labels(self.config))
        await self.run_statistics.open()
        known = self.alarm_log.load()
        self.alarms = AlarmEngine(
            self.config.alarms,
            self.config.drives,
            self.incidents,
            known,
            first_number=self.alarm_log.next_number,
            now=self._now(),
            now_ms=self._wall_ms(),
        )
        interlocks = InterlockEngine(self.config.interlocks)
        return ServiceParts(
            self.trail,
            SampleTee(self.history, self.incidents),
            self.alarms,
            interlocks,
            self.handlers(),
            self._on_event,
            self.disk_space,
            self.history.status,
            self.run_statistics.statistics_json,
            self._on_view,
            self._on_plant,
            self._on_config,
        )

    async def close(self) -> None:
        await self.incidents.close()
        await self.alarm_log.close()
        await self.run_statistics.close()
        await self.history.close()
        await self.trail.close()

    def _on_plant(self, plant: Plant) -> None:
        self.incidents.bind(plant)
        if self.trail.records_missing:
            asyncio.get_running_loop().call_soon(
                partial(plant.raise_alarm, SystemAlarm.AUDIT_INCOMPLETE, subject="audit.jsonl")
            )

    def _on_view(self, view: DriveView, now: float, now_ms: int) -> None:
        self.incidents.on_view(view, now, now_ms)
        self.run_statistics.on_view(view, now, now_ms)

    def _on_config(self, setting: PlantConfig) -> None:
        gone = {drive.id for drive in self.config.drives} - {drive.id for drive in setting.drives}
        self.config = setting
        self.history.set_labels(signal_labels(setting))
        for drive in gone:
            self.incidents.remove_drive(drive)

    def _on_event(self, event: Json) -> None:
        self.history.put_event(event)
        self.incidents.on_event(event)

    def handlers(self) -> Mapping[str, OperationHandler]:
        """The operations that these rooms answer."""

        async def audit_list(params: ask.TimeRangeParams, actor: Actor) -> Json:
            return await self.trail.query(params.from_ms, params.to_ms, params.drive, params.cursor, params.limit)

        async def audit_verify(params: ask.NoParams, actor: Actor) -> Json:
            return await self.trail.verify()

        return {
            "audit.list": audit_list,
            "audit.verify": audit_verify,
            **self.history.queries.handlers(),
            **self.run_statistics.handlers(),
            **self.incidents.handlers(),
        }

    def disk_space(self) -> Json:
        """Room on the disk of the state directory."""
        with suppress(OSError):
            found = shutil.disk_usage(self.config.directory)
            return {"free_mb": found.free // 2**20, "total_mb": found.total // 2**20}
        return {}


def signal_labels(config: PlantConfig) -> dict[str, tuple[str, Text]]:
    """Unit and text of every tag that the plant's drives may have. Raises ProfileError."""
    profiles = {drive.id: profile_of(drive) for drive in config.drives}
    return {
        f"{drive}.{name}": (signal.unit, signal.text)
        for drive, profile in profiles.items()
        for name, signal in profile.signals.items()
    }
