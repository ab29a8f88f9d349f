"""What is only looked at: drives, groups, buses, frames, profiles, and parameters read for somebody."""

from __future__ import annotations

from typing import Any

from drivebus.plant import operations as ask
from drivebus.plant.actor import Actor
from drivebus.plant.frames import frame_json
from drivebus.plant.groups import Groups
from drivebus.plant.parameters import readings_json
from drivebus.plant.parts import Handler
from drivebus.plant.profile_view import profile_json
from drivebus.plant.state import Plant
from drivebus.plant.turns import by_and_by
from drivebus.plant.views import bus_view, drive_view, plant_topic

Json = dict[str, Any]


class Answers:
    """Handlers of everything that changes nothing."""

    def __init__(self, plant: Plant, groups: Groups) -> None:
        self.plant, self.groups = plant, groups

    def handlers(self) -> dict[str, Handler]:
        return {
            "plant.get": self.whole, "plant.statistics": self.statistics, "drives.list": self.drives,
            "drives.get": self.drive, "drives.profile": self.profile, "groups.list": self.all_groups,
            "buses.list": self.buses, "buses.get": self.bus, "buses.frames": self.frames,
            "parameters.read": self.read,
        }  # fmt: skip

    async def whole(self, params: ask.Nothing, actor: Actor) -> Json:
        return plant_topic(self.plant)

    async def statistics(self, params: ask.Nothing, actor: Actor) -> Json:
        """Numbers that only grow while the service runs."""
        plant = self.plant
        return {
            "stops": plant.tally.as_json(),
            "history": plant.parts.history_status(),
            "drives": {drive: plant.parts.run_statistics(drive) for drive in plant.units},
        }

    async def drives(self, params: ask.Nothing, actor: Actor) -> Json:
        found: list[Json] = []
        async for unit in by_and_by(tuple(self.plant.units.values())):
            if self.plant.units.get(unit.id) is unit:
                found.append(drive_view(self.plant, unit).as_json())
        return {"drives": found}

    async def drive(self, params: ask.OfDrive, actor: Actor) -> Json:
        return drive_view(self.plant, self.plant.unit(params.drive)).as_json()

    async def profile(self, params: ask.OfDrive, actor: Actor) -> Json:
        return profile_json(self.plant.unit(params.drive).profile)

    async def all_groups(self, params: ask.Nothing, actor: Actor) -> Json:
        return {"groups": [self.groups.view(group) for group in self.plant.setting.groups]}

    async def buses(self, params: ask.Nothing, actor: Actor) -> Json:
        found: list[Json] = []
        async for line in by_and_by(tuple(self.plant.lines.values()), 1):
            if self.plant.lines.get(line.setting.id) is line:
                found.append(bus_view(self.plant, line))
        return {"buses": found}

    async def bus(self, params: ask.OfBus, actor: Actor) -> Json:
        return bus_view(self.plant, self.plant.line(params.bus))

    async def frames(self, params: ask.Frames, actor: Actor) -> Json:
        line = self.plant.line(params.bus)
        kept = [
            frame for frame in line.frames
            if frame.number > params.after and params.station in (None, frame.event.station)
        ]  # fmt: skip
        last = line.count
        return {"frames": [frame_json(line, one) async for one in by_and_by(kept[-params.limit :])], "last": last}

    async def read(self, params: ask.ReadParameters, actor: Actor) -> Json:
        unit = self.plant.unit(params.drive)
        return {"parameters": readings_json(unit.profile, await unit.drive.read(params.names))}
