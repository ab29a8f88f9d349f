"""``GET /metrics`` for Prometheus: the service's state in numbers, read for each scrape.

Names follow Prometheus (base units, ``_total`` for counters, ``_ratio`` from 0 to 1), and labels have few values:
ids stand in ``plant.toml``, signals in a profile, all others in this program. A value that is not known has no series:
neither 0 nor the last value.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal, NamedTuple

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.exposition import choose_encoder
from prometheus_client.metrics_core import Metric as MetricFamily
from prometheus_client.registry import Collector, CollectorRegistry

from drivebus import i18n
from drivebus.bus.station import Presence
from drivebus.drives.state import DriveState
from drivebus.service.api.operations.alarms import ALARMS_LIST
from drivebus.service.api.operations.buses import BUSES_LIST
from drivebus.service.api.operations.drives import DRIVES_LIST
from drivebus.service.api.operations.plant import PLANT_GET, PLANT_STATISTICS
from drivebus.service.auth.actor import Actor
from drivebus.service.config.model import AlarmPriority
from drivebus.service.ipc.service_client import ServiceClient
from drivebus.types import Json
from drivebus.values import Quality

METRIC_PREFIX = "drivebus_"
BYTES_PER_MIB = 2**20
SECONDS_PER_HOUR = 3600.0
JOULES_PER_KWH = 3.6e6


@dataclass(frozen=True, slots=True)
class Metric:
    """Family of series. ``name`` is without ``METRIC_PREFIX``; its meaning is in the catalogue ``metrics``."""

    name: str
    labels: tuple[str, ...] = ()

    @property
    def kind(self) -> Literal["counter", "gauge"]:
        return "counter" if self.name.endswith("_total") else "gauge"

    @property
    def full_name(self) -> str:
        return METRIC_PREFIX + self.name

    def text(self, language: str) -> str:
        return i18n.text(f"metrics.{self.name}", language)


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalMetric:
    """A signal that is a metric while it is good and has ``unit``; ``factor`` converts to the base unit."""

    signal: str
    unit: str
    metric: str
    factor: float = 1.0


SIGNAL_METRICS = (
    SignalMetric(signal="output_frequency", unit="Hz", metric="drive_output_frequency_hertz"),
    SignalMetric(signal="set_frequency", unit="Hz", metric="drive_set_frequency_hertz"),
    SignalMetric(signal="output_current", unit="A", metric="drive_output_current_amperes"),
    SignalMetric(signal="output_voltage", unit="V", metric="drive_output_voltage_volts"),
    SignalMetric(signal="output_power", unit="kW", metric="drive_output_power_watts", factor=1000.0),
    SignalMetric(signal="dc_bus_voltage", unit="V", metric="drive_dc_bus_voltage_volts"),
    SignalMetric(signal="temperature", unit="°C", metric="drive_temperature_celsius"),
)
"""A signal of another unit (a raw number without a scale) has an age and no value."""

PLANT_METRICS = (
    Metric("plant_info", ("plant", "version")),
    Metric("plant_start_time_seconds"),
    Metric("audit_writable"),
    Metric("gateway_up", ("gateway",)),
    Metric("gateway_starts_total", ("gateway",)),
    Metric("disk_free_bytes"),
    Metric("disk_size_bytes"),
    Metric("stop_requests_total"),
    Metric("stops_confirmed_total"),
    Metric("stops_acknowledged_total"),
    Metric("alarms_active", ("priority",)),
    Metric("alarms_cleared_unacknowledged", ("priority",)),
    Metric("alarms_unacknowledged", ("priority",)),
    Metric("alarms_shelved"),
    Metric("history_writable"),
    Metric("history_samples_total"),
    Metric("history_samples_lost_total"),
    Metric("history_queue_samples"),
)
BUS_METRICS = (
    Metric("bus_up", ("bus",)),
    Metric("bus_load_ratio", ("bus",)),
    Metric("bus_occupied_ratio", ("bus",)),
    Metric("bus_requests_total", ("bus",)),
    Metric("bus_replies_total", ("bus",)),
    Metric("bus_errors_total", ("bus", "error")),
    Metric("bus_events_total", ("bus", "kind")),
    Metric("bus_reply_seconds", ("bus", "quantile")),
    Metric("bus_cycle_seconds", ("bus",)),
    Metric("bus_stop_bound_seconds", ("bus",)),
    Metric("bus_foreign_master", ("bus",)),
)
DRIVE_METRICS = (
    Metric("drive_info", ("drive", "bus", "address", "model")),
    Metric("drive_up", ("drive",)),
    Metric("drive_presence", ("drive", "presence")),
    Metric("drive_state", ("drive", "state")),
    Metric("drive_state_age_seconds", ("drive",)),
    Metric("drive_fault_code", ("drive",)),
    *(Metric(signal.metric, ("drive",)) for signal in SIGNAL_METRICS),
    Metric("drive_signal_valid", ("drive", "signal")),
    Metric("drive_signal_age_seconds", ("drive", "signal")),
    Metric("drive_commanded_frequency_hertz", ("drive",)),
    Metric("drive_controlled", ("drive",)),
    Metric("drive_start_inhibited", ("drive",)),
    Metric("drive_stop_pending", ("drive",)),
    Metric("drive_start_blocked", ("drive",)),
    Metric("drive_alarms_active", ("drive", "priority")),
    Metric("drive_alarms_cleared_unacknowledged", ("drive", "priority")),
    Metric("drive_cycle_seconds", ("drive",)),
    Metric("drive_load_ratio", ("drive",)),
    Metric("drive_errors_total", ("drive", "error")),
    Metric("drive_running_seconds_total", ("drive",)),
    Metric("drive_starts_total", ("drive",)),
    Metric("drive_trips_total", ("drive",)),
    Metric("drive_energy_joules", ("drive",)),
)

METRICS: dict[str, Metric] = {metric.name: metric for metric in (*PLANT_METRICS, *BUS_METRICS, *DRIVE_METRICS)}


class Point(NamedTuple):
    """Sample: a metric's name, the values of its labels in their order, the number."""

    metric: str
    labels: tuple[str, ...]
    value: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ScrapeData:
    """Results of the operations that one scrape calls."""

    plant: Json
    statistics: Json
    drives: list[Json]
    buses: list[Json]
    alarms: list[Json]


