"""What a plant costs its lines, before anything is wired or sent: load, refresh of each signal, stop bound. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from drivebus.bus.planner import BusArithmetic
from drivebus.drives.dialect import Dialect
from drivebus.line import LineSettings
from drivebus.plant.config.polling import FULL_PERCENT, cost, dialect_of, line_in, names_of
from drivebus.plant.model import BusSetting, DriveSetting, PlantSetting


@dataclass(frozen=True, slots=True)
class DriveCost:
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
    fastest_s: float
    """No poll of it more often; 0 where nothing holds it back."""

    @property
    def slowest(self) -> tuple[str, float]:
        """The signal that is refreshed least often, and how often."""
        return max(self.refresh.items(), key=lambda item: item[1], default=("-", 0.0))


@dataclass(frozen=True, slots=True)
class BusCost:
    """One line."""

    bus: str
    link: str
    line: LineSettings
    load_percent: float
    """If every station takes its whole time to answer; what remains is for commands."""
    cycle_s: float
    """Every poll once, back to back."""
    drives: tuple[DriveCost, ...]

    @property
    def stop_bound_s(self) -> float:
        """The longest of its drives'."""
        return max((one.stop_bound_s for one in self.drives), default=0.0)


def costs(plant: PlantSetting) -> tuple[BusCost, ...]:
    """Every line of the plant, in the order of the file."""
    return tuple(_bus(plant, bus) for bus in plant.buses)


def _bus(plant: PlantSetting, bus: BusSetting) -> BusCost:
    line = line_in(plant, bus.id)
    drives = [(drive, dialect_of(drive)) for drive in plant.drives if drive.bus == bus.id]
    whole = cost(drives, line)
    each = tuple(_drive(drive, dialect, line, whole) for drive, dialect in drives)
    return BusCost(bus.id, bus.link, line, whole.load_percent, whole.cycle_s, each)


def _drive(drive: DriveSetting, dialect: Dialect, line: LineSettings, whole: BusArithmetic) -> DriveCost:
    profile = dialect.profile
    stretch = max(1.0, whole.load_percent / FULL_PERCENT)
    periods = {name: max(profile.signals[name].period_s, drive.fastest_s) for name in names_of(drive, profile)}
    return DriveCost(
        drive=drive.id,
        address=drive.address,
        model=profile.model,
        load_percent=cost([(drive, dialect)], line).load_percent,
        stop_bound_s=whole.drives[drive.address].stop_bound_s,
        periods=periods,
        refresh={name: period_s * stretch + whole.cycle_s for name, period_s in periods.items()},
        fastest_s=drive.fastest_s,
    )
