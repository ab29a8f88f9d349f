"""Stopping more than one drive: a group, everything, and what this service started when it ends."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Sequence
from typing import Any

from drivebus.drives import stop_bus
from drivebus.drives.bus_stop import StopReport
from drivebus.errors import DrivebusError
from drivebus.service.alarms import SystemAlarm
from drivebus.service.api.errors import error_to_json, outcome_json
from drivebus.service.api.operations.groups import GroupParams
from drivebus.service.api.operations.operation import NoParams
from drivebus.service.auth.actor import Actor
from drivebus.service.config.model import OnServiceStop
from drivebus.service.control.drive_commands import DriveCommands
from drivebus.service.control.tickets import OperationHandler
from drivebus.service.runtime.bus import BusRuntime
from drivebus.service.runtime.drive import DriveRuntime
from drivebus.service.runtime.plant import Plant

Json = dict[str, Any]
SERVICE_STOP_TIMEOUT_S = 2.8
"""An ending service waits so long for its drives to report stopped (6.6: confirmed or told within 3 s)."""


class StopCommands:
    """Stops of several drives at once."""

    def __init__(self, plant: Plant, commands: DriveCommands) -> None:
        self.plant, self.commands = plant, commands

    def handlers(self) -> dict[str, OperationHandler]:
        return {"plant.stop": self.stop_all, "group.stop": self.stop_group}

    async def stop_all(self, params: NoParams, actor: Actor) -> Json:
        """Every bus at once, each with its broadcast and then one by one; everything stays latched."""
        plant = self.plant
        plant.note_stop(*plant.drives.values())
        everything = [(line.config.id, line, list(line.drives.values())) for line in plant.buses.values()]
        reports = await asyncio.gather(*(_stop_bus(line, units) for _, line, units in everything))
        buses: Json = {}
        outcomes: Json = {}
        for (bus, _, units), report in zip(everything, reports, strict=True):
            buses[bus], told = self._count_report(units, report)
            outcomes |= told
        plant.last_stop_all = {"time_ms": plant.wall_ms(), "actor": actor.name, "buses": buses}
        left = [drive for bus in buses.values() for drive in bus["unconfirmed"]]
        key = "plant.did_stop_all" if not left else "plant.did_stop_all_but"
        plant.publish_event("stop", None, key, actor=actor.name, drives=", ".join(left))
        return {"buses": buses, "outcomes": outcomes}

    def _count_report(self, units: Sequence[DriveRuntime], report: StopReport) -> tuple[Json, Json]:
        by_address = {unit.drive.address: unit for unit in units}
        outcomes: Json = {}
        for address, outcome in report.outcomes:
            unit = by_address[address]
            outcomes[unit.id] = outcome_json(outcome, self.plant.command_id("stop"))
            self.plant.stop_counters.count_outcome(outcome)
            if outcome.succeeded:
                unit.started_by_service, unit.commanded_hz = False, None
                self.plant.clear_alarm(SystemAlarm.STOP_UNCONFIRMED, unit.id)
            else:
                self.plant.raise_alarm(SystemAlarm.STOP_UNCONFIRMED, unit.id)
        unconfirmed = [by_address[address].id for address in report.unconfirmed]
        took_s = round(report.ended_at - report.started_at, 3)
        return {"confirmed": not unconfirmed, "unconfirmed": unconfirmed, "took_s": took_s}, outcomes

    async def stop_group(self, params: GroupParams, actor: Actor) -> Json:
        """Every drive of the group at once, and nothing of it that still waits for its turn starts."""
        group = self.plant.group(params.group)
        return {"outcomes": await self.stop_many([self.plant.drive(id) for id in group.drives], actor)}

    async def stop_many(self, units: Iterable[DriveRuntime], actor: Actor) -> Json:
        """Outcome or error of each."""
        wanted = list(units)
        self.plant.note_stop(*wanted)
        many = len(wanted)
        found = await asyncio.gather(*(self._stop_one(unit, actor, many) for unit in wanted))
        return {unit.id: said for unit, said in zip(wanted, found, strict=True)}

    async def _stop_one(self, unit: DriveRuntime, actor: Actor, many: int) -> Json:
        try:
            outcome = await self.commands.finish_stop(unit, unit.drive.stop_concurrently(many))
        except DrivebusError as error:
            return error_to_json(error)
        said: Json = self.commands.publish_outcome(unit, "stop", outcome, actor)["outcome"]
        return said

    async def stop_started_drives(self, actor: Actor) -> Json:
        """The service ends: stop what it started, unless the drive's policy is to hold; told within three seconds. What
        is held is told too: it turns, and soon nobody watches it."""
        started = [unit for unit in self.plant.drives.values() if unit.started_by_service]
        units = [unit for unit in started if unit.config.on_service_stop is OnServiceStop.STOP]
        self.plant.note_stop(*units)
        stops = {unit: asyncio.create_task(self._stop_one(unit, actor, len(units))) for unit in units}
        if stops:
            await asyncio.wait(stops.values(), timeout=SERVICE_STOP_TIMEOUT_S)
        for unit in started:
            if unit not in stops:
                self.plant.publish_event("lease", unit.id, "plant.held", actor=actor.name)
        found = {unit.id: task.result() if task.done() else None for unit, task in stops.items()}
        for task in stops.values():  # the stops themselves have been sent; nobody waits for their end any more
            task.cancel()
        await asyncio.gather(*stops.values(), return_exceptions=True)
        return found


async def _stop_bus(line: BusRuntime, units: Sequence[DriveRuntime]) -> StopReport:
    return await stop_bus(line.bus, [unit.drive for unit in units])