def metric_points(data: ScrapeData) -> Iterator[Point]:
    """Yield every sample of one scrape."""
    for metric, labels, value in _all_points(data):
        if value is not None:
            yield Point(metric, labels, float(value))


OptionalPoint = tuple[str, tuple[str, ...], float | None]


def _all_points(data: ScrapeData) -> Iterator[OptionalPoint]:
    yield from _plant_points(data.plant)
    yield from _statistics_points(data.statistics)
    yield from _alarm_points(data.alarms)
    for bus in data.buses:
        yield from _bus_points(bus)
        for station in bus["stations"]:
            yield from _station_points(station)
    cleared = _cleared(_unshelved(data.alarms))
    for drive in data.drives:
        yield from _drive_points(drive, [alarm for alarm in cleared if alarm["drive"] == drive["id"]])
        yield from _signal_points(drive)
    for drive_id, run in data.statistics["drives"].items():
        yield from _run_points(drive_id, run)


def _plant_points(plant: Json) -> Iterator[OptionalPoint]:
    disk = plant["disk"]
    yield "plant_info", (plant["id"], plant["version"]), 1
    yield "plant_start_time_seconds", (), plant["started_ms"] / 1000
    yield "audit_writable", (), plant["audit_ok"]
    yield "history_writable", (), plant["history_ok"]
    for gateway in plant["gateways"]:
        yield "gateway_up", (gateway["id"],), gateway["running"]
        yield "gateway_starts_total", (gateway["id"],), gateway["starts"]
    if disk:
        yield "disk_free_bytes", (), disk["free_mb"] * BYTES_PER_MIB
        yield "disk_size_bytes", (), disk["total_mb"] * BYTES_PER_MIB


