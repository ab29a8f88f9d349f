"""Stopping more than one drive: a group, everything, and what this service started when it ends."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Sequence
from typing import Any

from drivebus.drives import bus_stop
from drivebus.drives.busstop import StopReport
from drivebus.errors import DrivebusError
from drivebus.plant.actor import Actor
from drivebus.plant.alarms import Own
from drivebus.plant.commands import Commands
from drivebus.plant.failure import failure, outcome_json
from drivebus.plant.lines import Line
from drivebus.plant.model import OnServiceStop
from drivebus.plant.operations import Nothing, OfGroup
from drivebus.plant.parts import Handler
from drivebus.plant.state import Plant
from drivebus.plant.units import Unit

Json = dict[str, Any]
PATIENCE_S = 2.8
"""An ending service waits so long for its drives to report stopped (6.6: confirmed or told within 3 s)."""


class Stopping:
    """Stops of several drives at once."""

    def __init__(self, plant: Plant, commands: Commands) -> None:
        self.plant, self.commands = plant, commands

    def handlers(self) -> dict[str, Handler]:
        return {"plant.stop": self.everything, "group.stop": self.group}

    async def everything(self, params: Nothing, actor: Actor) -> Json:
        """Every bus at once, each with its broadcast and then one by one; everything stays latched."""
        plant = self.plant
        plant.stopped(*plant.units.values())
        everything = [(line.setting.id, line, list(line.units.values())) for line in plant.lines.values()]
        reports = await asyncio.gather(*(_bus(line, units) for _, line, units in everything))
        buses: Json = {}
        outcomes: Json = {}
        for (bus, _, units), report in zip(everything, reports, strict=True):
            buses[bus], told = self._report(units, report)
            outcomes |= told
        plant.last_stop = {"time_ms": plant.wall_ms(), "actor": actor.name, "buses": buses}
        left = [drive for bus in buses.values() for drive in bus["unconfirmed"]]
        key = "plant.did_stop_all" if not left else "plant.did_stop_all_but"
        plant.tell("stop", None, key, actor=actor.name, drives=", ".join(left))
        return {"buses": buses, "outcomes": outcomes}

    def _report(self, units: Sequence[Unit], report: StopReport) -> tuple[Json, Json]:
        by_address = {unit.drive.address: unit for unit in units}
        outcomes: Json = {}
        for address, outcome in report.outcomes:
            unit = by_address[address]
            outcomes[unit.id] = outcome_json(outcome, self.plant.command_id("stop"))
            self.plant.tally.ended(outcome)
            if outcome.done:
                unit.started, unit.commanded_hz = False, None
                self.plant.calm(Own.STOP_UNCONFIRMED, unit.id)
            else:
                self.plant.alarm(Own.STOP_UNCONFIRMED, unit.id)
        unconfirmed = [by_address[address].id for address in report.unconfirmed]
        took_s = round(report.ended_at - report.begun_at, 3)
        return {"confirmed": not unconfirmed, "unconfirmed": unconfirmed, "took_s": took_s}, outcomes

    async def group(self, params: OfGroup, actor: Actor) -> Json:
        """Every drive of the group at once, and nothing of it that still waits for its turn starts."""
        group = self.plant.group(params.group)
        return {"outcomes": await self.all([self.plant.unit(id) for id in group.drives], actor)}

    async def all(self, units: Iterable[Unit], actor: Actor) -> Json:
        """Outcome or error of each."""
        wanted = list(units)
        self.plant.stopped(*wanted)
        many = len(wanted)
        found = await asyncio.gather(*(self._one(unit, actor, many) for unit in wanted))
        return {unit.id: said for unit, said in zip(wanted, found, strict=True)}

    async def _one(self, unit: Unit, actor: Actor, many: int) -> Json:
        try:
            outcome = await self.commands.ended(unit, unit.drive.stop_among(many))
        except DrivebusError as error:
            return failure(error)
        said: Json = self.commands.told(unit, "stop", outcome, actor)["outcome"]
        return said

    async def started_by_us(self, actor: Actor) -> Json:
        """The service ends: stop what it started, unless the drive's policy is to hold; told within three seconds. What
        is held is told too: it turns, and soon nobody watches it."""
        started = [unit for unit in self.plant.units.values() if unit.started]
        units = [unit for unit in started if unit.setting.on_service_stop is OnServiceStop.STOP]
        self.plant.stopped(*units)
        stops = {unit: asyncio.create_task(self._one(unit, actor, len(units))) for unit in units}
        if stops:
            await asyncio.wait(stops.values(), timeout=PATIENCE_S)
        for unit in started:
            if unit not in stops:
                self.plant.tell("lease", unit.id, "plant.held", actor=actor.name)
        found = {unit.id: task.result() if task.done() else None for unit, task in stops.items()}
        for task in stops.values():  # the stops themselves have been sent; nobody waits for their end any more
            task.cancel()
        await asyncio.gather(*stops.values(), return_exceptions=True)
        return found


async def _bus(line: Line, units: Sequence[Unit]) -> StopReport:
    return await bus_stop(line.bus, [unit.drive for unit in units])
