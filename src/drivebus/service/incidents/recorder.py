"""Incident recorder: keeps the last minute of every drive in memory and saves it when the drive trips."""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import version

from drivebus import i18n
from drivebus.bus.trace import TraceEvent, TraceKind
from drivebus.capture.dbcap import CaptureHeader
from drivebus.errors import DrivebusError, SystemReason
from drivebus.profiles.model import DriveProfile
from drivebus.serial_settings import SerialSettings
from drivebus.service.alarms import Alarm, SystemAlarm
from drivebus.service.config.model import AlarmKind
from drivebus.service.historian.points import CODE_BY_QUALITY
from drivebus.service.incidents.store import IncidentStore
from drivebus.service.live.views import DriveView, Sample
from drivebus.types import Json
from drivebus.values import Quality


def incident_parameters(profile: DriveProfile) -> tuple[str, ...]:
    """Return the readable parameters to save with an incident.

    These are the ramps, the preconditions for bus control, and those of the communication loss.
    """
    rule = profile.comm_loss
    preconditions = [precondition.notation for precondition in profile.preconditions if precondition.unreadable is None]
    names = [*(profile.ramp_notations or ()), *preconditions, rule.time_notation, rule.action_notation]
    return tuple(dict.fromkeys(name for name in names if name is not None))


RECORDED_BEFORE_S = 60.0
MAX_BUFFERED_SAMPLES = 20_000
"""333 a second for a minute, more than one drive delivers at 115,200 baud; about 3 MB."""
MAX_BUFFERED_STATES = 1_000
MAX_BUFFERED_EVENTS = 50
BufferedSample = tuple[float, str, float | None, Quality]


@dataclass(slots=True)
class RingBuffer:
    """Last minute of one drive: samples at full rate, states, events.

    Times are monotonic seconds, because the wall clock may jump.
    """

    _samples: deque[BufferedSample] = field(default_factory=lambda: deque(maxlen=MAX_BUFFERED_SAMPLES))
    _states: deque[tuple[float, Json]] = field(default_factory=lambda: deque(maxlen=MAX_BUFFERED_STATES))
    _events: deque[Json] = field(default_factory=lambda: deque(maxlen=MAX_BUFFERED_EVENTS))

    def add_samples(self, samples: Sequence[Sample], now: float) -> None:
        """Add new samples, and drop those older than a minute."""
        for sample in samples:
            self._samples.append((now, sample.tag.partition(".")[2], sample.value, sample.quality))
        while self._samples[0][0] < now - RECORDED_BEFORE_S:
            self._samples.popleft()

    def add_view(self, view: DriveView, now: float) -> None:
        """Add the drive's state if it differs from the last one."""
        state = {
            "state": view.state,
            "direction": view.direction,
            "presence": view.presence,
            "fault": view.fault,
            "commanded_hz": view.commanded_hz,
        }
        if not self._states or self._states[-1][1] != state:
            self._states.append((now, state))

    def add_event(self, event: Json) -> None:
        """Add an event of this drive: command, control lease, alarm."""
        self._events.append(event)

    def copy(self) -> RingBuffer:
        """Return a copy for another thread."""
        return RingBuffer(self._samples.copy(), self._states.copy(), self._events.copy())

    def as_json(self, now: float) -> Json:
        """Return the content, with times as (negative) seconds relative to ``now``."""
        signals: dict[str, Json] = {}
        for at, name, value, quality in self._samples:
            if at >= now - RECORDED_BEFORE_S:
                series = signals.setdefault(name, {"t": [], "v": [], "q": []})
                series["t"].append(round(at - now, 3))
                series["v"].append(value)
                series["q"].append(CODE_BY_QUALITY[quality])
        return {"signals": signals, "states": self._states_json(now), "events": list(self._events)}

    def _states_json(self, now: float) -> list[Json]:
        """Return the states of the last minute and the one that it began with."""
        states = [{"t": round(at - now, 3), **state} for at, state in self._states]
        older = sum(state["t"] < -RECORDED_BEFORE_S for state in states)
        return states[max(0, older - 1) :]


INCIDENT_FRAMES = 200
"""Newest frames of the bus saved with an incident."""
INCIDENT_REPEAT_S = 10.0
"""A trip of the same drive within this time belongs to the same incident, so that a chattering relay fills no disk."""
SAVE_RETRY_INTERVAL_S = 10.0
"""Between two attempts to save an incident while the disk fails."""
MAX_WAITING_INCIDENTS = 10
"""Incidents that wait in memory for the disk, each with the last minute of a drive; further ones are lost."""
TRIP_ALARM_KINDS = frozenset({str(AlarmKind.FAULT), str(SystemAlarm.INTERLOCK_TRIP), str(SystemAlarm.STOP_UNCONFIRMED)})
"""Alarms that record an incident when they are raised."""
LOG = logging.getLogger("drivebus.service")


@dataclass(frozen=True, slots=True)
class BusSnapshot:
    """State of a bus at the moment of a trip. ``frames``: its newest frames, as JSON and as traced."""

    bus: str
    port: str
    settings: SerialSettings
    frames: Sequence[tuple[Json, TraceEvent]]


