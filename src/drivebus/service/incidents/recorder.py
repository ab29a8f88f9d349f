"""Which parameters of a drive matter when it has tripped. Pure.

The last minute of one drive: its samples at full rate, its states, its last events. Pure, time is an argument.

The flight recorder: listens to everything, and freezes the last minute of a drive when it trips.
"""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import version

from drivebus.bus.trace import TraceEvent, TraceKind
from drivebus.capture.dbcap import CaptureHeader
from drivebus.profiles.model import DriveProfile
from drivebus.serial_settings import SerialSettings
from drivebus.service.alarms import Alarm, SystemAlarm
from drivebus.service.config.model import AlarmKind
from drivebus.service.incidents.store import IncidentStore
from drivebus.service.live.views import DriveView, Json, Sample
from drivebus.values import Quality


def incident_parameters(profile: DriveProfile) -> tuple[str, ...]:
    """Ramps, what makes it obey the bus, what it does when the host falls silent: what of it can be read."""
    rule = profile.comm_loss
    asked = [one.notation for one in profile.preconditions if one.unreadable is None]
    names = [*(profile.ramp_notations or ()), *asked, rule.time_notation, rule.action_notation]
    return tuple(dict.fromkeys(name for name in names if name is not None))


RECORDED_BEFORE_S = 60.0
MAX_BUFFERED_SAMPLES = 20_000
"""330 a second for a minute, more than a line at 115,200 baud brings of one drive; about 3 MB (I12)."""
MAX_BUFFERED_STATES = 1_000
MAX_BUFFERED_EVENTS = 50
QUALITY_CODES = {Quality.GOOD: 0, Quality.UNCERTAIN: 1, Quality.BAD: 2}
BufferedSample = tuple[float, str, float | None, Quality]


@dataclass(slots=True)
class RingBuffer:
    """Kept by the monotonic clock; UTC may jump in the middle of a minute (F21)."""

    _samples: deque[BufferedSample] = field(default_factory=lambda: deque(maxlen=MAX_BUFFERED_SAMPLES))
    _states: deque[tuple[float, Json]] = field(default_factory=lambda: deque(maxlen=MAX_BUFFERED_STATES))
    _events: deque[Json] = field(default_factory=lambda: deque(maxlen=MAX_BUFFERED_EVENTS))

    def add_samples(self, samples: Sequence[Sample], now: float) -> None:
        """New readings, as they come."""
        for sample in samples:
            self._samples.append((now, sample.tag.partition(".")[2], sample.value, sample.quality))
        while self._samples[0][0] < now - RECORDED_BEFORE_S:
            self._samples.popleft()

    def add_view(self, view: DriveView, now: float) -> None:
        """Kept only where it is another than before."""
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
        """A command, a lease, an alarm of this drive."""
        self._events.append(event)

    def copy(self) -> RingBuffer:
        """As it is now, for another thread; takes no time worth counting."""
        return RingBuffer(self._samples.copy(), self._states.copy(), self._events.copy())

    def as_json(self, now: float) -> Json:
        """Everything, with times in seconds before ``now`` (negative)."""
        signals: dict[str, Json] = {}
        for at, name, value, quality in self._samples:
            if at >= now - RECORDED_BEFORE_S:
                series = signals.setdefault(name, {"t": [], "v": [], "q": []})
                series["t"].append(round(at - now, 3))
                series["v"].append(value)
                series["q"].append(QUALITY_CODES[quality])
        return {"signals": signals, "states": self._states_json(now), "events": list(self._events)}

    def _states_json(self, now: float) -> list[Json]:
        """The minute's, and the one with which it began."""
        states = [{"t": round(at - now, 3), **state} for at, state in self._states]
        older = sum(state["t"] < -RECORDED_BEFORE_S for state in states)
        return states[max(0, older - 1) :]


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
