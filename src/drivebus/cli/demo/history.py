"""Generated history of the demo: eight hours of twelve drives from the motor model, with alarms and run statistics.

The same seed gives the same values.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from random import Random

from drivebus.cli.demo.layout import DemoBus, DemoDrive
from drivebus.profiles.model import DriveProfile
from drivebus.service.alarms.condition import LimitState, Observation
from drivebus.service.alarms.engine import DEFAULT_ALARMS
from drivebus.service.alarms.model import Alarm
from drivebus.service.alarms.texts import configured_alarm
from drivebus.service.config.model import DriveConfig
from drivebus.service.live.views import Sample, fault_json
from drivebus.service.runtime.run_statistics import RunStatistics
from drivebus.simulator.models.c320 import FAULT_CODES as C320_FAULT_CODES
from drivebus.simulator.models.catalog import LOADS
from drivebus.simulator.models.dzb100 import FAULT_CODES as DZB100_FAULT_CODES
from drivebus.simulator.motor import Motor, Trip
from drivebus.types import Json
from drivebus.values import Quality

HISTORY_HOURS = 8.0  # the shift before the demo
SAMPLE_INTERVAL_S = 10.0
SETPOINTS_HZ = (15.0, 20.0, 25.0, 30.0, 35.0, 40.0, 45.0, 50.0)
RUN_S = (600.0, 5400.0)  # shortest and longest time at one setpoint
PAUSE_S = (60.0, 900.0)  # shortest and longest standstill
TRIP_SHARE = 0.4  # share of the ends of runs that are a trip; a demo without trips has no past alarms
TRIP_CODES: Mapping[str, int] = {
    "sunfar": C320_FAULT_CODES[Trip.OVERCURRENT_RUNNING],
    "dzb100": DZB100_FAULT_CODES[Trip.OVERCURRENT_RUNNING],
}
"""Code of the generated trip by protocol family; the others report no code, and their drives do not trip."""


@dataclass(frozen=True, slots=True)
class DemoEvent:
    """Event of the history that a trend marks."""

    time_ms: int
    drive: str
    kind: str
    """``run``, ``stop`` or ``trip``."""
    frequency_hz: float = 0.0


class HistoryGenerator:
    """Samples and events of one drive."""

    def __init__(self, bus: DemoBus, drive: DemoDrive, profile: DriveProfile, start_ms: int, seed: int) -> None:
        self.drive, self.start_ms = drive.key, start_ms
        self._signals = [name for name in profile.signals if name in SIGNAL_VALUES]
        self._uncertain = {name for name in self._signals if profile.signals[name].uncertain}
        self._can_trip = profile.family in TRIP_CODES
        self._random = Random(f"{seed}/{drive.key}")
        self._motor = Motor(load=LOADS[bus.load]())
        self._motor.accel_s = self._motor.decel_s = bus.ramp_s
        self._next_event_s = self._random.uniform(0.0, 1200.0)
        self.events: list[DemoEvent] = []

    def samples(self) -> Iterator[Sample]:
        """Yield the samples in order of time; append to ``events`` on the way."""
        for step in range(int(HISTORY_HOURS * 3600.0 / SAMPLE_INTERVAL_S)):
            time_s = step * SAMPLE_INTERVAL_S
            if time_s >= self._next_event_s:
                self._next_event(time_s)
            self._motor.step(SAMPLE_INTERVAL_S)
            yield from self._read(self.start_ms + int(time_s * 1000.0))

    def _next_event(self, time_s: float) -> None:
        """Start, change the setpoint, stop or trip."""
        motor, random = self._motor, self._random
        if motor.trip is not None:
            motor.reset()
        if motor.energised and random.random() < 0.5:
            kind = "trip" if random.random() < TRIP_SHARE and self._can_trip else "stop"
            if kind == "trip":
                motor.force_trip(Trip.OVERCURRENT_RUNNING)
            else:
                motor.stop()
            self._next_event_s = time_s + random.uniform(*PAUSE_S)
            self._add_event(time_s, kind)
            return
        hz = random.choice(SETPOINTS_HZ)
        motor.run(hz)
        self._next_event_s = time_s + random.uniform(*RUN_S)
        self._add_event(time_s, "run", hz)

    def _add_event(self, time_s: float, kind: str, hz: float = 0.0) -> None:
        self.events.append(DemoEvent(self.start_ms + int(time_s * 1000.0), self.drive, kind, hz))

    def _read(self, time_ms: int) -> Iterator[Sample]:
        for name in self._signals:
            value = SIGNAL_VALUES[name](self._motor)
            if name in self._uncertain:
                yield Sample(
                    f"{self.drive}.{name}",
                    time_ms,
                    round(value * RAW_COUNTS_PER_UNIT.get(name, 1.0)),
                    Quality.UNCERTAIN,
                )
            else:
                yield Sample(f"{self.drive}.{name}", time_ms, value, Quality.GOOD)


SIGNAL_VALUES: Mapping[str, Callable[[Motor], float]] = {
    "set_frequency": lambda motor: motor.target_hz,
    "output_frequency": lambda motor: round(abs(motor.output_hz), 2),
    "output_current": lambda motor: round(motor.current_a, 1),
    "output_voltage": lambda motor: round(motor.voltage_v),
    "output_power": lambda motor: round(motor.power_kw, 2),
    "dc_bus_voltage": lambda motor: round(motor.bus_v),
    "temperature": lambda motor: round(motor.temperature_c),
    "speed": lambda motor: round(abs(motor.speed_rpm)),
}
"""Signals of the motor model in the units of the profiles; other signals have no history."""
RAW_COUNTS_PER_UNIT = {"output_current": 10.0}
"""Raw counts per unit of the simulated DF800, whose manual defines no scale; such samples are uncertain."""
ACKNOWLEDGED_AFTER_MS = 90_000
"""Time after which the operator of the generated shift acknowledges a trip."""
FAULT_ALARM = next(alarm for alarm in DEFAULT_ALARMS if alarm.id == "fault")


def past_alarms(drive: DriveConfig, profile: DriveProfile, events: Sequence[DemoEvent], by: str) -> Iterator[Alarm]:
    """Yield an alarm, without a number yet, for each trip; acknowledged by ``by`` and cleared by the next start.

    A trip without a later start is not cleared: it is left out, because the simulated drive starts without a fault.
    """
    for event, after in pairwise(events):
        if event.kind != "trip":
            continue
        fault = trip_fault(profile)
        observation = Observation(LimitState.VIOLATED, fault["code"], {"fault": fault})
        alarm = configured_alarm(
            "", FAULT_ALARM, drive=drive.id, name=drive.title, observation=observation, now_ms=event.time_ms
        )
        acknowledged_ms = min(event.time_ms + ACKNOWLEDGED_AFTER_MS, after.time_ms)
        yield replace(alarm, acknowledged_ms=acknowledged_ms, acknowledged_by=by, cleared_ms=after.time_ms)


def number_alarms(alarms: Iterable[Alarm]) -> list[Alarm]:
    """Return alarms in the order of their time, with ids that count up."""
    ordered = sorted(alarms, key=lambda alarm: alarm.raised_ms)
    return [replace(alarm, id=f"a{number}", first_id=f"a{number}") for number, alarm in enumerate(ordered, 1)]


def trip_fault(profile: DriveProfile) -> Json:
    """Return the fault of a generated trip as the service shows it."""
    code = TRIP_CODES[profile.family]
    return fault_json(profile.faults.get(code)) or {"code": code, "label": str(code), "text": {"en": "", "zh": ""}}


def past_statistics(
    profile: DriveProfile, samples: Sequence[Sample], events: Sequence[DemoEvent], start_ms: int
) -> RunStatistics:
    """Return the statistics of the generated hours, only of what the drive reports."""
    values: dict[str, list[float]] = {}
    for sample in samples:
        if sample.quality is Quality.GOOD and sample.value is not None:
            values.setdefault(sample.tag.partition(".")[2], []).append(sample.value)
    statistics = RunStatistics(since_ms=start_ms)
    if "status" in profile.capabilities:
        statistics.running_s = SAMPLE_INTERVAL_S * sum(hz > 0.0 for hz in values.get("output_frequency", ()))
        statistics.starts = sum(
            event.kind == "run" and (at == 0 or events[at - 1].kind != "run") for at, event in enumerate(events)
        )
        trips = sum(event.kind == "trip" for event in events)
        statistics.faults = {str(TRIP_CODES[profile.family]): trips} if trips else {}
    if "output_power" in values:
        statistics.energy_kwh = sum(values["output_power"]) * SAMPLE_INTERVAL_S / 3600.0
    statistics.maximum_current_a = max(values.get("output_current", ()), default=None)
    statistics.maximum_temperature_c = max(values.get("temperature", ()), default=None)
    return statistics
