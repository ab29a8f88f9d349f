"""The flight recorder: listens to everything, and freezes the last minute of a drive when it trips."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import version

from drivebus.bus.trace import TraceEvent, TraceKind
from drivebus.capture.dbcap import CaptureHeader
from drivebus.serial_settings import SerialSettings
from drivebus.service.alarms import Alarm, SystemAlarm
from drivebus.service.config.model import AlarmKind
from drivebus.service.incidents.ring_buffer import RECORDED_BEFORE_S, RingBuffer
from drivebus.service.incidents.store import IncidentStore
from drivebus.service.live.views import DriveView, Json, Sample

INCIDENT_FRAMES = 200
INCIDENT_REPEAT_S = 10.0
"""A drive that trips again sooner has one case: relays that chatter fill no disk."""
TRIP_ALARM_KINDS = frozenset({str(AlarmKind.FAULT), str(SystemAlarm.INTERLOCK_TRIP), str(SystemAlarm.STOP_UNCONFIRMED)})
"""Alarms that freeze a case when they are raised."""
LOG = logging.getLogger("drivebus.service")


@dataclass(frozen=True, slots=True)
class BusSnapshot:
    """The drive's bus at that moment. ``frames``: its newest, each as JSON and as it was on the wire."""

    bus: str
    link: str
    settings: SerialSettings
    frames: Sequence[tuple[Json, TraceEvent]]


class IncidentRecorder:
    """``read`` fetches the parameters that matter from a drive; it may fail, and the case stands without them."""

    def __init__(
        self, store: IncidentStore, read_parameters: Callable[[str], Awaitable[Mapping[str, Json]]] | None = None
    ) -> None:
        self._store, self._read_parameters = store, read_parameters
        self._buffers: dict[str, RingBuffer] = {}
        self._last_incident: dict[str, tuple[float, asyncio.Task[str | None]]] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self.error: OSError | None = None
        """Why the last case could not be kept."""

    # --- what it hears ---------------------------------------------------------------------------------------------

    def record_samples(self, drive: str, samples: Sequence[Sample], now: float) -> None:
        """Every new reading of a drive."""
        if samples:
            self._buffer(drive).add_samples(samples, now)

    def record_view(self, view: DriveView, now: float) -> None:
        """Every look at a drive."""
        self._buffer(view.id).add_view(view, now)

    def record_event(self, event: Json) -> None:
        """Every event; those of no drive are nobody's."""
        if event["drive"] is not None:
            self._buffer(event["drive"]).add_event(event)

    def remove_drive(self, drive: str) -> None:
        """It is no longer part of the plant."""
        self._buffers.pop(drive, None)
        self._last_incident.pop(drive, None)

    def _buffer(self, drive: str) -> RingBuffer:
        return self._buffers.setdefault(drive, RingBuffer())

    # --- what it keeps ---------------------------------------------------------------------------------------------

    def capture(
        self, alarm: Alarm, view: DriveView | None, line: BusSnapshot | None, now: float, now_ms: int
    ) -> asyncio.Task[str | None]:
        """Take what is known now; the task ends with the case's id when it is kept, or with None.

        Never fails, and only copies: the bus waits neither for a disk (G14) nor for a minute to be written out (G06).
        """
        last = self._last_incident.get(alarm.drive)
        if last is not None and now - last[0] < INCIDENT_REPEAT_S:
            return last[1]
        ring = self._buffer(alarm.drive).copy()
        write = partial(self._write, alarm, view, line, ring, now, now_ms)
        task = asyncio.get_running_loop().create_task(self._save(write, alarm.drive), name=f"case of {alarm.drive}")
        self._last_incident[alarm.drive] = (now, task)
        return task

    def _write(
        self, alarm: Alarm, view: DriveView | None, line: BusSnapshot | None, ring: RingBuffer, now: float, now_ms: int
    ) -> str:
        """In a thread."""
        raised = alarm.as_json()
        summary = {
            "time_ms": now_ms,
            "drive": alarm.drive,
            "bus": line.bus if line else None,
            "why": alarm.kind,
            "alarm": alarm.id,
            "title": raised["title"],
            "text": raised["text"],
        }
        frames = [told | {"t": round(event.time - now, 6)} for told, event in (line.frames if line else ())]
        whole = {
            "before_s": RECORDED_BEFORE_S,
            "raised": raised,
            "view": view.as_json() if view else None,
            **ring.as_json(now),
            "frames": frames,
        }
        return self._store.write(alarm.drive, summary, whole, _capture_header(line, now, now_ms), _wire_frames(line))

    async def _save(self, write: Callable[[], str], drive: str) -> str | None:
        try:
            id = await asyncio.get_running_loop().run_in_executor(None, write)
        except OSError as error:
            self.error = error
            LOG.error("a case of %s could not be kept: %s", drive, error)
            return None
        self.error = None
        if self._read_parameters is not None and drive:
            task = asyncio.get_running_loop().create_task(
                self._add_parameters(id, drive), name=f"parameters of {drive}"
            )
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
        return id

    async def _add_parameters(self, id: str, drive: str) -> None:
        assert self._read_parameters is not None
        try:
            found = await self._read_parameters(drive)
            await asyncio.get_running_loop().run_in_executor(None, partial(self._store.add_parameters, id, found))
        except Exception as error:  # a drive that can't be asked now, a disk that is full: the case stands without them
            LOG.warning("the parameters of %s could not be kept: %s", drive, error)

    async def close(self) -> None:
        """Keep what is being kept; read no more."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, *(task for _, task in self._last_incident.values()), return_exceptions=True)


def _wire_frames(line: BusSnapshot | None) -> list[tuple[float, bool, bytes]]:
    return [(event.time, event.kind is TraceKind.SENT, event.data) for _, event in (line.frames if line else ())]


def _capture_header(line: BusSnapshot | None, now: float, now_ms: int) -> CaptureHeader:
    """``started`` is the label of the first frame: a capture begins with it."""
    first = min((event.time for _, event in (line.frames if line else ())), default=now)
    started = datetime.fromtimestamp(now_ms / 1000 - (now - first), UTC).isoformat(timespec="milliseconds")
    settings = line.settings if line else SerialSettings()
    return CaptureHeader(settings, line.link if line else "", started, f"drivebus {version('drivebus')}")
