"""Reload of a changed ``plant.toml`` while the service runs: only differences are applied.

What did not change misses no poll. A drive that may be running is never removed from its bus.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from drivebus.errors import ConfigurationError, ServiceError, ServiceUnavailable, SystemReason
from drivebus.service.alarms import Alarm, SystemAlarm
from drivebus.service.alarms.model import SYSTEM_ALARM_KINDS
from drivebus.service.api.handlers import handles
from drivebus.service.api.operations.operation import NoParams
from drivebus.service.api.operations.plant import (
    CONFIGURATION_CHECK,
    CONFIGURATION_GET,
    CONFIGURATION_RELOAD,
    ConfigurationParams,
)
from drivebus.service.auth.actor import Actor
from drivebus.service.config.bus_load import signal_labels
from drivebus.service.config.diff import ConfigDiff, ReloadAction, config_diff
from drivebus.service.config.load import load
from drivebus.service.config.model import PlantConfig
from drivebus.service.config.redaction import redact_text
from drivebus.service.control.leases import arm_target_of_group
from drivebus.service.live.publisher import LivePublisher
from drivebus.service.process.permissions import check_plant_files
from drivebus.service.runtime.bus import BusRuntime
from drivebus.service.runtime.configuration_check import ConfigurationCheck, address_notes, difference_json
from drivebus.service.runtime.drive import DriveRuntime
from drivebus.service.runtime.plant import Plant
from drivebus.types import Json
from drivebus.values import Text

RESTART_ONLY = frozenset({"id", "directory", "history", "audit", "users"})
"""Settings of the whole plant that take effect at the next start only."""


class ConfigReload:
    """Handlers of ``configuration.*``."""

    def __init__(self, plant: Plant, publisher: LivePublisher) -> None:
        self.plant, self.publisher = plant, publisher
        self._lock = asyncio.Lock()
        self._check = ConfigurationCheck()

    @handles(CONFIGURATION_GET)
    async def get(self, params: NoParams, actor: Actor) -> Json:
        """Return the text of the file without passwords; it may be newer than what runs. Raises ConfigurationError."""
        source = self.plant.config.source
        try:
            text = await self._in_thread(lambda: Path(source).read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigurationError("plant.no_source", source=source, reason=SystemReason(error)) from error
        return {"text": redact_text(text, source), "source": source}

    @handles(CONFIGURATION_CHECK)
    async def check(self, params: ConfigurationParams, actor: Actor) -> Json:
        """Return every fault of a text and the changes that it would make. Raises as ``ConfigurationCheck.check``."""
        return await self._check.check(params.text, self.plant.config, self._unstarted_gateways())

    @handles(CONFIGURATION_RELOAD)
    async def reload(self, params: NoParams, actor: Actor) -> Json:
        """Read the file again and apply the differences.

        Raises ConfigurationError with every fault, or where others can write the file or a profile, and ServiceError
        where a drive that may be running would be removed from its bus or the service is ending. Then nothing has
        changed.
        """
        async with self._lock:
            new = await self._in_thread(lambda: _load_trusted(self.plant.config.source))
            if self.plant.state != "running":
                raise ServiceUnavailable("plant.stopping")
            change = config_diff(self.plant.config, new)
            self._refuse_if_running(change)
            notes = address_notes(self.plant.config, new, self._unstarted_gateways())
            await self._apply(change, new)
            notes += self._notes_of_limits(change)
        names = difference_json(change)
        later = sorted(RESTART_ONLY & change.others.keys())
        key = "plant.reloaded_but" if later else "plant.reloaded"
        self.plant.publish_event("configuration", None, key, actor=actor.name, restart=Text.join_names(later))
        return {"difference": names, "restart": later, "notes": notes}

    def close(self) -> None:
        """End a check that is under way."""
        self._check.close()

    def _unstarted_gateways(self) -> frozenset[str]:
        """Return the gateways that the file enables and that this service does not start (``serve --without``)."""
        return frozenset(gateway.id for gateway in self.plant.config.gateways if gateway.id not in self.plant.gateways)

    async def _in_thread(self, work: Callable[[], Any]) -> Any:
        """Run in a thread: reading a file delays no stop."""
        return await asyncio.get_running_loop().run_in_executor(None, work)

    def _refuse_if_running(self, change: ConfigDiff) -> None:
        """Raise ServiceError where a drive that leaves its bus may be running, or has no status that says so."""
        lost = [id for id in _leaving_drives(change) if id in self.plant.drives]
        unreadable = [id for id in lost if not self.plant.drives[id].has_status]
        if unreadable:
            raise ServiceError("plant.reload_no_status", drives=Text.join_names(unreadable))
        turning = [id for id in lost if self.plant.drives[id].may_be_running or self.plant.drives[id].drive.stopping]
        if turning:
            raise ServiceError("plant.reload_turning", drives=Text.join_names(turning))
        silent = [id for id in lost if id in _other_motors(change) and self.plant.drives[id].last_known_turning]
        if silent:
            raise ServiceError("plant.reload_last_turning", drives=Text.join_names(silent))

    def _notes_of_limits(self, change: ConfigDiff) -> list[Json]:
        """Return a note for each drive with a changed table that runs above its limit."""
        drives = (self.plant.drives[id] for id in change.drives.changed)
        return [note for runtime in drives if (note := self.plant.report_above_limit(runtime)) is not None]

    # --- applying -----------------------------------------------------------------------------------------------

    async def _apply(self, change: ConfigDiff, new: PlantConfig) -> None:
        plant = self.plant
        inhibited = self._inhibited_motors()
        turning = {id for id, runtime in plant.drives.items() if runtime.last_known_turning} - _other_motors(change)
        self._end_control(change)
        closing = self._remove_drives(change)
        plant.config = replace(new, **{name: getattr(plant.config, name) for name in RESTART_ONLY})
        self._add_new(new)
        self._inhibit_starts(inhibited)
        for id in turning:
            plant.drives[id].last_known_turning = True  # also behind another port, until it answers
        self._update_drives(change)
        plant.buses = {bus.id: plant.buses[bus.id] for bus in new.buses}
        plant.drives = {drive.id: plant.drives[drive.id] for drive in new.drives}
        plant.interlocks.replace(new.interlocks, _unread_drives(change))
        plant.publish_alarms(
            plant.alarms.configure(new.alarms, new.drives, plant.wall_ms(), replaced_drives=_leaving_drives(change))
        )
        self._clear_alarms(change)
        plant.historian.set_labels(signal_labels(plant.config))
        self._discard_removed(change)
        plant.report_lost_limits()
        plant.notify_reload()
        try:
            await asyncio.gather(*(bus_runtime.close() for bus_runtime in closing))
        finally:  # without an open bus its drives could not be stopped
            for id in (*change.buses.added, *change.reopened):
                plant.buses[id].start()

    def _inhibited_motors(self) -> set[tuple[str, str | int]]:
        """Return every name and place of the motors whose start is inhibited."""
        drives = self.plant.drives.values()
        inhibited = [runtime for runtime in drives if runtime.bus.start_inhibited(runtime.config.address)]
        return {key for runtime in inhibited for key in self._names_and_places(runtime)}

    def _inhibit_starts(self, inhibited: set[tuple[str, str | int]]) -> None:
        """Inhibit what was inhibited before under this name, or in this place under another name."""
        for runtime in self.plant.drives.values():
            if inhibited.intersection(self._names_and_places(runtime)):
                runtime.bus.inhibit_start([runtime.config.address])

    def _names_and_places(self, runtime: DriveRuntime) -> list[tuple[str, str | int]]:
        """Return what a motor is known by: its drive's id, and its address with id and port of its bus."""
        bus, address = self.plant.bus_of(runtime).config, runtime.config.address
        return [("drive", runtime.id), (f"bus {bus.id}", address), (f"port {bus.port}", address)]

    def _end_control(self, change: ConfigDiff) -> None:
        """End control and arm tokens of the drives and groups that are replaced: they were for the motors of before."""
        plant = self.plant
        for id in _leaving_drives(change):
            plant.revoke_arm_tokens(id)
            lease = plant.leases.get(id, plant.now())
            if lease is not None:
                owner = lease.actor.name
                plant.publish_event("lease", id, "plant.control_ended_by_reload", actor=owner, owner=owner)
            plant.leases.remove_drive(id)
        plant.arm_tokens.revoke(*map(arm_target_of_group, (*change.groups.removed, *change.groups.changed)))

    def _remove_drives(self, change: ConfigDiff) -> list[BusRuntime]:
        for id in _leaving_drives(change):
            runtime = self.plant.drives.pop(id)
            self.plant.bus_of(runtime).remove_drive(id)
            self.plant.record_samples(runtime.end_samples(self.plant.wall_ms()))
            self.plant.views.pop(id, None)
            self.plant.notify_drive_removed(id)
        return [self.plant.buses.pop(id) for id in (*change.buses.removed, *change.reopened)]

    def _add_new(self, new: PlantConfig) -> None:
        for bus in new.buses:
            if bus.id not in self.plant.buses:
                self.plant.add_bus(bus, new.drives)
            self.plant.buses[bus.id].config = bus
        for drive in new.drives:
            if drive.id not in self.plant.drives:
                self.plant.add_drive(drive, self.publisher.on_status)

    def _update_drives(self, change: ConfigDiff) -> None:
        """Apply new limits, policies and poll periods to the drives that stay."""
        for id, drive in change.drives.changed.items():
            runtime = self.plant.drives[id]
            if change.actions[id] in (ReloadAction.UPDATE, ReloadAction.REPOLL):
                runtime.reconfigure(drive, polls=change.actions[id] is ReloadAction.REPOLL)
                self.plant.record_samples(runtime.end_samples(self.plant.wall_ms(), but=runtime.signals))
                self.plant.restore(runtime)

    def _clear_alarms(self, change: ConfigDiff) -> None:
        """Clear the system alarms of interlocks and buses that were removed or replaced."""
        for alarm in self.plant.alarms.active():
            if alarm.kind in SYSTEM_ALARM_KINDS and alarm.cleared_ms is None and _subject_is_gone(alarm, change):
                self.plant.clear_alarm(SystemAlarm(alarm.kind), alarm.drive, subject=alarm.subject)

    def _discard_removed(self, change: ConfigDiff) -> None:
        for id in change.drives.removed:
            self.plant.remove_drive(id)
        for id in change.groups.removed:
            self.plant.hub.remove(f"groups/{id}")
        for id in change.buses.removed:
            self.plant.hub.remove(f"buses/{id}")
            self.plant.hub.remove(f"frames/{id}")


