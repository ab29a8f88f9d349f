"""Alarms and cases as people ask for them, and the flight recorder among the plant's rooms: it hears what they hear,
and freezes a case when a trip is raised.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence

from drivebus.plant import operations as ask
from drivebus.plant.actor import Actor
from drivebus.plant.alarms import Alarm, Own
from drivebus.plant.alarms.log import AlarmLog, number
from drivebus.plant.cases import CaseStore, FlightRecorder
from drivebus.plant.cases.parameters import that_matter
from drivebus.plant.cases.recorder import FRAMES, TRIPS, LineSeen
from drivebus.plant.failure import why
from drivebus.plant.frames import frame_json
from drivebus.plant.parameters import readings_json
from drivebus.plant.parts import Handler
from drivebus.plant.state import Plant
from drivebus.plant.turns import by_and_by
from drivebus.plant.view import DriveView, Json, Sample

LOOK_S = 5.0
"""How often stores that are written in the background are looked at."""


class Keeping:
    """``bind`` it to the plant before that starts. It is the alarm book's log: what is raised passes through it."""

    def __init__(self, log: AlarmLog, store: CaseStore, now: Callable[[], float]) -> None:
        self._log, self._store, self._now = log, store, now
        self.recorder = FlightRecorder(store, self._parameters)
        self._views: dict[str, DriveView] = {}
        self._plant: Plant | None = None
        self._tasks: set[asyncio.Task[None]] = set()
        self._newest = 0
        """Number of the newest alarm: whatever happens to an older one is no trip."""
        self.stores: dict[str, Callable[[], Exception | None]] = {
            "alarms.jsonl": lambda: log.error, "cases": lambda: self.recorder.error,
        }  # fmt: skip
        """What is written in the background → why that fails now."""
        self._looking: asyncio.Task[None] | None = None

    def bind(self, plant: Plant) -> None:
        """This is the plant."""
        self._plant, self._newest = plant, self._log.first - 1
        self._looking = asyncio.get_running_loop().create_task(self._look_after(plant), name="look after stores")

    async def _look_after(self, plant: Plant) -> None:
        """A store that fails in the background is an alarm, and is tried again."""
        while True:
            await asyncio.sleep(LOOK_S)
            for name, error in self.stores.items():
                if (found := error()) is not None:
                    plant.alarm(Own.STORE, about=name, reason=why(found))
                else:
                    plant.calm(Own.STORE, about=name)
            self._log.retry()

    @property
    def plant(self) -> Plant:
        assert self._plant is not None, "bind it first"
        return self._plant

    # --- what it hears ---------------------------------------------------------------------------------------------

    def put(self, alarm: Alarm) -> None:
        """From the alarm book. A new trip is frozen when this look at the drive is over, so that it shows the trip."""
        self._log.put(alarm)
        new, self._newest = number(alarm.id) > self._newest, max(self._newest, number(alarm.id))
        if new and alarm.kind in TRIPS and self._plant is not None:
            asyncio.get_running_loop().call_soon(self._tripped, alarm)

    def view(self, view: DriveView, now: float, now_ms: int) -> None:
        """Every look at a drive."""
        self._views[view.id] = view
        self.recorder.look(view, now)

    def samples(self, samples: Sequence[Sample]) -> None:
        """Every reading, as the history gets it; those of one drive at a time."""
        if samples:
            self.recorder.samples(samples[0].tag.partition(".")[0], samples, self._now())

    def event(self, event: Json) -> None:
        """Every event."""
        self.recorder.event(event)

    def forget(self, drive: str) -> None:
        """It is no longer part of the plant."""
        self._views.pop(drive, None)
        self.recorder.forget(drive)

    # --- a trip ----------------------------------------------------------------------------------------------------

    def _tripped(self, alarm: Alarm) -> None:
        task = asyncio.get_running_loop().create_task(self._freeze(alarm), name=f"case of {alarm.id}")
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _freeze(self, alarm: Alarm) -> None:
        plant, line = self.plant, await self._line(alarm.drive)
        kept = self.recorder.freeze(alarm, self._views.get(alarm.drive), line, plant.now(), plant.wall_ms())
        case = await asyncio.shield(kept)
        if case is not None and any(one.id == alarm.id for one in plant.parts.alarms.active()):
            plant.alarmed(plant.parts.alarms.attach(alarm.id, case))

    async def _line(self, drive: str) -> LineSeen | None:
        """Its newest frames as they are at once, decoded by and by: a trip is when stops are wanted."""
        unit = self.plant.units.get(drive)
        if unit is None:
            return None
        line = self.plant.line_of(unit)
        newest = list(line.frames)[-FRAMES:]
        frames = [(frame_json(line, seen), seen.event) async for seen in by_and_by(newest, own=True)]
        return LineSeen(line.setting.id, line.setting.link, line.bus.port.settings, frames)

    async def _parameters(self, drive: str) -> Mapping[str, Json]:
        """Reads; they wait behind every command."""
        unit = self.plant.unit(drive)
        return readings_json(unit.profile, await unit.drive.read(that_matter(unit.profile)))

    async def close(self) -> None:
        """Keep what is being kept."""
        if self._looking is not None:
            self._looking.cancel()
            await asyncio.wait([self._looking])
        await self.recorder.close()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    # --- operations ------------------------------------------------------------------------------------------------

    def handlers(self) -> dict[str, Handler]:
        return {
            "alarms.list": self._list, "alarms.history": self._history, "alarm.acknowledge": self._acknowledge,
            "alarm.shelve": self._shelve, "alarm.unshelve": self._unshelve, "cases.list": self._cases,
            "cases.get": self._case,
        }  # fmt: skip

    async def _list(self, params: ask.Nothing, actor: Actor) -> Json:
        return self.plant.parts.alarms.topic()

    async def _history(self, params: ask.Span, actor: Actor) -> Json:
        return self._log.history(params.from_ms, params.to_ms, params.drive, params.cursor, params.limit)

    async def _acknowledge(self, params: ask.OfAlarm, actor: Actor) -> Json:
        alarms = self.plant.parts.alarms
        self.plant.alarmed(alarms.acknowledge(params.alarm, actor.name, self.plant.wall_ms()))
        return {"alarm": params.alarm}

    async def _shelve(self, params: ask.Shelve, actor: Actor) -> Json:
        plant = self.plant
        changes = plant.parts.alarms.shelve(params.alarm, params.minutes, plant.now(), plant.wall_ms())
        plant.alarmed(changes)
        return {"alarm": params.alarm, "shelved_until_ms": changes[0].alarm.shelved_until_ms}

    async def _unshelve(self, params: ask.OfAlarm, actor: Actor) -> Json:
        self.plant.alarmed(self.plant.parts.alarms.unshelve(params.alarm))
        return {"alarm": params.alarm}

    async def _cases(self, params: ask.Span, actor: Actor) -> Json:
        span = (params.from_ms, params.to_ms, params.drive, params.cursor, params.limit)
        return await asyncio.to_thread(self._store.list, *span)

    async def _case(self, params: ask.OfCase, actor: Actor) -> Json:
        return await asyncio.to_thread(self._store.get, params.case)
