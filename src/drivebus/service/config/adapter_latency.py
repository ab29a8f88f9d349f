"""Adapters that hold received bytes back, and the polls a second that each costs its bus."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from drivebus.bus.load import polls_per_s
from drivebus.bus.messages import StationConfig
from drivebus.bus.prepared_request import Poll
from drivebus.ports import latency_timer
from drivebus.ports.url import parse_port_url
from drivebus.serial_settings import SerialSettings
from drivebus.service.config.bus_load import dialect_of, polls_of, serial_settings_in
from drivebus.service.config.model import PlantConfig
from drivebus.types import Json
from drivebus.values import Text


@dataclass(frozen=True, slots=True, kw_only=True)
class AdapterLatency:
    """Adapter of a bus whose latency timer is longer than 1 ms. Polls are sent back to back, replies at their limit."""

    bus: str
    device: str
    """Name of the device, such as ttyUSB0."""
    latency_ms: int
    polls_per_s: float
    polls_per_s_at_low_latency: float

    def text_params(self, bus: Text) -> Json:
        """Return the parameters of the sentence ``ports.latency_cost``, which begins with the name of the bus."""
        return {
            "bus": bus,
            "device": self.device,
            "ms": self.latency_ms,
            "polls": f"{self.polls_per_s:.1f}",
            "possible": f"{self.polls_per_s_at_low_latency:.1f}",
        }


def adapter_latencies(plant: PlantConfig) -> Iterator[AdapterLatency]:
    """Yield the slow adapter of each bus that has one. Opens no port. Raises ProfileError, ConfigurationError."""
    for bus in plant.buses:
        dialects = [(drive, dialect_of(drive)) for drive in plant.drives if drive.bus == bus.id]
        polls = [(dialect.station_config, polls_of(drive, dialect)) for drive, dialect in dialects]
        latency = adapter_latency(bus.id, serial_device(bus.port), polls, serial_settings_in(plant, bus.id))
        if latency is not None:
            yield latency


def serial_device(port: str) -> str | None:
    """Return the path of the serial device that a port URL names, None for another port. Raises PortUrlError."""
    url = parse_port_url(port)
    return url.path if url.scheme == "serial" else None


def adapter_latency(
    bus: str, path: str | None, polls: Sequence[tuple[StationConfig, Sequence[Poll]]], settings: SerialSettings
) -> AdapterLatency | None:
    """Return the cost of the adapter of a serial device; None where it is fast, unknown, or not of this machine."""
    if path is None:
        return None
    device = os.path.realpath(path)
    latency_ms = latency_timer.latency_ms(device)
    if latency_ms is None or latency_ms <= latency_timer.LOW_LATENCY_MS:
        return None
    return AdapterLatency(
        bus=bus,
        device=os.path.basename(device),  # noqa: PTH119
        latency_ms=latency_ms,
        polls_per_s=polls_per_s(polls, settings, latency_ms / 1000),
        polls_per_s_at_low_latency=polls_per_s(polls, settings, latency_timer.LOW_LATENCY_MS / 1000),
    )