def _statistics_points(statistics: Json) -> Iterator[OptionalPoint]:
    stops, history = statistics["stops"], statistics["history"]
    yield "stop_requests_total", (), stops["requested"]
    yield "stops_confirmed_total", (), stops["confirmed"]
    yield "stops_acknowledged_total", (), stops["acknowledged"]
    yield "history_samples_total", (), history.get("samples")
    yield "history_samples_lost_total", (), history.get("lost_samples")
    yield "history_queue_samples", (), history.get("queued")


def _alarm_points(alarms: list[Json]) -> Iterator[OptionalPoint]:
    unshelved = _unshelved(alarms)
    yield "alarms_shelved", (), len(alarms) - len(unshelved)
    yield from _priority_counts("alarms_active", (), (alarm for alarm in unshelved if alarm["cleared_ms"] is None))
    yield from _priority_counts("alarms_cleared_unacknowledged", (), _cleared(unshelved))
    yield from _priority_counts(
        "alarms_unacknowledged", (), (alarm for alarm in unshelved if alarm["acknowledged_ms"] is None)
    )


def _unshelved(alarms: Iterable[Json]) -> list[Json]:
    return [alarm for alarm in alarms if alarm["shelved_until_ms"] is None]


def _cleared(alarms: Iterable[Json]) -> list[Json]:
    """Return the alarms whose condition no longer holds; they are listed until they are acknowledged."""
    return [alarm for alarm in alarms if alarm["cleared_ms"] is not None]


def _priority_counts(metric: str, labels: tuple[str, ...], alarms: Iterable[Json]) -> Iterator[OptionalPoint]:
    counts = Counter(alarm["priority"] for alarm in alarms)
    for priority in AlarmPriority:
        yield metric, (*labels, priority), counts[priority]


def _bus_points(bus: Json) -> Iterator[OptionalPoint]:
    """Yield the samples of one bus; without a port there is no load and no reply time."""
    labels = (bus["id"],)
    yield "bus_up", labels, bus["is_open"]
    yield "bus_requests_total", labels, bus["transactions"]
    yield "bus_replies_total", labels, bus["replies"]
    yield from _labelled_counts("bus_errors_total", labels, bus["errors"])
    yield from _labelled_counts("bus_events_total", labels, bus["counters"])
    yield "bus_cycle_seconds", labels, max((station["refresh_s"] or 0.0 for station in bus["stations"]), default=None)
    yield "bus_stop_bound_seconds", labels, bus["stop_bound_s"]
    yield "bus_foreign_master", labels, bus["foreign_master"]
    if bus["is_open"]:
        yield "bus_load_ratio", labels, bus["load_percent"] / 100
        yield "bus_occupied_ratio", labels, bus["occupied_percent"] / 100
        for percent in (50, 95, 99):
            yield "bus_reply_seconds", (*labels, str(percent / 100)), bus[f"reply_p{percent}_s"]


def _labelled_counts(metric: str, labels: tuple[str, ...], counts: Json) -> Iterator[OptionalPoint]:
    for label, count in counts.items():
        yield metric, (*labels, label), count


def _station_points(station: Json) -> Iterator[OptionalPoint]:
    labels = (station["drive"],)
    yield "drive_cycle_seconds", labels, station["refresh_s"]
    yield "drive_load_ratio", labels, station["load_percent"] / 100
    yield from _labelled_counts("drive_errors_total", labels, station["errors"])


def _drive_points(drive: Json, cleared_alarms: list[Json]) -> Iterator[OptionalPoint]:
    labels = (drive["id"],)
    yield "drive_info", (*labels, drive["bus"], str(drive["address"]), drive["model"]), 1
    yield "drive_up", labels, drive["presence"] == Presence.ONLINE
    yield from _state_set("drive_presence", labels, Presence, drive["presence"])
    yield from _state_set("drive_state", labels, DriveState, drive["state"])
    yield "drive_state_age_seconds", labels, _age_s(drive, drive["state_time_ms"])
    yield "drive_fault_code", labels, _fault_code(drive)
    yield "drive_commanded_frequency_hertz", labels, drive["commanded_hz"]
    yield "drive_controlled", labels, drive["lease"] is not None
    yield "drive_start_inhibited", labels, drive["start_inhibited"]
    yield "drive_stop_pending", labels, drive["stop_pending"]
    yield "drive_start_blocked", labels, bool(drive["start_blockers"])
    for priority in AlarmPriority:
        yield "drive_alarms_active", (*labels, priority), drive["alarms"].get(priority, 0)
    yield from _priority_counts("drive_alarms_cleared_unacknowledged", labels, cleared_alarms)


