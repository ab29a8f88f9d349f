"""What the plant answers, as numbers with labels. What is not known has no point: not 0, not the last value (G17)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

from drivebus.bus.station import Presence
from drivebus.drives.state import DriveState
from drivebus.service.config.model import AlarmPriority
from drivebus.values import Quality
from drivebus.web.metrics_table import SIGNAL_METRICS

Json = dict[str, Any]
BYTES_PER_MIB = 2**20
SECONDS_PER_HOUR = 3600.0
JOULES_PER_KWH = 3.6e6


class Point(NamedTuple):
    """One series: a metric's name, its labels' values in the metric's order, the number."""

    metric: str
    labels: tuple[str, ...]
    value: float


@dataclass(frozen=True, slots=True)
class ScrapeData:
    """What the plant answered to one scrape, each part by the operation of that name."""

    plant: Json
    statistics: Json
    drives: list[Json]
    buses: list[Json]
    alarms: list[Json]


def metric_points(told: ScrapeData) -> Iterator[Point]:
    """Every series of one scrape."""
    for metric, labels, value in _all_points(told):
        if value is not None:
            yield Point(metric, labels, float(value))


OptionalPoint = tuple[str, tuple[str, ...], float | None]


def _all_points(told: ScrapeData) -> Iterator[OptionalPoint]:
    yield from _plant_points(told.plant)
    yield from _statistics_points(told.statistics)
    yield from _alarm_points(told.alarms)
    for bus in told.buses:
        yield from _bus_points(bus)
        for station in bus["stations"]:
            yield from _station_points(station)
    for drive in told.drives:
        yield from _drive_points(drive)
        yield from _signal_points(drive)
    for id, run in told.statistics["drives"].items():
        yield from _run_points(id, run)


def _plant_points(plant: Json) -> Iterator[OptionalPoint]:
    disk = plant["disk"]
    yield "plant_info", (plant["id"], plant["version"]), 1
    yield "plant_start_time_seconds", (), plant["started_ms"] / 1000
    yield "audit_writable", (), plant["audit_ok"]
    yield "history_writable", (), plant["history_ok"]
    if disk:
        yield "disk_free_bytes", (), disk["free_mb"] * BYTES_PER_MIB
        yield "disk_size_bytes", (), disk["total_mb"] * BYTES_PER_MIB


def _statistics_points(statistics: Json) -> Iterator[OptionalPoint]:
    for word, count in statistics["stops"].items():
        yield f"stops_{word}_total", (), count
    history = statistics["history"]
    yield "history_samples_total", (), history.get("samples")
    yield "history_samples_lost_total", (), history.get("lost_samples")
    yield "history_queue_samples", (), history.get("queued")


def _alarm_points(alarms: list[Json]) -> Iterator[OptionalPoint]:
    shown = [alarm for alarm in alarms if alarm["shelved_until_ms"] is None]
    unseen = [alarm for alarm in shown if alarm["acknowledged_ms"] is None]
    yield "alarms_shelved", (), len(alarms) - len(shown)
    for name, some in (("alarms_active", shown), ("alarms_unacknowledged", unseen)):
        for priority in AlarmPriority:
            yield name, (priority,), sum(alarm["priority"] == priority for alarm in some)


def _bus_points(bus: Json) -> Iterator[OptionalPoint]:
    """What tells of the last minute is left out while the port is gone; counters stay where they are."""
    id = (bus["id"],)
    yield "bus_up", id, bus["is_open"]
    yield "bus_requests_total", id, bus["transactions"]
    yield "bus_replies_total", id, bus["replies"]
    yield from _labelled_counts("bus_errors_total", id, bus["errors"])
    yield from _labelled_counts("bus_events_total", id, bus["counters"])
    yield "bus_cycle_seconds", id, max((one["refresh_s"] or 0.0 for one in bus["stations"]), default=None)
    yield "bus_stop_bound_seconds", id, bus["stop_bound_s"]
    yield "bus_foreign_master", id, bus["foreign_master"]
    if bus["is_open"]:
        yield "bus_load_ratio", id, bus["load_percent"] / 100
        yield "bus_occupied_ratio", id, bus["occupied_percent"] / 100
        for percent in (50, 95, 99):
            yield "bus_reply_seconds", (*id, str(percent / 100)), bus[f"reply_p{percent}_s"]


def _labelled_counts(metric: str, id: tuple[str, ...], counts: Json) -> Iterator[OptionalPoint]:
    for word, count in counts.items():
        yield metric, (*id, word), count


def _station_points(station: Json) -> Iterator[OptionalPoint]:
    id = (station["drive"],)
    yield "drive_cycle_seconds", id, station["refresh_s"]
    yield "drive_load_ratio", id, station["load_percent"] / 100
    yield from _labelled_counts("drive_errors_total", id, station["errors"])


def _drive_points(drive: Json) -> Iterator[OptionalPoint]:
    id = (drive["id"],)
    yield "drive_info", (*id, drive["bus"], str(drive["address"]), drive["model"]), 1
    yield "drive_up", id, drive["presence"] == Presence.ONLINE
    yield from _state_set("drive_presence", id, Presence, drive["presence"])
    yield from _state_set("drive_state", id, DriveState, drive["state"])
    yield "drive_state_age_seconds", id, drive["state_age_s"]
    yield "drive_fault_code", id, _fault_code(drive)
    yield "drive_commanded_frequency_hertz", id, drive["commanded_hz"]
    yield "drive_leased", id, drive["lease"] is not None
    yield "drive_latched", id, drive["latched"]
    yield "drive_stop_pending", id, drive["stop_pending"]
    yield "drive_start_blocked", id, bool(drive["blocked"])
    for priority in AlarmPriority:
        yield "drive_alarms_active", (*id, priority), drive["alarms"].get(priority, 0)


def _state_set(metric: str, id: tuple[str, ...], words: Iterable[str], found: str) -> Iterator[OptionalPoint]:
    """1 for the word that it is, 0 for every other."""
    for word in words:
        yield metric, (*id, str(word)), word == found


def _fault_code(drive: Json) -> int | None:
    """0 is said only by a drive that tells its state, and tells it now."""
    if drive["fault"] is not None:
        return int(drive["fault"]["code"])
    return None if drive["state"] == DriveState.UNKNOWN else 0


def _signal_points(drive: Json) -> Iterator[OptionalPoint]:
    """An uncertain value may be wrong by a factor of ten (a scale that nobody has settled): it is left out as a bad one
    is."""
    known = drive["signals"]
    for name, signal in known.items():
        yield "drive_reading_good", (drive["id"], name), signal["quality"] == Quality.GOOD
        yield "drive_reading_age_seconds", (drive["id"], name), signal["age_s"]
    for one in SIGNAL_METRICS:
        signal = known.get(one.signal)
        if signal is not None and signal["quality"] == Quality.GOOD and signal["unit"] == one.unit:
            yield one.metric, (drive["id"],), signal["value"] * one.factor


def _run_points(id: str, run: Json) -> Iterator[OptionalPoint]:
    """Energy may become less (a motor that brakes gives it back), so that it is no counter."""
    if run.get("running_h") is not None:
        yield "drive_running_seconds_total", (id,), run["running_h"] * SECONDS_PER_HOUR
        yield "drive_starts_total", (id,), run["starts"]
        yield "drive_trips_total", (id,), sum(run["faults"].values())
    if run.get("energy_kwh") is not None:
        yield "drive_energy_joules", (id,), run["energy_kwh"] * JOULES_PER_KWH
