"""Stops of several drives: a group, the whole plant, and what this service started when it ends."""

from __future__ import annotations

import asyncio
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence

from drivebus.bus import Bus
from drivebus.drives import stop_bus
from drivebus.drives.bus_stop import StopReport
from drivebus.drives.outcome import Outcome
from drivebus.drives.state import DriveState
from drivebus.drives.stop_supervisor import JointStops
from drivebus.errors import DrivebusError
from drivebus.service.alarms import SystemAlarm
from drivebus.service.api.command_records import record_or_queue
from drivebus.service.api.errors import error_to_json, exchange_json, outcome_json
from drivebus.service.api.handlers import handles
from drivebus.service.api.operations.drives import DRIVE_STOP
from drivebus.service.api.operations.groups import GROUP_STOP, GroupParams
from drivebus.service.api.operations.operation import NoParams
from drivebus.service.api.operations.plant import PLANT_STOP
from drivebus.service.audit import AuditEntry
from drivebus.service.auth.actor import Actor
from drivebus.service.config.model import OnServiceStop
from drivebus.service.control.drive_commands import DriveCommands, repeated_stop
from drivebus.service.runtime.drive import DriveRuntime
from drivebus.service.runtime.plant import Plant, PlantListener
from drivebus.types import Json
from drivebus.values import Text

SERVICE_STOP_TIMEOUT_S = 2.8
"""An ending service reports the outcome of its stops within three seconds, confirmed or not."""
DECELERATING: Json = {"state": DriveState.DECELERATING.value}
"""In place of the outcome of a stop that was not awaited."""
SERVICE_STOP_CHECK_S = 0.05  # between two checks of outcomes and first reads


