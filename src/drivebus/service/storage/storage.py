"""Durable data of a service, in one state directory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from drivebus.clock import wall_ms
from drivebus.drives.store import FileStore, Store
from drivebus.service.alarms.log import ALARM_LOG_FILE, AlarmLog
from drivebus.service.audit import AuditTrail
from drivebus.service.config.bus_load import signal_labels
from drivebus.service.config.model import PlantConfig
from drivebus.service.historian import Historian
from drivebus.service.incidents import IncidentStore
from drivebus.service.runtime.run_statistics import RunStatisticsStore
from drivebus.service.storage.settings import SETTINGS_FILE, recover_settings


@dataclass(frozen=True, kw_only=True)
class Storage:
    """Audit trail, history, alarms, incidents, waivers and limits of a service."""

    audit: AuditTrail
    historian: Historian
    run_statistics: RunStatisticsStore
    alarm_log: AlarmLog
    incidents: IncidentStore
    settings: Store
    """Waivers and limits."""
    drives: Store | None = None
    """Calibrations and EEPROM write counts; None: the default of ``Drive``."""

    @classmethod
    def of(cls, config: PlantConfig, *, wall_ms: Callable[[], int] = wall_ms) -> Storage:
        """Return the storage in the state directory of a configuration, not opened yet."""
        directory = config.directory
        historian = Historian(config.history, directory, wall_ms=wall_ms)
        return cls(
            audit=AuditTrail.of(config),
            historian=historian,
            run_statistics=RunStatisticsStore(historian),
            alarm_log=AlarmLog(directory / ALARM_LOG_FILE),
            incidents=IncidentStore(directory / "incidents"),
            settings=FileStore(directory / SETTINGS_FILE, may_vanish=False),
        )

    def errors(self) -> dict[str, Exception | None]:
        """Return the present error of each file that is written in the background."""
        paths = self.audit.paths
        return {
            ALARM_LOG_FILE: self.alarm_log.error,
            paths.current.name: self.audit.error,
            paths.checkpoints.name: self.audit.checkpoint_error,
            paths.head.name: self.audit.head_error,
        }

    async def open(self, config: PlantConfig) -> None:
        """Open everything. A disk that cannot be written raises nothing here; it becomes an alarm."""
        if isinstance(self.settings, FileStore):
            recover_settings(self.settings, (drive.id for drive in config.drives), wall_ms())
        await self.audit.open()
        await self.historian.open()
        self.historian.set_labels(signal_labels(config))
        await self.run_statistics.open()

    async def close(self) -> None:
        """Write what is queued and close everything."""
        await self.alarm_log.close()
        await self.run_statistics.close()
        await self.historian.close()
        await self.audit.close()
