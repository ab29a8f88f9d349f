"""The demo's host: real buses and drives over the virtual plant, the story that plays on them, and the user's hand."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from drivebus.bus import Bus
from drivebus.cli import output
from drivebus.cli.demo.layout import LINES, DemoBus, DemoDrive
from drivebus.cli.demo.plant import DemoPlant
from drivebus.cli.demo.script import END_S, STORY, ScriptStep
from drivebus.cli.tui.bus_rows import PolledBus, PolledDrive
from drivebus.cli.tui.rows import BusRow, DriveRow
from drivebus.drives import Drive, StopReport, stop_bus
from drivebus.drives.store import MemoryStore
from drivebus.errors import DrivebusError

if TYPE_CHECKING:
    from drivebus.drives.state import Outcome

FIRST_HZ = 25.0
"""What "run" means for a drive that had no frequency yet."""
LOWEST_HZ, HIGHEST_HZ = 5.0, 50.0
NEWS = 200


@dataclass(slots=True)
class Actor:
    """One drive of the plant with its host side."""

    part: DemoDrive
    line: int
    drive: Drive
    watched: PolledDrive
    frequency_hz: float = FIRST_HZ
    commanded_hz: float | None = None
    """What a command that was done told the drive."""


class Stage:
    """A ``live.feed.Feed`` and a ``live.feed.Control``."""

    def __init__(self, plant: DemoPlant) -> None:
        self.title = output.text(
            f"demo.title.{plant.kind}", drives=sum(len(one.drives) for one in LINES), lines=len(LINES)
        )
        self._plant = plant
        self._store = MemoryStore()
        self._buses: list[Bus] = []
        self._lines: list[PolledBus] = []
        self._actors: dict[str, Actor] = {}
        self._news: list[str] = []
        self._tasks: set[asyncio.Task[None]] = set()
        self._begun = 0.0
        self._taken_over = False
        self._over = False

    # --- life ---------------------------------------------------------------------------------------------------

    async def start(self) -> None:
        """Start the plant, open the lines, begin to watch and to play."""
        from drivebus import ports

        await self._plant.start()
        for index, (line, link) in enumerate(zip(LINES, self._plant.links, strict=True)):
            bus = Bus(ports.open_port(link), name=line.name)
            await bus.open()
            self._buses.append(bus)
            self._lines.append(PolledBus(bus, f"{line.name} {line.model}"))
            self._hire(bus, index, line)
        self._begun = self.now()
        self._spawn(self._play())

    def _hire(self, bus: Bus, index: int, line: DemoBus) -> None:
        for part in line.drives:
            drive = Drive(bus, line.model, part.address, settings=dict(line.settings), store=self._store)
            watched = PolledDrive(drive, part.key, name_of(part), line.name)
            self._actors[part.key] = Actor(part, index, drive, watched)

    async def close(self) -> None:
        """Let everything go; the plant ends with us."""
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        for actor in self._actors.values():
            actor.drive.close()
        for bus in self._buses:
            await bus.close()
        await self._plant.close()

    # --- what the view reads --------------------------------------------------------------------------------------

    def now(self) -> float:
        return self._buses[0].now() if self._buses else 0.0

    def drives(self) -> list[DriveRow]:
        return [replace(actor.watched.row(), commanded_hz=actor.commanded_hz) for actor in self._actors.values()]

    def lines(self) -> list[BusRow]:
        return [line.row() for line in self._lines]

    def news(self) -> list[str]:
        return self._news

    @property
    def over(self) -> bool:
        return self._over

    def tell(self, key: str, /, **params: Any) -> None:
        """One more piece of news, with the time of the story."""
        at = self.now() - self._begun
        self._news.append(f"{int(at) // 60}:{int(at) % 60:02d}  {output.text(key, **params)}")
        del self._news[:-NEWS]

    # --- the story --------------------------------------------------------------------------------------------------

    async def _play(self) -> None:
        for scene in STORY:
            await asyncio.sleep(max(0.0, self._begun + scene.at_s - self.now()))
            if self._taken_over:
                return
            self._perform(scene)
        await asyncio.sleep(max(0.0, self._begun + END_S - self.now()))
        if not self._taken_over:
            self.tell("demo.end")
            self._over = True

    def _perform(self, scene: ScriptStep) -> None:
        actor = self._actors.get(scene.who)
        if scene.action == "say":
            self.tell(f"demo.{scene.who}")
        elif scene.action == "stop_all":
            self._stop_all()
        elif scene.action in ("unplug", "plug"):
            self.tell(f"demo.{scene.action}", line=scene.who)
            self._plant.do({"do": scene.action, "line": [line.name for line in LINES].index(scene.who)})
        elif actor is not None and scene.action == "trip":
            self.tell("demo.trip", name=actor.watched.name)
            self._plant.do({"do": "trip", "line": actor.line, "address": actor.part.address})
        elif actor is not None:
            self._command(actor, scene.action, scene.frequency_hz)

    # --- the user's hand ----------------------------------------------------------------------------------------

    def run(self, key: str) -> None:
        self._take_over()
        self._command(self._actors[key], "run", self._actors[key].frequency_hz)

    def stop(self, key: str) -> None:
        self._take_over()
        self._command(self._actors[key], "stop")

    def change(self, key: str, by_hz: float) -> None:
        self._take_over()
        actor = self._actors[key]
        self._command(actor, "set", min(HIGHEST_HZ, max(LOWEST_HZ, actor.frequency_hz + by_hz)))

    def reset(self, key: str) -> None:
        self._take_over()
        self._command(self._actors[key], "reset")

    def stop_all(self) -> None:
        self._take_over()
        self._stop_all()

    def _take_over(self) -> None:
        if not self._taken_over and not self._over:
            self.tell("demo.taken_over")
        self._taken_over = True

    # --- commands -------------------------------------------------------------------------------------------------

    def _command(self, actor: Actor, action: str, frequency_hz: float = 0.0) -> None:
        drive = actor.drive
        if frequency_hz:
            actor.frequency_hz = frequency_hz
        work: dict[str, Callable[[], Awaitable[Outcome]]] = {
            "run": lambda: drive.run(frequency_hz),
            "set": lambda: drive.set_frequency(frequency_hz),
            "stop": lambda: drive.stop(),
            "reset": lambda: self._reset(actor),
        }
        self.tell(f"demo.{action}", name=actor.watched.name, hz=f"{frequency_hz:g}")
        self._spawn(self._report(actor, work[action], frequency_hz))

    async def _reset(self, actor: Actor) -> Outcome:
        """A reset also gives back what a bus stop latched (nothing starts by itself)."""
        bus = self._buses[actor.line]
        if bus.start_inhibited(actor.part.address):
            bus.release_start([actor.part.address])
            self.tell("demo.given_back", name=actor.watched.name)
        return await actor.drive.reset_fault()

    async def _report(self, actor: Actor, work: Callable[[], Awaitable[Outcome]], frequency_hz: float) -> None:
        """Say how a command ended."""
        name = actor.watched.name
        try:
            outcome = await work()
        except DrivebusError as error:
            if error.key in ("drives.latched", "bus.start_inhibited"):
                self.tell("demo.latched", name=name)
            else:
                self.tell("demo.failed", name=name, text=error.text(output.language()))
        else:
            actor.commanded_hz = frequency_hz or actor.commanded_hz
            self.tell("demo.outcome", name=name, text=outcome.text(output.language()))

    def _stop_all(self) -> None:
        self.tell("demo.stop_all")
        for index, bus in enumerate(self._buses):
            drives = [actor.drive for actor in self._actors.values() if actor.line == index]
            self._spawn(self._stop_line(bus, drives))

    async def _stop_line(self, bus: Bus, drives: list[Drive]) -> None:
        report = await stop_bus(bus, drives)
        self.tell("demo.stopped_line", line=bus.name, text=report_text(report))

    def _spawn(self, work: Any) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)


def name_of(part: DemoDrive) -> str:
    """``fan 1``."""
    return output.text(f"demo.role.{part.role}", number=part.number)


def report_text(report: StopReport) -> str:
    """Format the drives by the status of their stop."""
    drives: dict[str, list[str]] = {"confirmed": [], "acknowledged": [], "unknown": []}
    for address, outcome in report.outcomes:
        drives[str(outcome.status) if outcome.succeeded else "unknown"].append(str(address))
    parts = [output.text(f"bus_stop.{status}", addresses=", ".join(names)) for status, names in drives.items() if names]
    return output.join_sentences(parts)
