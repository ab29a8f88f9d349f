"""What a plant costs its lines, before anything is wired or sent: load, refresh of each signal, stop bound. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from drivebus.bus.poll_schedule import BusLoad
from drivebus.drives.dialects.base import Dialect
from drivebus.serial_settings import SerialSettings
from drivebus.service.config.model import BusConfig, DriveConfig, PlantConfig
from drivebus.service.config.polling import (
    FULL_LOAD_PERCENT,
    dialect_of,
    polled_names,
    polling_load,
    serial_settings_in,
)


@dataclass(frozen=True, slots=True)
class DriveLoadEstimate:
    """One drive on its line. Seconds, percent of bus time."""

    drive: str
    address: int
    model: str
    load_percent: float
    stop_bound_s: float
    """From asking for a stop to its last bit on the wire, everybody else alive or not (5.1)."""
    periods: Mapping[str, float]
    """Signal → how often it is asked for."""
    refresh: Mapping[str, float]
    """Signal → longest time between two of its values while everybody answers at its limit: its period, and once
    everybody else's question before its own (each waits in the plan at most once)."""
    min_poll_interval_s: float
    """No poll of it more often; 0 where nothing holds it back."""

    @property
    def slowest(self) -> tuple[str, float]:
        """The signal that is refreshed least often, and how often."""
        return max(self.refresh.items(), key=lambda item: item[1], default=("-", 0.0))


@dataclass(frozen=True, slots=True)
class BusLoadEstimate:
    """One line."""

    bus: str
    link: str
    serial_settings: SerialSettings
    load_percent: float
    """If every station takes its whole time to answer; what remains is for commands."""
    cycle_s: float
    """Every poll once, back to back."""
    drives: tuple[DriveLoadEstimate, ...]

    @property
    def stop_bound_s(self) -> float:
        """The longest of its drives'."""
        return max((one.stop_bound_s for one in self.drives), default=0.0)


def bus_loads(plant: PlantConfig) -> tuple[BusLoadEstimate, ...]:
    """Every line of the plant, in the order of the file."""
    return tuple(_bus_load(plant, bus) for bus in plant.buses)


def _bus_load(plant: PlantConfig, bus: BusConfig) -> BusLoadEstimate:
    line = serial_settings_in(plant, bus.id)
    drives = [(drive, dialect_of(drive)) for drive in plant.drives if drive.bus == bus.id]
    whole = polling_load(drives, line)
    each = tuple(_drive_load(drive, dialect, line, whole) for drive, dialect in drives)
    return BusLoadEstimate(bus.id, bus.link, line, whole.load_percent, whole.cycle_s, each)


def _drive_load(drive: DriveConfig, dialect: Dialect, line: SerialSettings, whole: BusLoad) -> DriveLoadEstimate:
    profile = dialect.profile
    stretch = max(1.0, whole.load_percent / FULL_LOAD_PERCENT)
    periods = {name: max(profile.signals[name].period_s, drive.fastest_s) for name in polled_names(drive, profile)}
    return DriveLoadEstimate(
        drive=drive.id,
        address=drive.address,
        model=profile.model,
        load_percent=polling_load([(drive, dialect)], line).load_percent,
        stop_bound_s=whole.drives[drive.address].stop_bound_s,
        periods=periods,
        refresh={name: period_s * stretch + whole.cycle_s for name, period_s in periods.items()},
        min_poll_interval_s=drive.fastest_s,
    )
