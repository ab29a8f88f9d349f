"""What is only looked at: drives, groups, buses, frames, profiles, and parameters read for somebody."""

from __future__ import annotations

from typing import Any

from drivebus.service.api import operations as ask
from drivebus.service.api.frames import frame_json
from drivebus.service.api.parameter_json import readings_json
from drivebus.service.api.profile_json import profile_json
from drivebus.service.auth.actor import Actor
from drivebus.service.control.groups import GroupCommands
from drivebus.service.control.tickets import OperationHandler
from drivebus.service.live.publisher import bus_view, drive_view, plant_topic
from drivebus.service.runtime.fairness import iter_cooperatively
from drivebus.service.runtime.plant import Plant

Json = dict[str, Any]


class Queries:
    """Handlers of everything that changes nothing."""

    def __init__(self, plant: Plant, groups: GroupCommands) -> None:
        self.plant, self.groups = plant, groups

    def handlers(self) -> dict[str, OperationHandler]:
        return {
            "plant.get": self.get_plant,
            "plant.statistics": self.get_statistics,
            "drives.list": self.list_drives,
            "drives.get": self.get_drive,
            "drives.profile": self.get_profile,
            "groups.list": self.list_groups,
            "buses.list": self.list_buses,
            "buses.get": self.get_bus,
            "buses.frames": self.list_frames,
            "parameters.read": self.read_parameters,
        }

    async def get_plant(self, params: ask.NoParams, actor: Actor) -> Json:
        return plant_topic(self.plant)

    async def get_statistics(self, params: ask.NoParams, actor: Actor) -> Json:
        """Numbers that only grow while the service runs."""
        plant = self.plant
        return {
            "stops": plant.stop_counters.as_json(),
            "history": plant.historian.status(),
            "drives": {drive: plant.run_statistics.statistics_json(drive) for drive in plant.drives},
        }

    async def list_drives(self, params: ask.NoParams, actor: Actor) -> Json:
        found: list[Json] = []
        async for unit in iter_cooperatively(tuple(self.plant.drives.values())):
            if self.plant.drives.get(unit.id) is unit:
                found.append(drive_view(self.plant, unit).as_json())
        return {"drives": found}

    async def get_drive(self, params: ask.DriveParams, actor: Actor) -> Json:
        return drive_view(self.plant, self.plant.drive(params.drive)).as_json()

    async def get_profile(self, params: ask.DriveParams, actor: Actor) -> Json:
        return profile_json(self.plant.drive(params.drive).profile)

    async def list_groups(self, params: ask.NoParams, actor: Actor) -> Json:
        return {"groups": [self.groups.group_view(group) for group in self.plant.config.groups]}

    async def list_buses(self, params: ask.NoParams, actor: Actor) -> Json:
        found: list[Json] = []
        async for line in iter_cooperatively(tuple(self.plant.buses.values()), 1):
            if self.plant.buses.get(line.config.id) is line:
                found.append(bus_view(self.plant, line))
        return {"buses": found}

    async def get_bus(self, params: ask.BusParams, actor: Actor) -> Json:
        return bus_view(self.plant, self.plant.bus(params.bus))

    async def list_frames(self, params: ask.FramesParams, actor: Actor) -> Json:
        line = self.plant.bus(params.bus)
        kept = [
            frame
            for frame in line.frames
            if frame.number > params.after and params.station in (None, frame.event.station)
        ]
        last = line.frame_count
        return {
            "frames": [frame_json(line, one) async for one in iter_cooperatively(kept[-params.limit :])],
            "last": last,
        }

    async def read_parameters(self, params: ask.ParameterReadParams, actor: Actor) -> Json:
        unit = self.plant.drive(params.drive)
        return {"parameters": readings_json(unit.profile, await unit.drive.read(params.names))}
