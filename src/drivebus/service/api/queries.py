"""``Queries``: handlers of the operations that change nothing."""

from __future__ import annotations

from drivebus.service.api.frames import frame_json
from drivebus.service.api.operations.buses import BusParams, FramesParams
from drivebus.service.api.operations.drives import DriveParams, ParameterReadParams
from drivebus.service.api.operations.operation import NoParams
from drivebus.service.api.profile_json import profile_json, readings_json
from drivebus.service.auth.actor import Actor
from drivebus.service.control.groups import GroupCommands
from drivebus.service.control.tickets import OperationHandler
from drivebus.service.live.publisher import bus_view, drive_view, plant_topic
from drivebus.service.runtime.fairness import iter_cooperatively
from drivebus.service.runtime.plant import Plant
from drivebus.types import Json


class Queries:
    """Answers from the present state of the service; only parameters are read from the bus."""

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

    async def get_plant(self, params: NoParams, actor: Actor) -> Json:
        return plant_topic(self.plant)

    async def get_statistics(self, params: NoParams, actor: Actor) -> Json:
        """Return counters, which only grow while the service runs."""
        plant = self.plant
        return {
            "stops": plant.stop_counters.as_json(),
            "history": plant.historian.status(),
            "drives": {drive: plant.run_statistics.statistics_json(drive) for drive in plant.drives},
        }

    async def list_drives(self, params: NoParams, actor: Actor) -> Json:
        found: list[Json] = []
        async for drive in iter_cooperatively(tuple(self.plant.drives.values())):
            if self.plant.drives.get(drive.id) is drive:
                found.append(drive_view(self.plant, drive).as_json())
        return {"drives": found}

    async def get_drive(self, params: DriveParams, actor: Actor) -> Json:
        return drive_view(self.plant, self.plant.drive_runtime(params.drive)).as_json()

    async def get_profile(self, params: DriveParams, actor: Actor) -> Json:
        return profile_json(self.plant.drive_runtime(params.drive).profile)

    async def list_groups(self, params: NoParams, actor: Actor) -> Json:
        return {"groups": [self.groups.group_view(group) for group in self.plant.config.groups]}

    async def list_buses(self, params: NoParams, actor: Actor) -> Json:
        found: list[Json] = []
        async for bus in iter_cooperatively(tuple(self.plant.buses.values()), 1):
            if self.plant.buses.get(bus.config.id) is bus:
                found.append(bus_view(self.plant, bus))
        return {"buses": found}

    async def get_bus(self, params: BusParams, actor: Actor) -> Json:
        return bus_view(self.plant, self.plant.bus_runtime(params.bus))

    async def list_frames(self, params: FramesParams, actor: Actor) -> Json:
        bus = self.plant.bus_runtime(params.bus)
        frames = [
            frame
            for frame in bus.frames
            if frame.number > params.after and params.station in (None, frame.event.station)
        ]
        last = bus.frame_count
        return {
            "frames": [frame_json(bus, one) async for one in iter_cooperatively(frames[-params.limit :])],
            "last": last,
        }

    async def read_parameters(self, params: ParameterReadParams, actor: Actor) -> Json:
        drive = self.plant.drive_runtime(params.drive)
        return {"parameters": readings_json(drive.profile, await drive.drive.read(params.names))}
