"""The shift that lies behind the demo: eight hours of twelve motors, every ten seconds, from the same motor physics.

Values only: who keeps them is not known here. The same seed gives the same shift.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from random import Random

from drivebus.cli.demo.layout import DemoBus, DemoDrive
from drivebus.profiles.model import DriveProfile
from drivebus.service.live.views import Sample
from drivebus.simulator.models.catalog import LOADS
from drivebus.simulator.motor import Motor, Trip
from drivebus.values import Quality

HOURS, STEP_S = 8.0, 10.0
SETPOINTS_HZ = (15.0, 20.0, 25.0, 30.0, 35.0, 40.0, 45.0, 50.0)
RUN_S, PAUSE_S = (600.0, 5400.0), (60.0, 900.0)
"""How long a drive runs at one setpoint, and how long it rests."""
TRIPS = 0.03
"""Share of the runs that end in a trip."""


@dataclass(frozen=True, slots=True)
class DemoEvent:
    """Something of the shift that a trend marks."""

    time_ms: int
    drive: str
    kind: str
    """``run``, ``stop`` or ``trip``."""
    frequency_hz: float = 0.0


class HistoryGenerator:
    """One drive's shift, step by step."""

    def __init__(self, line: DemoBus, part: DemoDrive, profile: DriveProfile, start_ms: int, seed: int) -> None:
        self.drive, self.start_ms = part.key, start_ms
        self._signals = [name for name in profile.signals if name in VALUES]
        self._rough = {name for name in self._signals if profile.signals[name].uncertain}
        self._chance = Random(f"{seed}/{part.key}")
        self._motor = Motor(load=LOADS[line.load]())
        self._motor.accel_s = self._motor.decel_s = line.ramp_s
        self._next_s = self._chance.uniform(0.0, 1200.0)
        self.happened: list[DemoEvent] = []

    def samples(self) -> Iterator[Sample]:
        """In the order of time; ``happened`` fills on the way."""
        for step in range(int(HOURS * 3600.0 / STEP_S)):
            time_s = step * STEP_S
            if time_s >= self._next_s:
                self._turn(time_s)
            self._motor.step(STEP_S)
            yield from self._read(self.start_ms + int(time_s * 1000.0))

    def _turn(self, time_s: float) -> None:
        """Start, change the setpoint, stop or trip."""
        motor, chance = self._motor, self._chance
        if motor.trip is not None:
            motor.reset()
        if motor.energised and chance.random() < 0.5:
            kind = "trip" if chance.random() < TRIPS else "stop"
            if kind == "trip":
                motor.force_trip(Trip.OVERCURRENT_RUNNING)
            else:
                motor.stop()
            self._next_s = time_s + chance.uniform(*PAUSE_S)
            self._note(time_s, kind)
            return
        hz = chance.choice(SETPOINTS_HZ)
        motor.run(hz)
        self._next_s = time_s + chance.uniform(*RUN_S)
        self._note(time_s, "run", hz)

    def _note(self, time_s: float, kind: str, hz: float = 0.0) -> None:
        self.happened.append(DemoEvent(self.start_ms + int(time_s * 1000.0), self.drive, kind, hz))

    def _read(self, time_ms: int) -> Iterator[Sample]:
        for name in self._signals:
            value = VALUES[name](self._motor)
            if name in self._rough:
                yield Sample(
                    f"{self.drive}.{name}",
                    time_ms,
                    round(value * RAW_COUNTS_PER_UNIT.get(name, 1.0)),
                    Quality.UNCERTAIN,
                )
            else:
                yield Sample(f"{self.drive}.{name}", time_ms, value, Quality.GOOD)


VALUES: Mapping[str, Callable[[Motor], float]] = {
    "set_frequency": lambda motor: motor.target_hz,
    "output_frequency": lambda motor: round(abs(motor.output_hz), 2),
    "output_current": lambda motor: round(motor.current_a, 1),
    "output_voltage": lambda motor: round(motor.voltage_v),
    "output_power": lambda motor: round(motor.power_kw, 2),
    "dc_bus_voltage": lambda motor: round(motor.bus_v),
    "temperature": lambda motor: round(motor.temperature_c),
    "speed": lambda motor: round(abs(motor.speed_rpm)),
}
"""Signals that the motor model knows, in the profiles' units; the others have no history."""
RAW_COUNTS_PER_UNIT = {"output_current": 10.0}
"""Counts a unit of the simulated DF800, whose manual publishes no scale: raw words, so uncertain."""
