"""The last minute of one drive: its samples at full rate, its states, its last events. Pure, time is an argument."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

from drivebus.service.live.views import DriveView, Json, Sample
from drivebus.values import Quality

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
