"""Load of a plant's buses, estimated before anything is wired or sent: polls, load, refresh, stop bound. Pure.

It includes the requirements of ``drivebus check --assert``: ``stop<250ms``, ``refresh<2s``, ``load<80%``.
"""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

from drivebus import profiles
from drivebus.bus.load import BusLoad, estimate_bus_load
from drivebus.bus.prepared_request import Poll
from drivebus.drives.dialects.base import Dialect
from drivebus.drives.dialects.create import create_dialect
from drivebus.drives.monitor import status_polls
from drivebus.ports.url import parse_port_url
from drivebus.profiles.model import DriveProfile
from drivebus.serial_settings import SerialSettings
from drivebus.service.config.model import BusConfig, DriveConfig, PlantConfig
from drivebus.values import Text

FULL_LOAD_PERCENT = 100.0
CANDIDATE_INTERVALS_S = (0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0, 7.5, 10.0, 15.0, 20.0, 30.0, 60.0)
"""Intervals tried for drives without a configured one; few, so that one more drive seldom changes the others."""


def profile_of(drive: DriveConfig) -> DriveProfile:
    """Return a drive's profile with its configured periods. Raises ProfileError."""
    return with_periods(profiles.load(drive.model), drive.signals)


def with_periods(profile: DriveProfile, periods: Mapping[str, float]) -> DriveProfile:
    """Return the profile with other periods; unknown signals are ignored."""
    changed = {
        name: replace(profile.signals[name], period_s=period)
        for name, period in periods.items()
        if name in profile.signals
    }
    return replace(profile, signals=dict(profile.signals) | changed) if changed else profile


def polled_names(drive: DriveConfig, profile: DriveProfile) -> tuple[str, ...]:
    """Return the polled signals: the configured ones, else all."""
    return tuple(name for name in drive.signals or profile.signals if name in profile.signals)


def dialect_of(drive: DriveConfig) -> Dialect:
    """Return the dialect of a drive. Raises ProfileError, ConfigurationError."""
    options = dict(drive.options)
    return create_dialect(profile_of(drive), drive.address, encoding=drive.encoding, options=options)


def polls_of(drive: DriveConfig, dialect: Dialect) -> list[Poll]:
    """Return the polls of the drive's ``Monitor``."""
    return status_polls(dialect, polled_names(drive, dialect.profile), drive.min_poll_interval_s)


def serial_settings_of(bus: BusConfig, profile: DriveProfile | None) -> SerialSettings:
    """Return the settings of the bus table, else of the port URL, else the factory settings of a drive on the bus.

    Raises PortUrlError, ValueError.
    """
    url = parse_port_url(bus.port, baud=bus.baud, format=bus.format)
    if profile is None:
        return url.settings
    baud = url.settings.baud if "baud" in url.explicit else profile.serial.baud
    return SerialSettings.parse(baud, url.settings.format if "format" in url.explicit else profile.serial.format)


def serial_settings_in(plant: PlantConfig, bus: str) -> SerialSettings:
    """Return the serial settings of a bus. Raises KeyError."""
    config = next((each for each in plant.buses if each.id == bus), None)
    if config is None:
        raise KeyError(bus)
    first = next((drive for drive in plant.drives if drive.bus == bus), None)
    return serial_settings_of(config, None if first is None else profiles.load(first.model))


def signal_labels(plant: PlantConfig) -> dict[str, tuple[str, Text]]:
    """Return unit and text of every tag that the plant's drives may have. Raises ProfileError."""
    profile_by_drive = {drive.id: profile_of(drive) for drive in plant.drives}
    return {
        f"{drive}.{name}": (signal.unit, signal.text)
        for drive, profile in profile_by_drive.items()
        for name, signal in profile.signals.items()
    }


def polling_load(drives: Iterable[tuple[DriveConfig, Dialect]], settings: SerialSettings) -> BusLoad:
    """Return the load of these drives' polls if every reply takes its longest time."""
    return estimate_bus_load(
        [(dialect.station_config, polls_of(drive, dialect)) for drive, dialect in drives], settings
    )


