"""Alarms and run statistics that belong to the generated history of the demo."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

from drivebus.cli.demo.history import SAMPLE_INTERVAL_S, TRIP_CODES, DemoEvent
from drivebus.profiles.model import DriveProfile
from drivebus.service.alarms.condition import LimitState, Observation
from drivebus.service.alarms.engine import DEFAULT_ALARMS, configured_alarm
from drivebus.service.alarms.model import Alarm
from drivebus.service.config.model import DriveConfig
from drivebus.service.live.views import Sample, fault_json
from drivebus.service.runtime.run_statistics import RunStatistics
from drivebus.types import Json
from drivebus.values import Quality

ACKNOWLEDGED_AFTER_MS = 90_000
"""Time after which the operator of the generated shift acknowledges a trip."""
FAULT_ALARM = next(one for one in DEFAULT_ALARMS if one.id == "fault")


def past_alarms(drive: DriveConfig, profile: DriveProfile, events: Sequence[DemoEvent], by: str) -> Iterator[Alarm]:
    """Yield an alarm, not numbered yet, for each trip; acknowledged by ``by`` and cleared by the next start.

    A trip without a later start is not cleared: it is left out, because the simulated drive starts without a fault.
    """
    for event, after in pairwise(events):
        if event.kind != "trip":
            continue
        fault = trip_fault(profile)
        found = Observation(LimitState.VIOLATED, fault["code"], {"fault": fault})
        alarm = configured_alarm("", FAULT_ALARM, drive.id, drive.title, found, event.time_ms)
        acknowledged_ms = min(event.time_ms + ACKNOWLEDGED_AFTER_MS, after.time_ms)
        yield replace(alarm, acknowledged_ms=acknowledged_ms, acknowledged_by=by, cleared_ms=after.time_ms)


def numbered(alarms: Iterable[Alarm]) -> list[Alarm]:
    """Return alarms in the order of their time, with ids of that order."""
    ordered = sorted(alarms, key=lambda alarm: alarm.raised_ms)
    return [replace(alarm, id=f"a{number}") for number, alarm in enumerate(ordered, 1)]


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
    found = RunStatistics(since_ms=start_ms)
    if "status" in profile.capabilities:
        found.running_s = SAMPLE_INTERVAL_S * sum(hz > 0.0 for hz in values.get("output_frequency", ()))
        found.starts = sum(
            event.kind == "run" and (at == 0 or events[at - 1].kind != "run") for at, event in enumerate(events)
        )
        trips = sum(event.kind == "trip" for event in events)
        found.faults = {str(TRIP_CODES[profile.family]): trips} if trips else {}
    if "output_power" in values:
        found.energy_kwh = sum(values["output_power"]) * SAMPLE_INTERVAL_S / 3600.0
    found.maximum_current_a = max(values.get("output_current", ()), default=None)
    found.maximum_temperature_c = max(values.get("temperature", ()), default=None)
    return found
