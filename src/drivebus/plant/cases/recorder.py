"""The flight recorder: listens to everything, and freezes the last minute of a drive when it trips."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import version

from drivebus.bus.trace import Kind, TraceEvent
from drivebus.capture import Header
from drivebus.line import LineSettings
from drivebus.plant.alarms import Alarm, Own
from drivebus.plant.cases.ring import BEFORE_S, Ring
from drivebus.plant.cases.store import CaseStore
from drivebus.plant.model import AlarmKind
from drivebus.plant.view import DriveView, Json, Sample

FRAMES = 200
AGAIN_S = 10.0
"""A drive that trips again sooner has one case: relays that chatter fill no disk."""
TRIPS = frozenset({str(AlarmKind.FAULT), str(Own.INTERLOCK), str(Own.STOP_UNCONFIRMED)})
"""Alarms that freeze a case when they are raised."""
LOG = logging.getLogger("drivebus.plant")


@dataclass(frozen=True, slots=True)
class LineSeen:
    """The drive's bus at that moment. ``frames``: its newest, each as JSON and as it was on the wire."""

    bus: str
    link: str
    settings: LineSettings
    frames: Sequence[tuple[Json, TraceEvent]]


class FlightRecorder:
    """``read`` fetches the parameters that matter from a drive; it may fail, and the case stands without them."""

    def __init__(self, store: CaseStore, read: Callable[[str], Awaitable[Mapping[str, Json]]] | None = None) -> None:
        self._store, self._read = store, read
        self._rings: dict[str, Ring] = {}
        self._last: dict[str, tuple[float, asyncio.Task[str | None]]] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self.error: OSError | None = None
        """Why the last case could not be kept."""

    # --- what it hears ---------------------------------------------------------------------------------------------

    def samples(self, drive: str, samples: Sequence[Sample], now: float) -> None:
        """Every new reading of a drive."""
        if samples:
            self._ring(drive).samples(samples, now)

    def look(self, view: DriveView, now: float) -> None:
        """Every look at a drive."""
        self._ring(view.id).look(view, now)

    def event(self, event: Json) -> None:
        """Every event; those of no drive are nobody's."""
        if event["drive"] is not None:
            self._ring(event["drive"]).event(event)

    def forget(self, drive: str) -> None:
        """It is no longer part of the plant."""
        self._rings.pop(drive, None)
        self._last.pop(drive, None)

    def _ring(self, drive: str) -> Ring:
        return self._rings.setdefault(drive, Ring())

    # --- what it keeps ---------------------------------------------------------------------------------------------

    def freeze(
        self, alarm: Alarm, view: DriveView | None, line: LineSeen | None, now: float, now_ms: int
    ) -> asyncio.Task[str | None]:
        """Take what is known now; the task ends with the case's id when it is kept, or with None.

        Never fails, and only copies: the bus waits neither for a disk (G14) nor for a minute to be written out (G06).
        """
        last = self._last.get(alarm.drive)
        if last is not None and now - last[0] < AGAIN_S:
            return last[1]
        ring = self._ring(alarm.drive).copy()
        write = partial(self._write, alarm, view, line, ring, now, now_ms)
        task = asyncio.get_running_loop().create_task(self._keep(write, alarm.drive), name=f"case of {alarm.drive}")
        self._last[alarm.drive] = (now, task)
        return task

    def _write(
        self, alarm: Alarm, view: DriveView | None, line: LineSeen | None, ring: Ring, now: float, now_ms: int
    ) -> str:
        """In a thread."""
        raised = alarm.as_json()
        summary = {
            "time_ms": now_ms, "drive": alarm.drive, "bus": line.bus if line else None, "why": alarm.kind,
            "alarm": alarm.id, "title": raised["title"], "text": raised["text"],
        }  # fmt: skip
        frames = [told | {"t": round(event.time - now, 6)} for told, event in (line.frames if line else ())]
        whole = {
            "before_s": BEFORE_S, "raised": raised, "view": view.as_json() if view else None, **ring.frozen(now),
            "frames": frames,
        }  # fmt: skip
        return self._store.write(alarm.drive, summary, whole, _header(line, now, now_ms), _wire(line))

    async def _keep(self, write: Callable[[], str], drive: str) -> str | None:
        try:
            id = await asyncio.get_running_loop().run_in_executor(None, write)
        except OSError as error:
            self.error = error
            LOG.error("a case of %s could not be kept: %s", drive, error)
            return None
        self.error = None
        if self._read is not None and drive:
            task = asyncio.get_running_loop().create_task(self._add(id, drive), name=f"parameters of {drive}")
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
        return id

    async def _add(self, id: str, drive: str) -> None:
        assert self._read is not None
        try:
            found = await self._read(drive)
            await asyncio.get_running_loop().run_in_executor(None, partial(self._store.add, id, found))
        except Exception as error:  # a drive that can't be asked now, a disk that is full: the case stands without them
            LOG.warning("the parameters of %s could not be kept: %s", drive, error)

    async def close(self) -> None:
        """Keep what is being kept; read no more."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, *(task for _, task in self._last.values()), return_exceptions=True)


def _wire(line: LineSeen | None) -> list[tuple[float, bool, bytes]]:
    return [(event.time, event.kind is Kind.SENT, event.data) for _, event in (line.frames if line else ())]


def _header(line: LineSeen | None, now: float, now_ms: int) -> Header:
    """``started`` is the label of the first frame: a capture begins with it."""
    first = min((event.time for _, event in (line.frames if line else ())), default=now)
    started = datetime.fromtimestamp(now_ms / 1000 - (now - first), UTC).isoformat(timespec="milliseconds")
    settings = line.settings if line else LineSettings()
    return Header(settings, line.link if line else "", started, f"drivebus {version('drivebus')}")
