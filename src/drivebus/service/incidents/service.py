"""Alarms and cases as people ask for them, and the flight recorder among the plant's rooms: it hears what they hear,
and freezes a case when a trip is raised.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence

from drivebus.service.alarms import Alarm, SystemAlarm
from drivebus.service.alarms.log import AlarmLog, alarm_number
from drivebus.service.api import operations as ask
from drivebus.service.api.errors import os_reason
from drivebus.service.api.frames import frame_json
from drivebus.service.api.parameter_json import readings_json
from drivebus.service.auth.actor import Actor
from drivebus.service.incidents import IncidentRecorder, IncidentStore
from drivebus.service.incidents.recorder import INCIDENT_FRAMES, TRIP_ALARM_KINDS, BusSnapshot, incident_parameters
from drivebus.service.live.views import DriveView, Json, Sample
from drivebus.service.parts import OperationHandler
from drivebus.service.runtime.fairness import iter_cooperatively
from drivebus.service.runtime.plant import Plant

STORE_CHECK_INTERVAL_S = 5.0
"""How often stores that are written in the background are looked at."""


class AlarmIncidentService:
    """``bind`` it to the plant before that starts. It is the alarm book's log: what is raised passes through it."""

    def __init__(self, log: AlarmLog, store: IncidentStore, now: Callable[[], float]) -> None:
        self._log, self._store, self._now = log, store, now
        self.recorder = IncidentRecorder(store, self._read_parameters)
        self._views: dict[str, DriveView] = {}
        self._plant: Plant | None = None
        self._tasks: set[asyncio.Task[None]] = set()
        self._newest_alarm = 0
        """Number of the newest alarm: whatever happens to an older one is no trip."""
        self.stores: dict[str, Callable[[], Exception | None]] = {
            "alarms.jsonl": lambda: log.error,
            "incidents": lambda: self.recorder.error,
        }
        """What is written in the background → why that fails now."""
        self._check_task: asyncio.Task[None] | None = None

    def bind(self, plant: Plant) -> None:
        """This is the plant."""
        self._plant, self._newest_alarm = plant, self._log.next_number - 1
        self._check_task = asyncio.get_running_loop().create_task(self._check_stores(plant), name="look after stores")

    async def _check_stores(self, plant: Plant) -> None:
        """A store that fails in the background is an alarm, and is tried again."""
        while True:
            await asyncio.sleep(STORE_CHECK_INTERVAL_S)
            for name, error in self.stores.items():
                if (found := error()) is not None:
                    plant.raise_alarm(SystemAlarm.STORAGE_FAILURE, subject=name, reason=os_reason(found))
                else:
                    plant.clear_alarm(SystemAlarm.STORAGE_FAILURE, subject=name)
            self._log.retry()

    @property
    def plant(self) -> Plant:
        assert self._plant is not None, "bind it first"
        return self._plant

    # --- what it hears ---------------------------------------------------------------------------------------------

    def put(self, alarm: Alarm) -> None:
        """From the alarm book. A new trip is frozen when this look at the drive is over, so that it shows the trip."""
        self._log.put(alarm)
        new, self._newest_alarm = (
            alarm_number(alarm.id) > self._newest_alarm,
            max(self._newest_alarm, alarm_number(alarm.id)),
        )
        if new and alarm.kind in TRIP_ALARM_KINDS and self._plant is not None:
            asyncio.get_running_loop().call_soon(self._start_incident, alarm)

    def on_view(self, view: DriveView, now: float, now_ms: int) -> None:
        """Every look at a drive."""
        self._views[view.id] = view
        self.recorder.record_view(view, now)

    def on_samples(self, samples: Sequence[Sample]) -> None:
        """Every reading, as the history gets it; those of one drive at a time."""
        if samples:
            self.recorder.record_samples(samples[0].tag.partition(".")[0], samples, self._now())

    def on_event(self, event: Json) -> None:
        """Every event."""
        self.recorder.record_event(event)

    def remove_drive(self, drive: str) -> None:
        """It is no longer part of the plant."""
        self._views.pop(drive, None)
        self.recorder.remove_drive(drive)

    # --- a trip ----------------------------------------------------------------------------------------------------

    def _start_incident(self, alarm: Alarm) -> None:
        task = asyncio.get_running_loop().create_task(self._record_incident(alarm), name=f"case of {alarm.id}")
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _record_incident(self, alarm: Alarm) -> None:
        plant, line = self.plant, await self._bus_snapshot(alarm.drive)
        kept = self.recorder.capture(alarm, self._views.get(alarm.drive), line, plant.now(), plant.wall_ms())
        case = await asyncio.shield(kept)
        if case is not None and any(one.id == alarm.id for one in plant.parts.alarms.active()):
            plant.publish_alarms(plant.parts.alarms.attach_incident(alarm.id, case))

    async def _bus_snapshot(self, drive: str) -> BusSnapshot | None:
        """Its newest frames as they are at once, decoded by and by: a trip is when stops are wanted."""
        unit = self.plant.drives.get(drive)
        if unit is None:
            return None
        line = self.plant.bus_of(unit)
        newest = list(line.frames)[-INCIDENT_FRAMES:]
        frames = [(frame_json(line, seen), seen.event) async for seen in iter_cooperatively(newest, internal=True)]
        return BusSnapshot(line.config.id, line.config.link, line.bus.port.settings, frames)

    async def _read_parameters(self, drive: str) -> Mapping[str, Json]:
        """Reads; they wait behind every command."""
        unit = self.plant.drive(drive)
        return readings_json(unit.profile, await unit.drive.read(incident_parameters(unit.profile)))

    async def close(self) -> None:
        """Keep what is being kept."""
        if self._check_task is not None:
            self._check_task.cancel()
            await asyncio.wait([self._check_task])
        await self.recorder.close()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    # --- operations ------------------------------------------------------------------------------------------------

    def handlers(self) -> dict[str, OperationHandler]:
        return {
            "alarms.list": self._list_alarms,
            "alarms.history": self._alarm_history,
            "alarm.acknowledge": self._acknowledge,
            "alarm.shelve": self._shelve,
            "alarm.unshelve": self._unshelve,
            "cases.list": self._list_incidents,
            "cases.get": self._get_incident,
        }

    async def _list_alarms(self, params: ask.NoParams, actor: Actor) -> Json:
        return self.plant.parts.alarms.as_json()

    async def _alarm_history(self, params: ask.TimeRangeParams, actor: Actor) -> Json:
        return self._log.history(params.from_ms, params.to_ms, params.drive, params.cursor, params.limit)

    async def _acknowledge(self, params: ask.AlarmParams, actor: Actor) -> Json:
        alarms = self.plant.parts.alarms
        self.plant.publish_alarms(alarms.acknowledge(params.alarm, actor.name, self.plant.wall_ms()))
        return {"alarm": params.alarm}

    async def _shelve(self, params: ask.ShelveParams, actor: Actor) -> Json:
        plant = self.plant
        changes = plant.parts.alarms.shelve(params.alarm, params.minutes, plant.now(), plant.wall_ms())
        plant.publish_alarms(changes)
        return {"alarm": params.alarm, "shelved_until_ms": changes[0].alarm.shelved_until_ms}

    async def _unshelve(self, params: ask.AlarmParams, actor: Actor) -> Json:
        self.plant.publish_alarms(self.plant.parts.alarms.unshelve(params.alarm))
        return {"alarm": params.alarm}

    async def _list_incidents(self, params: ask.TimeRangeParams, actor: Actor) -> Json:
        span = (params.from_ms, params.to_ms, params.drive, params.cursor, params.limit)
        return await asyncio.to_thread(self._store.query, *span)

    async def _get_incident(self, params: ask.IncidentParams, actor: Actor) -> Json:
        return await asyncio.to_thread(self._store.get, params.case)