class IncidentRecorder:
    """Recorder of incidents.

    ``read_parameters`` reads a drive's parameters afterwards; an incident is complete without them if that fails.
    """

    def __init__(
        self, store: IncidentStore, read_parameters: Callable[[str], Awaitable[Mapping[str, Json]]] | None = None
    ) -> None:
        self._store, self._read_parameters = store, read_parameters
        self._buffers: dict[str, RingBuffer] = {}
        self._last_incident: dict[str, tuple[float, asyncio.Task[str | None]]] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._waiting = 0
        self._closing = asyncio.Event()
        self.error: Exception | None = None
        """Error of recording the last incident; None if it was saved."""

    # --- recording -------------------------------------------------------------------------------------------------

    def record_samples(self, drive: str, samples: Sequence[Sample], now: float) -> None:
        """Record new samples of a drive."""
        if samples:
            self._buffer(drive).add_samples(samples, now)

    def record_view(self, view: DriveView, now: float) -> None:
        """Record the state of a drive."""
        self._buffer(view.id).add_view(view, now)

    def record_event(self, event: Json) -> None:
        """Record an event that concerns a drive."""
        if event["drive"] is not None:
            self._buffer(event["drive"]).add_event(event)

    def remove_drive(self, drive: str) -> None:
        """Drop the buffer of a drive: a later one of its name has a minute and incidents of its own."""
        self._buffers.pop(drive, None)
        self._last_incident.pop(drive, None)

    def _buffer(self, drive: str) -> RingBuffer:
        return self._buffers.setdefault(drive, RingBuffer())

    # --- saving ----------------------------------------------------------------------------------------------------

    def capture(
        self, alarm: Alarm, view: DriveView | None, bus: BusSnapshot | None, now: float, now_ms: int
    ) -> asyncio.Task[str | None]:
        """Capture an incident now; the task returns its id once it is saved, None if it is lost.

        Never raises and only copies, so that no bus waits for the disk or for the encoding.
        """
        last = self._last_incident.get(alarm.drive)
        if last is not None and now - last[0] < INCIDENT_REPEAT_S:
            return last[1]
        buffer = self._buffer(alarm.drive).copy()
        write = partial(self._write, alarm, view, bus, buffer, now, now_ms)
        name = f"incident of {alarm.drive}"
        task = asyncio.get_running_loop().create_task(self._save(write, alarm.drive), name=name)
        self._last_incident[alarm.drive] = (now, task)
        return task

    def _write(
        self, alarm: Alarm, view: DriveView | None, bus: BusSnapshot | None, buffer: RingBuffer, now: float, now_ms: int
    ) -> str:
        """Write the incident and return its id. Runs on a thread."""
        raised = alarm.as_json()
        summary = {
            "time_ms": now_ms,
            "drive": alarm.drive,
            "bus": bus.bus if bus else None,
            "why": alarm.kind,
            "alarm": alarm.id,
            "title": raised["title"],
            "text": raised["text"],
        }
        frames = [frame | {"t": round(event.time - now, 6)} for frame, event in (bus.frames if bus else ())]
        whole = {
            "before_s": RECORDED_BEFORE_S,
            "raised": raised,
            "view": view.as_json() if view else None,
            **buffer.as_json(now),
            "frames": frames,
        }
        return self._store.write(alarm.drive, summary, whole, _capture_header(bus, now, now_ms), _wire_frames(bus))

    async def _save(self, write: Callable[[], str], drive: str) -> str | None:
        try:
            id = await self._write_or_wait(write, drive)
        except Exception as error:
            self.report_failure(drive, error)
            return None
        self.error = None
        if self._read_parameters is not None and drive:
            task = asyncio.get_running_loop().create_task(
                self._add_parameters(id, drive), name=f"parameters of {drive}"
            )
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
        return id

    async def _write_or_wait(self, write: Callable[[], str], drive: str) -> str:
        """Write an incident and return its id; while the disk fails, try again. Raises what makes it lost."""
        loop = asyncio.get_running_loop()
        try:
            return await loop.run_in_executor(None, write)
        except OSError as error:
            if self._waiting >= MAX_WAITING_INCIDENTS:
                raise
            self.report_failure(drive, error)
        self._waiting += 1
        try:
            while True:
                with suppress(TimeoutError):
                    await asyncio.wait_for(self._closing.wait(), SAVE_RETRY_INTERVAL_S)
                try:
                    return await loop.run_in_executor(None, write)
                except OSError as error:
                    self.error = error
                    if self._closing.is_set():
                        raise
        finally:
            self._waiting -= 1

    def report_failure(self, drive: str, error: Exception) -> None:
        """Keep and log the error of an incident that could not be recorded."""
        self.error = error
        reason = SystemReason(error)
        LOG.error(i18n.preferred_text("log.incident_not_saved", drive=drive, reason=reason))

    async def _add_parameters(self, id: str, drive: str) -> None:
        assert self._read_parameters is not None
        try:
            parameters = await self._read_parameters(drive)
            await asyncio.get_running_loop().run_in_executor(None, partial(self._store.add_parameters, id, parameters))
        except Exception as error:  # the drive does not answer or the disk is full: the incident is complete without
            reason = error if isinstance(error, DrivebusError) else SystemReason(error)
            LOG.warning(i18n.preferred_text("log.parameters_not_saved", drive=drive, reason=reason))

    async def close(self) -> None:
        """Finish saving incidents; cancel reading of parameters, also of those that are saved from now on.

        Those that wait for the disk are tried once more.
        """
        self._closing.set()
        self._read_parameters = None
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, *(task for _, task in self._last_incident.values()), return_exceptions=True)


def _wire_frames(bus: BusSnapshot | None) -> list[tuple[float, bool, bytes]]:
    return [(event.time, event.kind is TraceKind.SENT, event.data) for _, event in (bus.frames if bus else ())]


def _capture_header(bus: BusSnapshot | None, now: float, now_ms: int) -> CaptureHeader:
    """Return the header of the capture, which starts with the first frame."""
    first = min((event.time for _, event in (bus.frames if bus else ())), default=now)
    started = datetime.fromtimestamp(now_ms / 1000 - (now - first), UTC).isoformat(timespec="milliseconds")
    settings = bus.settings if bus else SerialSettings()
    return CaptureHeader(settings, bus.port if bus else "", started, f"drivebus {version('drivebus')}")
