"""The last minute of one drive: its samples at full rate, its states, its last events. Pure, time is an argument."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

from drivebus.plant.view import DriveView, Json, Sample
from drivebus.reading import Quality

BEFORE_S = 60.0
MOST_SAMPLES = 20_000
"""330 a second for a minute, more than a line at 115,200 baud brings of one drive; about 3 MB (I12)."""
MOST_STATES = 1_000
MOST_EVENTS = 50
QUALITIES = {Quality.GOOD: 0, Quality.UNCERTAIN: 1, Quality.BAD: 2}
Heard = tuple[float, str, float | None, Quality]


@dataclass(slots=True)
class Ring:
    """Kept by the monotonic clock; UTC may jump in the middle of a minute (F21)."""

    _samples: deque[Heard] = field(default_factory=lambda: deque(maxlen=MOST_SAMPLES))
    _states: deque[tuple[float, Json]] = field(default_factory=lambda: deque(maxlen=MOST_STATES))
    _events: deque[Json] = field(default_factory=lambda: deque(maxlen=MOST_EVENTS))

    def samples(self, samples: Sequence[Sample], now: float) -> None:
        """New readings, as they come."""
        for sample in samples:
            self._samples.append((now, sample.tag.partition(".")[2], sample.value, sample.quality))
        while self._samples[0][0] < now - BEFORE_S:
            self._samples.popleft()

    def look(self, view: DriveView, now: float) -> None:
        """Kept only where it is another than before."""
        state = {
            "state": view.state, "direction": view.direction, "presence": view.presence, "fault": view.fault,
            "commanded_hz": view.commanded_hz,
        }  # fmt: skip
        if not self._states or self._states[-1][1] != state:
            self._states.append((now, state))

    def event(self, event: Json) -> None:
        """A command, a lease, an alarm of this drive."""
        self._events.append(event)

    def copy(self) -> Ring:
        """As it is now, for another thread; takes no time worth counting."""
        return Ring(self._samples.copy(), self._states.copy(), self._events.copy())

    def frozen(self, now: float) -> Json:
        """Everything, with times in seconds before ``now`` (negative)."""
        signals: dict[str, Json] = {}
        for at, name, value, quality in self._samples:
            if at >= now - BEFORE_S:
                series = signals.setdefault(name, {"t": [], "v": [], "q": []})
                series["t"].append(round(at - now, 3))
                series["v"].append(value)
                series["q"].append(QUALITIES[quality])
        return {"signals": signals, "states": self._frozen_states(now), "events": list(self._events)}

    def _frozen_states(self, now: float) -> list[Json]:
        """The minute's, and the one with which it began."""
        states = [{"t": round(at - now, 3), **state} for at, state in self._states]
        older = sum(state["t"] < -BEFORE_S for state in states)
        return states[max(0, older - 1) :]
