"""Incidents of a running plant: record one when a drive trips, and answer operations on those recorded."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Mapping, Sequence
from typing import Any

from drivebus.bus.trace import TraceEvent
from drivebus.errors import NotFound
from drivebus.service.alarms import Alarm, AlarmChange
from drivebus.service.api.frames import frame_json
from drivebus.service.api.handlers import handles
from drivebus.service.api.operations.history import TimeRangeParams
from drivebus.service.api.operations.incidents import (
    INCIDENT_NOTE,
    INCIDENTS_GET,
    INCIDENTS_LIST,
    IncidentNoteParams,
    IncidentParams,
)
from drivebus.service.api.profile_json import readings_json
from drivebus.service.auth.actor import Actor
from drivebus.service.incidents.recorder import (
    INCIDENT_FRAMES,
    TRIP_ALARM_KINDS,
    BusSnapshot,
    IncidentRecorder,
    incident_parameters,
)
from drivebus.service.incidents.store import IncidentStore
from drivebus.service.live.views import DriveView, Sample
from drivebus.service.runtime.drive import DriveRuntime
from drivebus.service.runtime.fairness import iter_cooperatively
from drivebus.service.runtime.plant import Plant, PlantListener
from drivebus.types import Json


class IncidentService(PlantListener):
    """Recorder of a plant's incidents, and the handlers of ``incidents.*``."""

    def __init__(self, plant: Plant, store: IncidentStore) -> None:
        self._plant, self._store = plant, store
        self.recorder = IncidentRecorder(store, self._read_parameters)
        self._tasks: set[asyncio.Task[None]] = set()
        plant.subscribe(self)

    # --- PlantListener ----------------------------------------------------------------------------------------------

    def on_alarm(self, change: AlarmChange) -> None:
        """Record an incident of a new trip once the current step is over, so that the trip itself is in it."""
        if change.action == "raised" and change.alarm.kind in TRIP_ALARM_KINDS:
            asyncio.get_running_loop().call_soon(self._start, self._record_incident, change.alarm)
        elif change.action == "named" and change.alarm.incident is not None:
            self._start(self._rename_incident, change.alarm)

    def on_view(self, view: DriveView) -> None:
        self.recorder.record_view(view, self._plant.now())

    def on_samples(self, samples: Sequence[Sample]) -> None:
        self.recorder.record_samples(samples[0].tag.partition(".")[0], samples, self._plant.now())

    def on_event(self, event: Json) -> None:
        self.recorder.record_event(event)

    def on_drive_removed(self, drive: str) -> None:
        self.recorder.remove_drive(drive)

    # --- recording --------------------------------------------------------------------------------------------------

    def _start(self, act: Callable[[Alarm], Coroutine[Any, Any, None]], alarm: Alarm) -> None:
        task = asyncio.get_running_loop().create_task(act(alarm), name=f"incident of {alarm.id}")
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _record_incident(self, alarm: Alarm) -> None:
        plant = self._plant
        try:
            bus = await self._bus_snapshot(alarm.drive)
            recording = self.recorder.capture(alarm, plant.views.get(alarm.drive), bus, plant.now(), plant.wall_ms())
        except Exception as error:  # of a part that can't be copied
            self.recorder.report_failure(alarm.drive, error)
            return
        incident = await asyncio.shield(recording)
        if incident is not None:
            plant.publish_alarms(plant.alarms.attach_incident(alarm.id, incident))
            named = plant.alarms.find(alarm.id)
            if named is not None and named.id == alarm.id and named.text != alarm.text:  # named while it was saved
                await self._rename_incident(named)

    async def _rename_incident(self, alarm: Alarm) -> None:
        """Give an incident the texts of its alarm, whose fault is named now."""
        assert alarm.incident is not None
        try:
            await asyncio.to_thread(self._store.rename, alarm.incident, alarm.as_json())
        except NotFound:  # deleted meanwhile, because newer ones took its place
            pass
        except OSError as error:
            self.recorder.report_failure(alarm.drive, error)

    async def _bus_snapshot(self, drive: str) -> BusSnapshot | None:
        """Return the newest frames of the drive's bus. They are decoded in turns: stops are likely after a trip."""
        runtime = self._plant.drives.get(drive)
        if runtime is None:
            return None
        bus = self._plant.bus_of(runtime)
        newest = [frame for frame in bus.frames if not _is_of_former_drive(frame.event, runtime)][-INCIDENT_FRAMES:]
        frames = [(frame_json(bus, frame), frame.event) async for frame in iter_cooperatively(newest, internal=True)]
        return BusSnapshot(bus.config.id, bus.config.port, bus.bus.port.settings, frames)

    async def _read_parameters(self, drive: str) -> Mapping[str, Json]:
        """Read the parameters that help to explain a trip. Reads wait behind every command."""
        runtime = self._plant.drive_runtime(drive)
        return readings_json(runtime.profile, await runtime.drive.read(incident_parameters(runtime.profile)))

    async def close(self) -> None:
        """Finish the recordings that are under way."""
        await self.recorder.close()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    # --- operations -------------------------------------------------------------------------------------------------

    @handles(INCIDENTS_LIST)
    async def list_incidents(self, params: TimeRangeParams, actor: Actor) -> Json:
        span = (params.from_ms, params.to_ms, params.drive, params.cursor, params.limit)
        return await asyncio.to_thread(self._store.query, *span)

    @handles(INCIDENTS_GET)
    async def get_incident(self, params: IncidentParams, actor: Actor) -> Json:
        return await asyncio.to_thread(self._store.get, params.incident)

    @handles(INCIDENT_NOTE)
    async def add_note(self, params: IncidentNoteParams, actor: Actor) -> Json:
        note = {"time_ms": self._plant.wall_ms(), "by": actor.name, "text": params.note}
        return {"notes": await asyncio.to_thread(self._store.add_note, params.incident, note)}


def _is_of_former_drive(event: TraceEvent, runtime: DriveRuntime) -> bool:
    """Return whether a frame is of the drive that had this address before a reload."""
    return event.station == runtime.config.address and event.time < runtime.added_at