def _load_trusted(source: str) -> PlantConfig:
    """Read a file as at a start. Raises ConfigurationError."""
    config = load(source)
    check_plant_files(config)
    return config


def _other_motors(change: ConfigDiff) -> set[str]:
    """Return the drives that are removed or become another motor, not those whose port alone is another one."""
    return {*change.drives.removed, *change.drives.changed}


def _leaving_drives(change: ConfigDiff) -> list[str]:
    """Return the drives that leave their bus, for good or to be added again."""
    recreated = [id for id, action in change.actions.items() if action is ReloadAction.RECREATE]
    return [*change.drives.removed, *recreated]


def _unread_drives(change: ConfigDiff) -> list[str]:
    """Return the drives of which no value is known before the next poll, because this reload starts their polls."""
    repolled = [id for id, action in change.actions.items() if action is ReloadAction.REPOLL]
    return [*_leaving_drives(change), *change.drives.added, *repolled]


def _subject_is_gone(alarm: Alarm, change: ConfigDiff) -> bool:
    if alarm.kind == SystemAlarm.INTERLOCK_TRIP and alarm.subject in (
        *change.interlocks.removed,
        *change.interlocks.changed,
    ):
        return True
    of_bus = alarm.kind in (SystemAlarm.PORT_LOST, SystemAlarm.FOREIGN_MASTER)
    return of_bus and alarm.subject in change.buses.removed
