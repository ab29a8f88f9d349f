"""A changed ``plant.toml``: looked at, checked, and taken over while the plant runs, by its difference only.

What did not change goes on as it is and misses no poll. A drive that may turn is not taken from under its stop.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivebus.errors import ConfigurationError, PlantError
from drivebus.plant import operations as ask
from drivebus.plant.actor import Actor
from drivebus.plant.alarms import Alarm, Own
from drivebus.plant.alarms.alarm import OWN
from drivebus.plant.config.difference import Difference, Fate, difference
from drivebus.plant.config.load import load, loads
from drivebus.plant.failure import both
from drivebus.plant.lines import Line
from drivebus.plant.model import PlantSetting
from drivebus.plant.parts import Handler
from drivebus.plant.policies import may_turn
from drivebus.profiles.complaint import Complaint

if TYPE_CHECKING:
    from drivebus.plant.service import Service

Json = dict[str, Any]
PARTS = ("buses", "drives", "groups", "interlocks", "alarms")
AT_START = frozenset({"id", "directory", "history", "audit", "users", "web"})
"""Settings of the whole plant that a running one does not change: told, and taken over at the next start."""


class Reloading:
    """``configuration.*``."""

    def __init__(self, service: Service) -> None:
        self.service, self.plant = service, service.plant
        self._busy = asyncio.Lock()

    def handlers(self) -> dict[str, Handler]:
        return {
            "configuration.get": self.get, "configuration.check": self.check, "configuration.reload": self.reload,
        }  # fmt: skip

    async def get(self, params: ask.Nothing, actor: Actor) -> Json:
        """The file as it is now, which may be newer than what runs. Raises ConfigurationError."""
        source = self.plant.setting.source
        try:
            text = await self._aside(lambda: Path(source).read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigurationError("plant.no_source", source=source, reason=str(error)) from error
        return {"text": text, "source": source}

    async def check(self, params: ask.Configuration, actor: Actor) -> Json:
        """Every mistake of a text, and what it would change; nothing is done."""
        source = self.plant.setting.source
        try:
            new = await self._aside(lambda: loads(params.text, source, Path(source).parent))
        except ConfigurationError as error:
            return {"complaints": _complaints(error), "difference": {}}
        return {"complaints": [], "difference": told(difference(self.plant.setting, new))}

    async def reload(self, params: ask.Nothing, actor: Actor) -> Json:
        """Read the file again and do what differs. Raises ConfigurationError with every mistake; PlantError where a
        drive that may turn would be taken off its bus. Then nothing has changed."""
        async with self._busy:
            new = await self._aside(lambda: load(self.plant.setting.source))
            change = difference(self.plant.setting, new)
            self._keep_hold(change)
            await self._apply(change, new)
        names = told(change)
        later = sorted(AT_START & change.others.keys())
        key = "plant.reloaded_but" if later else "plant.reloaded"
        self.plant.tell("configuration", None, key, actor=actor.name, restart=", ".join(later))
        return {"difference": names, "restart": later}

    async def _aside(self, work: Callable[[], Any]) -> Any:
        """In a thread: no stop waits for the reading of a file."""
        return await asyncio.get_running_loop().run_in_executor(None, work)

    def _keep_hold(self, change: Difference) -> None:
        """Raises PlantError."""
        lost = [id for id in _leaving(change) if id in self.plant.units]
        turning = [id for id in lost if may_turn(self.plant.units[id]) or self.plant.units[id].drive.stopping]
        if turning:
            raise PlantError("plant.reload_turning", drives=", ".join(turning))

    # --- doing it -----------------------------------------------------------------------------------------------

    async def _apply(self, change: Difference, new: PlantSetting) -> None:
        plant = self.plant
        latched = {id for id, unit in plant.units.items() if unit.bus.latched(unit.setting.address)}
        closing = self._take_off(change)
        plant.setting = replace(new, **{name: getattr(plant.setting, name) for name in AT_START})
        self._put_on(new)
        for id in latched & set(_leaving(change)) & plant.units.keys():
            unit = plant.units[id]
            unit.bus.latch([unit.setting.address])
        self._go_on(change)
        plant.lines = {bus.id: plant.lines[bus.id] for bus in new.buses}
        plant.units = {drive.id: plant.units[drive.id] for drive in new.drives}
        plant.parts.interlocks.replace(new.interlocks)
        plant.alarmed(plant.parts.alarms.apply(new.alarms, new.drives, plant.wall_ms()))
        self._calm(change)
        plant.parts.on_setting(plant.setting)
        self._forget(change)
        await asyncio.gather(*(line.close() for line in closing))
        for id in (*change.buses.added, *change.reopened):
            plant.lines[id].start()

    def _take_off(self, change: Difference) -> list[Line]:
        for id in _leaving(change):
            plant_line = self.plant.line_of(self.plant.units[id])
            self.plant.units.pop(id)
            plant_line.remove(id)
        return [self.plant.lines.pop(id) for id in (*change.buses.removed, *change.reopened)]

    def _put_on(self, new: PlantSetting) -> None:
        for bus in new.buses:
            if bus.id not in self.plant.lines:
                self.service.add_bus(bus, new.drives)
            self.plant.lines[bus.id].setting = bus
        for drive in new.drives:
            if drive.id not in self.plant.units:
                self.service.add_drive(drive)

    def _go_on(self, change: Difference) -> None:
        """Drives that stay: their new limits and policies, their new periods."""
        for id, drive in change.drives.changed.items():
            unit = self.plant.units[id]
            if change.fates[id] in (Fate.LIVE, Fate.POLLS):
                unit.take(drive, polls=change.fates[id] is Fate.POLLS)
                self.plant.recall(unit)

    def _calm(self, change: Difference) -> None:
        """What the service had found about something that is gone is over, and about an interlock that is another."""
        for alarm in self.plant.parts.alarms.active():
            if alarm.kind in OWN and alarm.cleared_ms is None and _is_gone(alarm, change):
                self.plant.calm(Own(alarm.kind), alarm.drive, about=alarm.about)

    def _forget(self, change: Difference) -> None:
        for id in _leaving(change):
            self.service.watching.ask_again(id)
        for id in change.drives.removed:
            self.plant.leases.forget(id)
            self.service.watching.forget(id)
        for id in change.groups.removed:
            self.plant.hub.remove(f"groups/{id}")
        for id in change.buses.removed:
            self.plant.hub.remove(f"buses/{id}")
            self.plant.hub.remove(f"frames/{id}")


def _leaving(change: Difference) -> list[str]:
    """Drives that are taken off their bus, for good or to be added anew."""
    anew = [id for id, fate in change.fates.items() if fate is Fate.ANEW]
    return [*change.drives.removed, *anew]


def _is_gone(alarm: Alarm, change: Difference) -> bool:
    if alarm.kind == Own.INTERLOCK and alarm.about in (*change.interlocks.removed, *change.interlocks.changed):
        return True
    of_bus = alarm.kind in (Own.PORT, Own.FOREIGN_MASTER)
    return alarm.about in change.buses.removed if of_bus else alarm.drive in change.drives.removed


def told(change: Difference) -> Json:
    """What came, what went, what is different, by name."""
    parts = [getattr(change, name) for name in PARTS]
    changed = [id for part in parts for id in part.changed]
    return {
        "added": _names(id for part in parts for id in part.added),
        "changed": _names((*changed, *change.others)),
        "removed": _names(id for part in parts for id in part.removed),
    }


def _names(found: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(found))


def _complaints(error: ConfigurationError) -> list[Json]:
    found: Iterable[Complaint] = error.params.get("complaints", ())
    return [
        {"line": one.line, "key": one.key, "found": one.found, "text": {"en": one.text("en"), "zh": one.text("zh")}}
        for one in found
    ] or [{"line": None, "key": "", "found": "", "text": both(error.key, error.params)}]