class StopCommands(PlantListener):
    """Stops of several drives at once, and the end of stops that had to be repeated."""

    def __init__(self, plant: Plant, commands: DriveCommands, service: Actor) -> None:
        self.plant, self.commands, self.service_actor = plant, commands, service
        plant.subscribe(self)

    @handles(PLANT_STOP)
    async def stop_all(self, params: NoParams, actor: Actor) -> Json:
        """Stop all buses at once, each by broadcast and then drive by drive; starts stay inhibited."""
        plant = self.plant
        plant.record_stop_request(*plant.drives.values(), by=actor.name, kind="all")
        drives = {id: list(bus_runtime.drives.values()) for id, bus_runtime in plant.buses.items()}
        reports = await asyncio.gather(
            *(stop_bus(plant.buses[id].bus, [runtime.drive for runtime in runtimes]) for id, runtimes in drives.items())
        )
        buses: Json = {}
        outcomes: Json = {}
        for (id, runtimes), report in zip(drives.items(), reports, strict=True):
            buses[id], answer = self._count_report(runtimes, report)
            outcomes |= answer
        plant.last_stop_all = {"time_ms": plant.wall_ms(), "actor": actor.name, "buses": buses}
        self._publish_stop_all(buses, outcomes, actor)
        return {"buses": buses, "outcomes": outcomes}

    def _publish_stop_all(self, buses: Json, outcomes: Json, actor: Actor) -> None:
        """Publish the event of a stop of everything, with the drives that must be checked."""
        unconfirmed = [drive for bus in buses.values() for drive in bus["unconfirmed"]]
        acknowledged = [drive for bus in buses.values() for drive in bus["acknowledged"]]
        if unconfirmed:
            key = "plant.did_stop_all_but"
        elif acknowledged:
            key = "plant.did_stop_all_acknowledged"
        else:
            key = "plant.did_stop_all" if outcomes else "plant.did_stop_all_no_drives"
        drives = Text.join_names(unconfirmed or acknowledged)
        self.plant.publish_event("stop", None, key, actor=actor.name, drives=drives)

    def _count_report(self, runtimes: Sequence[DriveRuntime], report: StopReport) -> tuple[Json, Json]:
        by_address = {runtime.drive.address: runtime for runtime in runtimes}
        outcomes: Json = {}
        for address, outcome in report.outcomes:
            runtime = by_address[address]
            outcomes[runtime.id] = outcome_json(repeated_stop(runtime, outcome), self.plant.command_id("stop"))
            if outcome.succeeded:
                self.commands.record_stopped(runtime, outcome)
            else:
                self.plant.raise_alarm(SystemAlarm.STOP_UNCONFIRMED, runtime.id)
        result = {
            "confirmed": report.confirmed,
            "acknowledged": [by_address[address].id for address in report.acknowledged],
            "unconfirmed": [by_address[address].id for address in report.unconfirmed],
            "took_s": round(report.ended_at - report.started_at, 3),
        }
        return result, outcomes

    @handles(GROUP_STOP)
    async def stop_group(self, params: GroupParams, actor: Actor) -> Json:
        """Stop every drive of a group at once, and end a group start that is under way."""
        group = self.plant.group(params.group)
        return {"outcomes": await self.stop_many([self.plant.drive_runtime(id) for id in group.drives], actor)}

    async def stop_many(self, runtimes: Iterable[DriveRuntime], actor: Actor) -> Json:
        """Stop drives at once; return the outcome or error of each."""
        stopped = list(runtimes)
        self.plant.record_stop_request(*stopped, by=actor.name, kind="group")
        joint: defaultdict[Bus, JointStops] = defaultdict(JointStops)
        answers = await asyncio.gather(*(self._stop_one(runtime, actor, joint[runtime.bus]) for runtime in stopped))
        return {runtime.id: answer for runtime, answer in zip(stopped, answers, strict=True)}

    async def _stop_one(self, runtime: DriveRuntime, actor: Actor, joint: JointStops) -> Json:
        try:
            outcome = await self.commands.finish_stop(runtime, runtime.drive.stop(joint=joint))
        except DrivebusError as error:
            return error_to_json(error)
        answer: Json = self.commands.publish_outcome(runtime, "stop", outcome, actor)["outcome"]
        return answer

    def on_repeated_stop(self, drive: DriveRuntime, outcome: Outcome) -> None:
        """Report and record a stop that was not confirmed when it was requested: the service has repeated it."""
        self.commands.end_motion(drive)
        answer = self.commands.publish_outcome(drive, "stop", outcome, self.service_actor)["outcome"]
        self._record_repeated(drive, answer["status"], answer["frames"])

    async def stop_started_drives(self) -> Json:
        """Stop what this service started or adopted, unless the drive's ``on_service_stop`` is ``hold``.

        A drive that has not been read yet is stopped as soon as its first read shows it running; any other drive that
        may be running becomes an event. Return the outcome of each stop, also of one that was under way; of a stop that
        is not confirmed within the timeout ``DECELERATING`` where the drive reports that, else None.
        """
        plant, actor = self.plant, self.service_actor
        timeout_at = plant.now() + SERVICE_STOP_TIMEOUT_S
        joint: defaultdict[Bus, JointStops] = defaultdict(JointStops)
        stops: dict[DriveRuntime, asyncio.Task[Json]] = {}
        requests: dict[DriveRuntime, asyncio.Task[int | None]] = {}
        while plant.now() < timeout_at:
            others = [runtime for runtime in plant.drives.values() if runtime not in stops]
            started = [runtime for runtime in others if _stops_with_service(runtime)]
            plant.record_stop_request(*started, by=actor.name, kind="service")
            stops |= {
                runtime: asyncio.create_task(self._stop_one(runtime, actor, joint[runtime.bus])) for runtime in started
            }
            # These tasks begin after those of the stops, whose first frames are queued then.
            requests |= {runtime: asyncio.create_task(self._record_request(runtime)) for runtime in started}
            awaited = any(other.awaits_first_read or other.drive.stopping for other in others)
            if all(task.done() for task in stops.values()) and not awaited:
                break
            await asyncio.sleep(SERVICE_STOP_CHECK_S)
        outcomes = self._record_service_stops(stops, requests)
        # The stops have been sent, the records are queued: neither is waited for.
        unfinished = [*stops.values(), *requests.values()]
        for task in unfinished:
            task.cancel()
        await asyncio.gather(*unfinished, return_exceptions=True)
        return outcomes

    def _record_service_stops(
        self,
        stops: Mapping[DriveRuntime, asyncio.Task[Json]],
        requests: Mapping[DriveRuntime, asyncio.Task[int | None]],
    ) -> Json:
        """Record the outcomes of the stops of an ending service and return them; report each drive that may run on."""
        outcomes: Json = {}
        for runtime, stop in stops.items():
            outcome = outcomes[runtime.id] = stop.result() if stop.done() else _unfinished(runtime)
            reported, request = outcome or {}, requests[runtime]
            status = str(reported.get("status") or reported.get("code") or reported.get("state") or "unknown")
            sent = reported.get("frames") or (reported.get("outcome") or {}).get("frames")  # of a stop; of an error
            frames = sent or [exchange_json(exchange) for exchange in runtime.drive.stop_exchanges]
            self._record_outcome(runtime, status, frames, request.result() if request.done() else None)
        for runtime in self.plant.drives.values():
            if runtime in stops:
                continue
            if runtime.drive.stopping:
                outcome = outcomes[runtime.id] = _unfinished(runtime)
                if runtime.drive.stop_pending:  # any other one is recorded when its request ends
                    self._record_repeated(runtime, DECELERATING["state"] if outcome else "unknown", ())
            elif key := _left_running(runtime):
                self.plant.publish_event("not_stopped", runtime.id, key, actor=self.service_actor.name)
        return outcomes

    async def _record_request(self, runtime: DriveRuntime) -> int | None:
        """Record that the ending service stops a drive; return as ``record_or_queue``."""
        entry = AuditEntry.by(self.service_actor, DRIVE_STOP.name, target=runtime.id, outcome="requested")
        return await record_or_queue(self.plant, entry)

    def _record_repeated(self, runtime: DriveRuntime, status: str, frames: Sequence[Json]) -> None:
        """Record how a stop ended that was not confirmed when it was requested, with who requested it."""
        requested = {"requested_by": runtime.last_stop.actor} if runtime.last_stop is not None else {}
        self._record_outcome(runtime, status, frames, runtime.stop_record, requested)

    def _record_outcome(
        self, runtime: DriveRuntime, status: str, frames: Sequence[Json], of: int | None, params: Json | None = None
    ) -> None:
        """Record how a stop by the service ended, or that the drive decelerates. Never waits."""
        entry = AuditEntry.by(
            self.service_actor,
            DRIVE_STOP.name,
            target=runtime.id,
            params=params or {},
            outcome=status,
            frames=frames,
            of=of,
        )
        self.plant.audit.record_nowait(entry)


def _stops_with_service(runtime: DriveRuntime) -> bool:
    """Return whether an ending service stops a drive: by its policy, or because it would stay in a ramp hold."""
    by_policy = runtime.runs_for_service and runtime.config.on_service_stop is OnServiceStop.STOP
    return by_policy or runtime.ramp_holds > 0


def _unfinished(runtime: DriveRuntime) -> Json | None:
    """Return ``DECELERATING`` for a drive that obeys the stop that was sent: its ramp takes longer than the end."""
    return DECELERATING if runtime.decelerating else None


def _left_running(runtime: DriveRuntime) -> str | None:
    """Return the key of the sentence about a drive that may be running and is not stopped; None for one at rest."""
    if runtime.runs_for_service:
        return "plant.held"
    if runtime.state_is_unknown:
        return "plant.left_unknown"
    return "plant.left_running" if runtime.turning else None
