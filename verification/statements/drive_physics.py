"""Motor and memory of a misbehaving drive: a linear ramp, a trip, and the misbehaviour that the session chose."""

from __future__ import annotations

from dataclasses import dataclass, field
from random import Random

MISBEHAVIOURS = (
    "reports_reverse",
    "runs_at_zero",
    "ignores_stop",
    "trips",
    "decelerates_slowly",
    "never_runs",
    "value_not_taken",
    "stops_by_itself",
    "reserved_state",
    "ignores_reset",
    "other_setpoint",
)
"""Ways in which a drive differs from its commands. It reports what it does, except with ``reports_reverse``."""
RAMP_HZ_S, SLOW_RAMP_HZ_S = 40.0, 1.5
MAX_TRIP_DELAY_S = 3.0


@dataclass(slots=True, kw_only=True)
class DrivePhysics:
    """State of one drive; ``advance`` moves it in time."""

    rng: Random
    misbehaviours: frozenset[str]
    hz: float = 0.0
    target_hz: float = 0.0
    setpoint_hz: float = 0.0
    is_on: bool = False
    is_stopping: bool = False
    reverse: bool = False
    fault: int = 0
    """Fault code, 0 without a fault."""
    memory: dict[int, int] = field(default_factory=dict)
    now: float = 0.0
    ends_by_itself_at: float = float("inf")
    """Time of the trip or of the stop at the keypad."""
    was_on: bool = False
    """Whether the output was on since ``was_on`` was cleared."""

    def advance(self, now: float) -> None:
        """Move to ``now``."""
        elapsed, self.now = now - self.now, now
        if self.is_on and now >= self.ends_by_itself_at:
            self.ends_by_itself_at = float("inf")
            if "trips" in self.misbehaviours:
                self.fault, self.is_on, self.hz, self.is_stopping = 5, False, 0.0, False
            else:
                self.is_stopping = True
        if not self.is_on:
            return
        goal = 0.0 if self.is_stopping else self.target_hz
        slow = self.is_stopping and "decelerates_slowly" in self.misbehaviours
        step = elapsed * (SLOW_RAMP_HZ_S if slow else RAMP_HZ_S)
        self.hz = max(goal, self.hz - step) if self.hz > goal else min(goal, self.hz + step)
        if self.is_stopping and self.hz == 0.0:
            self.is_on = self.is_stopping = False

    @property
    def state(self) -> str:
        """State that the drive reports, by the product's name of it."""
        if self.fault:
            return "fault"
        if not self.is_on:
            return "stopped"
        return "decelerating" if self.is_stopping else "running"

    @property
    def shows_reverse(self) -> bool:
        return self.reverse is not ("reports_reverse" in self.misbehaviours)

    def start(self, *, reverse: bool) -> None:
        if self.fault or "never_runs" in self.misbehaviours:
            return
        if not self.is_on and {"trips", "stops_by_itself"} & self.misbehaviours:
            self.ends_by_itself_at = self.now + self.rng.uniform(0.0, MAX_TRIP_DELAY_S)
        self.is_on, self.is_stopping, self.reverse, self.was_on = True, False, reverse, True
        self.target_hz = 0.0 if "runs_at_zero" in self.misbehaviours else self.setpoint_hz

    def set_frequency(self, hz: float) -> None:
        self.setpoint_hz = 1.0 if "other_setpoint" in self.misbehaviours else hz
        if self.is_on and "runs_at_zero" not in self.misbehaviours:
            self.target_hz = self.setpoint_hz

    def stop(self) -> None:
        if self.is_on and "ignores_stop" not in self.misbehaviours:
            self.is_stopping = True

    def reset(self) -> None:
        if "ignores_reset" not in self.misbehaviours:
            self.fault = 0

    def write(self, key: int, value: int) -> None:
        if "value_not_taken" not in self.misbehaviours:
            self.memory[key] = value