def _state_set(metric: str, labels: tuple[str, ...], states: Iterable[str], present: str) -> Iterator[OptionalPoint]:
    """Yield 1 for the present state, 0 for every other."""
    for state in states:
        yield metric, (*labels, str(state)), state == present


def _fault_code(drive: Json) -> int | None:
    """Return 0 only for a drive whose state is known now."""
    if drive["fault"] is not None:
        return int(drive["fault"]["code"])
    return None if drive["state"] == DriveState.UNKNOWN else 0


def _age_s(drive: Json, time_ms: int | None) -> float | None:
    """Return the seconds from a time to that of the drive's view, by the service's clock."""
    return None if time_ms is None else (drive["time_ms"] - time_ms) / 1000


def _signal_points(drive: Json) -> Iterator[OptionalPoint]:
    """Yield the good signals only: an uncertain one may be wrong by a factor of ten, where the scale is not settled."""
    signals = drive["signals"]
    for name, signal in signals.items():
        yield "drive_signal_valid", (drive["id"], name), signal["quality"] == Quality.GOOD
        yield "drive_signal_age_seconds", (drive["id"], name), _age_s(drive, signal["source_time_ms"])
    for metric in SIGNAL_METRICS:
        signal = signals.get(metric.signal)
        if signal is not None and signal["quality"] == Quality.GOOD and signal["unit"] == metric.unit:
            yield metric.metric, (drive["id"],), signal["value"] * metric.factor


def _run_points(drive_id: str, run: Json) -> Iterator[OptionalPoint]:
    """Yield the statistics of one drive. Energy is no counter: a braking motor gives some back."""
    if run.get("running_h") is not None:
        yield "drive_running_seconds_total", (drive_id,), run["running_h"] * SECONDS_PER_HOUR
        yield "drive_starts_total", (drive_id,), run["starts"]
        yield "drive_trips_total", (drive_id,), sum(run["faults"].values())
    if run.get("energy_kwh") is not None:
        yield "drive_energy_joules", (drive_id,), run["energy_kwh"] * JOULES_PER_KWH


class _PointCollector(Collector):
    """The samples of one scrape."""

    def __init__(self, points: Iterable[Point]) -> None:
        self._points = points

    def collect(self) -> Iterator[MetricFamily]:
        families = {name: _metric_family(metric) for name, metric in METRICS.items()}
        for point in self._points:
            families[point.metric].add_metric(point.labels, point.value)
        yield from families.values()


def _metric_family(metric: Metric) -> CounterMetricFamily | GaugeMetricFamily:
    kind = CounterMetricFamily if metric.kind == "counter" else GaugeMetricFamily
    return kind(metric.full_name, metric.text("en"), labels=metric.labels)


def exposition(points: Iterable[Point], accept: str) -> tuple[bytes, str]:
    """Return the text and its media type: OpenMetrics where ``accept`` names it, else the classic form."""
    registry = CollectorRegistry()
    registry.register(_PointCollector(points))
    encoder, media_type = choose_encoder(accept)
    return encoder(registry), media_type


async def fetch_scrape_data(client: ServiceClient, actor: Actor) -> ScrapeData:
    """Read what one scrape shows. Raises the service's errors."""
    names = (PLANT_GET.name, PLANT_STATISTICS.name, DRIVES_LIST.name, BUSES_LIST.name, ALARMS_LIST.name)
    plant, statistics, drives, buses, alarms = await asyncio.gather(*(client.call(name, {}, actor) for name in names))
    return ScrapeData(
        plant=plant,
        statistics=statistics,
        drives=drives["drives"],
        buses=buses["buses"],
        alarms=alarms["active"],
    )
