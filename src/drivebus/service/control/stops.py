"""Stops of several drives: a group, the whole plant, and what this service started when it ends."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Sequence

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
from drivebus.types import Json

SERVICE_STOP_TIMEOUT_S = 2.8
"""An ending service reports the outcome of its stops within three seconds, confirmed or not."""


class StopCommands:
    """Stops of several drives at once."""

    def __init__(self, plant: Plant, commands: DriveCommands) -> None:
        self.plant, self.commands = plant, commands

    def handlers(self) -> dict[str, OperationHandler]:
        return {"plant.stop": self.stop_all, "group.stop": self.stop_group}

    async def stop_all(self, params: NoParams, actor: Actor) -> Json:
        """Stop all buses at once, each by broadcast and then drive by drive; starts stay inhibited."""
        plant = self.plant
        plant.note_stop(*plant.drives.values())
        everything = [
            (bus_runtime.config.id, bus_runtime, list(bus_runtime.drives.values()))
            for bus_runtime in plant.buses.values()
        ]
        reports = await asyncio.gather(*(_stop_bus(bus_runtime, runtimes) for _, bus_runtime, runtimes in everything))
        buses: Json = {}
        outcomes: Json = {}
        for (bus, _, runtimes), report in zip(everything, reports, strict=True):
            buses[bus], answer = self._count_report(runtimes, report)
            outcomes |= answer
        plant.last_stop_all = {"time_ms": plant.wall_ms(), "actor": actor.name, "buses": buses}
        left = [drive for bus in buses.values() for drive in bus["unconfirmed"]]
        key = "plant.did_stop_all" if not left else "plant.did_stop_all_but"
        plant.publish_event("stop", None, key, actor=actor.name, drives=", ".join(left))
        return {"buses": buses, "outcomes": outcomes}

    def _count_report(self, runtimes: Sequence[DriveRuntime], report: StopReport) -> tuple[Json, Json]:
        by_address = {runtime.drive.address: runtime for runtime in runtimes}
        outcomes: Json = {}
        for address, outcome in report.outcomes:
            runtime = by_address[address]
            outcomes[runtime.id] = outcome_json(outcome, self.plant.command_id("stop"))
            self.plant.stop_counters.count_outcome(outcome)
            if outcome.succeeded:
                runtime.started_by_service, runtime.commanded_hz = False, None
                self.plant.clear_alarm(SystemAlarm.STOP_UNCONFIRMED, runtime.id)
            else:
                self.plant.raise_alarm(SystemAlarm.STOP_UNCONFIRMED, runtime.id)
        unconfirmed = [by_address[address].id for address in report.unconfirmed]
        took_s = round(report.ended_at - report.started_at, 3)
        return {"confirmed": not unconfirmed, "unconfirmed": unconfirmed, "took_s": took_s}, outcomes

    async def stop_group(self, params: GroupParams, actor: Actor) -> Json:
        """Stop every drive of a group at once, and end a group start that is under way."""
        group = self.plant.group(params.group)
        return {"outcomes": await self.stop_many([self.plant.drive_runtime(id) for id in group.drives], actor)}

    async def stop_many(self, runtimes: Iterable[DriveRuntime], actor: Actor) -> Json:
        """Stop drives at once; return the outcome or error of each."""
        wanted = list(runtimes)
        self.plant.note_stop(*wanted)
        many = len(wanted)
        found = await asyncio.gather(*(self._stop_one(runtime, actor, many) for runtime in wanted))
        return {runtime.id: answer for runtime, answer in zip(wanted, found, strict=True)}

    async def _stop_one(self, runtime: DriveRuntime, actor: Actor, many: int) -> Json:
        try:
            outcome = await self.commands.finish_stop(runtime, runtime.drive.stop_concurrently(many))
        except DrivebusError as error:
            return error_to_json(error)
        answer: Json = self.commands.publish_outcome(runtime, "stop", outcome, actor)["outcome"]
        return answer

    async def stop_started_drives(self, actor: Actor) -> Json:
        """Stop what this service started, unless the drive's ``on_service_stop`` is ``hold``, which becomes an event.

        Return the outcome of each stop, None where it was not known within the timeout.
        """
        started = [runtime for runtime in self.plant.drives.values() if runtime.started_by_service]
        runtimes = [runtime for runtime in started if runtime.config.on_service_stop is OnServiceStop.STOP]
        self.plant.note_stop(*runtimes)
        stops = {runtime: asyncio.create_task(self._stop_one(runtime, actor, len(runtimes))) for runtime in runtimes}
        if stops:
            await asyncio.wait(stops.values(), timeout=SERVICE_STOP_TIMEOUT_S)
        for runtime in started:
            if runtime not in stops:
                self.plant.publish_event("lease", runtime.id, "plant.held", actor=actor.name)
        found = {runtime.id: task.result() if task.done() else None for runtime, task in stops.items()}
        for task in stops.values():  # the stops have been sent; their confirmation is not waited for
            task.cancel()
        await asyncio.gather(*stops.values(), return_exceptions=True)
        return found


async def _stop_bus(bus_runtime: BusRuntime, runtimes: Sequence[DriveRuntime]) -> StopReport:
    return await stop_bus(bus_runtime.bus, [runtime.drive for runtime in runtimes])
