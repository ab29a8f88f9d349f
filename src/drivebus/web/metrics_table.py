"""Every metric by name, with its kind and labels. What it means is the sentence ``metrics.NAME`` of the catalogue: the
help text of the exposition and the paragraph of the reference.

Names follow Prometheus: base units, ``_total`` for what only grows, ``_ratio`` from 0 to 1. No label's values can grow
without bound: ids stand in ``plant.toml``, signals in a profile, everything else in this program.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from drivebus import i18n

METRIC_PREFIX = "drivebus_"


@dataclass(frozen=True, slots=True)
class Metric:
    """One family of series. ``name`` is without ``PREFIX``; a counter's ends with ``_total``."""

    name: str
    labels: tuple[str, ...] = ()

    @property
    def kind(self) -> Literal["counter", "gauge"]:
        return "counter" if self.name.endswith("_total") else "gauge"

    @property
    def full_name(self) -> str:
        """As it is scraped."""
        return METRIC_PREFIX + self.name

    def text(self, language: str) -> str:
        return i18n.text(f"metrics.{self.name}", language)


@dataclass(frozen=True, slots=True)
class SignalMetric:
    """A signal that is a metric where it is good and has ``unit``; ``factor`` makes the base unit of it."""

    signal: str
    unit: str
    metric: str
    factor: float = 1.0


SIGNAL_METRICS = (
    SignalMetric("output_frequency", "Hz", "drive_output_frequency_hertz"),
    SignalMetric("set_frequency", "Hz", "drive_set_frequency_hertz"),
    SignalMetric("output_current", "A", "drive_output_current_amperes"),
    SignalMetric("output_voltage", "V", "drive_output_voltage_volts"),
    SignalMetric("output_power", "kW", "drive_output_power_watts", 1000.0),
    SignalMetric("dc_bus_voltage", "V", "drive_dc_bus_voltage_volts"),
    SignalMetric("temperature", "°C", "drive_temperature_celsius"),
)
"""A raw word without a unit is no current: such a signal has its age here, and no value."""

PLANT_METRICS = (
    Metric("plant_info", ("plant", "version")),
    Metric("plant_start_time_seconds"),
    Metric("audit_writable"),
    Metric("disk_free_bytes"),
    Metric("disk_size_bytes"),
    Metric("stops_asked_total"),
    Metric("stops_confirmed_total"),
    Metric("stops_acknowledged_total"),
    Metric("alarms_active", ("priority",)),
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
    *(Metric(one.metric, ("drive",)) for one in SIGNAL_METRICS),
    Metric("drive_reading_good", ("drive", "signal")),
    Metric("drive_reading_age_seconds", ("drive", "signal")),
    Metric("drive_commanded_frequency_hertz", ("drive",)),
    Metric("drive_leased", ("drive",)),
    Metric("drive_latched", ("drive",)),
    Metric("drive_stop_pending", ("drive",)),
    Metric("drive_start_blocked", ("drive",)),
    Metric("drive_alarms_active", ("drive", "priority")),
    Metric("drive_cycle_seconds", ("drive",)),
    Metric("drive_load_ratio", ("drive",)),
    Metric("drive_errors_total", ("drive", "error")),
    Metric("drive_running_seconds_total", ("drive",)),
    Metric("drive_starts_total", ("drive",)),
    Metric("drive_trips_total", ("drive",)),
    Metric("drive_energy_joules", ("drive",)),
)

METRICS: dict[str, Metric] = {metric.name: metric for metric in (*PLANT_METRICS, *BUS_METRICS, *DRIVE_METRICS)}