def with_sufficient_interval(
    drives: list[tuple[DriveConfig, Dialect]], settings: SerialSettings, adjustable: frozenset[str]
) -> list[DriveConfig]:
    """Return the drives; those in ``adjustable`` get the shortest interval that the bus can carry.

    It is never longer than a drive's own periods: a configured signal keeps its period, and its state and faults are
    as fresh as it is.
    """
    for interval_s in (0.0, *CANDIDATE_INTERVALS_S):
        tried = [
            (replace(drive, min_poll_interval_s=min([interval_s, *drive.signals.values()])), dialect)
            if drive.id in adjustable
            else (drive, dialect)
            for drive, dialect in drives
        ]
        if not adjustable or polling_load(tried, settings).load_percent <= FULL_LOAD_PERCENT:
            break
    return [drive for drive, _ in tried]


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveLoadEstimate:
    """Load of one drive: seconds, percent of bus time."""

    drive: str
    address: int
    model: str
    load_percent: float
    stop_bound_s: float
    """Longest time from the request of a stop to its last bit on the wire, whether or not other stations answer."""
    periods: Mapping[str, float]
    """Signal → poll period."""
    refresh: Mapping[str, float]
    """Signal → longest time between two values, if every station answers at its limit: period plus one bus cycle."""
    min_poll_interval_s: float
    """Shortest interval of its polls; 0 without a limit."""

    @property
    def slowest(self) -> tuple[str, float]:
        """Signal with the longest refresh, and that time."""
        return max(self.refresh.items(), key=lambda item: item[1], default=("-", 0.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class BusLoadEstimate:
    """Estimated load of one bus, with its refresh times and stop bound."""

    bus: str
    port: str
    serial_settings: SerialSettings
    load_percent: float
    """Load if every station takes its longest time to answer; the rest is left for commands."""
    cycle_s: float
    """Time of every poll once, back to back."""
    drives: tuple[DriveLoadEstimate, ...]

    @property
    def stop_bound_s(self) -> float:
        """Longest stop bound of its drives."""
        return max((drive.stop_bound_s for drive in self.drives), default=0.0)


def bus_loads(plant: PlantConfig) -> tuple[BusLoadEstimate, ...]:
    """Return the load of every bus, in the order of the file."""
    return tuple(_bus_load(plant, bus) for bus in plant.buses)


def _bus_load(plant: PlantConfig, bus: BusConfig) -> BusLoadEstimate:
    settings = serial_settings_in(plant, bus.id)
    drives = [(drive, dialect_of(drive)) for drive in plant.drives if drive.bus == bus.id]
    whole = polling_load(drives, settings)
    each = tuple(_drive_load(drive, dialect, settings, whole) for drive, dialect in drives)
    return BusLoadEstimate(
        bus=bus.id,
        port=bus.port,
        serial_settings=settings,
        load_percent=whole.load_percent,
        cycle_s=whole.cycle_s,
        drives=each,
    )


def _drive_load(drive: DriveConfig, dialect: Dialect, settings: SerialSettings, bus_load: BusLoad) -> DriveLoadEstimate:
    profile = dialect.profile
    stretch = max(1.0, bus_load.load_percent / FULL_LOAD_PERCENT)
    periods = {
        name: max(profile.signals[name].period_s, drive.min_poll_interval_s) for name in polled_names(drive, profile)
    }
    return DriveLoadEstimate(
        drive=drive.id,
        address=drive.address,
        model=profile.model,
        load_percent=polling_load([(drive, dialect)], settings).load_percent,
        stop_bound_s=bus_load.drives[drive.address].stop_bound_s,
        periods=periods,
        refresh={name: period_s * stretch + bus_load.cycle_s for name, period_s in periods.items()},
        min_poll_interval_s=drive.min_poll_interval_s,
    )


_REQUIREMENT = re.compile(r"\s*(stop|refresh|load)\s*(<=?)\s*([0-9]{1,9}(?:\.[0-9]{1,6})?)\s*(ms|s|%)\s*")
_UNIT_FACTORS = {"ms": 0.001, "s": 1.0, "%": 1.0}
_COMPARISONS: dict[str, Callable[[float, float], bool]] = {"<": operator.lt, "<=": operator.le}


@dataclass(frozen=True, slots=True)
class LoadRequirement:
    """Requirement on the load. ``limit`` in seconds, for ``load`` in percent."""

    quantity: str
    sign: str
    limit: float
    text: str


@dataclass(frozen=True, slots=True)
class RequirementViolation:
    """Drive (for ``load``: bus) that misses a requirement. ``found`` has the unit of the requirement's limit."""

    requirement: LoadRequirement
    name: str
    found: float
    signal: str | None = None


def parse_requirement(text: str) -> LoadRequirement:
    """Parse a requirement. Raises ValueError, also for a load in seconds."""
    match = _REQUIREMENT.fullmatch(text)
    if match is None or (match[1] == "load") != (match[4] == "%"):
        raise ValueError(text)
    return LoadRequirement(match[1], match[2], float(match[3]) * _UNIT_FACTORS[match[4]], text.strip())


def violations(requirement: LoadRequirement, buses: Iterable[BusLoadEstimate]) -> Iterator[RequirementViolation]:
    """Return everything that misses a requirement."""
    below = _COMPARISONS[requirement.sign]
    return (
        measurement
        for bus in buses
        for measurement in _measurements(requirement, bus)
        if not below(measurement.found, requirement.limit)
    )


def _measurements(requirement: LoadRequirement, bus: BusLoadEstimate) -> Iterator[RequirementViolation]:
    if requirement.quantity == "load":
        yield RequirementViolation(requirement, bus.bus, bus.load_percent)
        return
    for drive in bus.drives:
        if requirement.quantity == "stop":
            yield RequirementViolation(requirement, drive.drive, drive.stop_bound_s)
        else:
            signal, refresh_s = drive.slowest
            yield RequirementViolation(requirement, drive.drive, refresh_s, signal)
