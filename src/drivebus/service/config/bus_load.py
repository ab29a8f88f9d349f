"""What a drive of a ``plant.toml`` is on its line: its profile with the periods asked for, its dialect, its polls.

What a plant costs its lines, before anything is wired or sent: load, refresh of each signal, stop bound. Pure.

``stop<250ms``, ``refresh<2s``, ``load<80%``: what a plant must keep, and who does not keep it. Pure.
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
from drivebus.profiles.model import DriveProfile, Text
from drivebus.serial_settings import SerialSettings
from drivebus.service.config.model import BusConfig, DriveConfig, PlantConfig

FULL_LOAD_PERCENT = 100.0
CANDIDATE_INTERVALS_S = (0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0, 7.5, 10.0, 15.0, 20.0, 30.0, 60.0)
"""Floors that are tried for drives that ask for no periods; few, so that one more drive seldom changes the others'."""


def profile_of(drive: DriveConfig) -> DriveProfile:
    """Its profile with the periods of ``signals``. Raises ProfileError."""
    return with_periods(profiles.load(drive.model), drive.signals)


def with_periods(profile: DriveProfile, periods: Mapping[str, float]) -> DriveProfile:
    """Periods of signals that the profile does not know are passed over."""
    asked = {
        name: replace(profile.signals[name], period_s=period)
        for name, period in periods.items()
        if name in profile.signals
    }
    return replace(profile, signals=dict(profile.signals) | asked) if asked else profile


def polled_names(drive: DriveConfig, profile: DriveProfile) -> tuple[str, ...]:
    """The signals that are polled: those asked for, else every one."""
    return tuple(name for name in drive.signals or profile.signals if name in profile.signals)


def dialect_of(drive: DriveConfig) -> Dialect:
    """Raises ProfileError, ConfigurationError."""
    settings = dict(drive.settings)
    return create_dialect(profile_of(drive), drive.address, encoding=drive.encoding, settings=settings)


def polls_of(drive: DriveConfig, dialect: Dialect) -> list[Poll]:
    """What ``Monitor(bus, dialect, drive.signals or None, period_s=drive.min_poll_interval_s)`` asks for."""
    return status_polls(dialect, polled_names(drive, dialect.profile), drive.min_poll_interval_s)


def serial_settings_of(bus: BusConfig, profile: DriveProfile | None) -> SerialSettings:
    """The bus's own line, else the LINK's, else the factory's of a drive on it. Raises PortUrlError, ValueError."""
    link = parse_port_url(bus.link, baud=bus.baud, format=bus.format)
    if profile is None:
        return link.settings
    baud = link.settings.baud if "baud" in link.explicit else profile.serial.baud
    return SerialSettings.parse(baud, link.settings.format if "format" in link.explicit else profile.serial.format)


def serial_settings_in(plant: PlantConfig, bus: str) -> SerialSettings:
    """The line of a bus of the plant. Raises KeyError."""
    setting = next((one for one in plant.buses if one.id == bus), None)
    if setting is None:
        raise KeyError(bus)
    first = next((drive for drive in plant.drives if drive.bus == bus), None)
    return serial_settings_of(setting, None if first is None else profiles.load(first.model))


def signal_labels(plant: PlantConfig) -> dict[str, tuple[str, Text]]:
    """Return unit and text of every tag that the plant's drives may have. Raises ProfileError."""
    profile_by_drive = {drive.id: profile_of(drive) for drive in plant.drives}
    return {
        f"{drive}.{name}": (signal.unit, signal.text)
        for drive, profile in profile_by_drive.items()
        for name, signal in profile.signals.items()
    }


def polling_load(drives: Iterable[tuple[DriveConfig, Dialect]], line: SerialSettings) -> BusLoad:
    """What these drives' polls cost their line if each takes its whole time to answer."""
    return estimate_bus_load([(dialect.station_config, polls_of(drive, dialect)) for drive, dialect in drives], line)


def with_sufficient_interval(
    drives: list[tuple[DriveConfig, Dialect]], line: SerialSettings, free: frozenset[str]
) -> list[DriveConfig]:
    """The drives, those in ``free`` (which ask for no periods) polled no oftener than the line can do."""
    for pace_s in (0.0, *CANDIDATE_INTERVALS_S):
        tried = [
            (replace(drive, min_poll_interval_s=pace_s) if drive.id in free else drive, way) for drive, way in drives
        ]
        if not free or polling_load(tried, line).load_percent <= FULL_LOAD_PERCENT:
            break
    return [drive for drive, _ in tried]


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
    periods = {
        name: max(profile.signals[name].period_s, drive.min_poll_interval_s) for name in polled_names(drive, profile)
    }
    return DriveLoadEstimate(
        drive=drive.id,
        address=drive.address,
        model=profile.model,
        load_percent=polling_load([(drive, dialect)], line).load_percent,
        stop_bound_s=whole.drives[drive.address].stop_bound_s,
        periods=periods,
        refresh={name: period_s * stretch + whole.cycle_s for name, period_s in periods.items()},
        min_poll_interval_s=drive.min_poll_interval_s,
    )


_REQUIREMENT = re.compile(r"\s*(stop|refresh|load)\s*(<=?)\s*([0-9]{1,9}(?:\.[0-9]{1,6})?)\s*(ms|s|%)\s*")
_UNIT_FACTORS = {"ms": 0.001, "s": 1.0, "%": 1.0}
_COMPARISONS: dict[str, Callable[[float, float], bool]] = {"<": operator.lt, "<=": operator.le}


@dataclass(frozen=True, slots=True)
class LoadRequirement:
    """One of them. ``limit`` in seconds, or percent for ``load``."""

    quantity: str
    sign: str
    limit: float
    text: str


@dataclass(frozen=True, slots=True)
class RequirementViolation:
    """A drive (or, for ``load``, a bus) that does not keep a demand. ``found`` is in the unit of the demand's limit."""

    requirement: LoadRequirement
    name: str
    found: float
    signal: str | None = None


def parse_requirement(text: str) -> LoadRequirement:
    """Raises ValueError for anything else, a load in seconds included."""
    match = _REQUIREMENT.fullmatch(text)
    if match is None or (match[1] == "load") != (match[4] == "%"):
        raise ValueError(text)
    return LoadRequirement(match[1], match[2], float(match[3]) * _UNIT_FACTORS[match[4]], text.strip())


def violations(demand: LoadRequirement, buses: Iterable[BusLoadEstimate]) -> Iterator[RequirementViolation]:
    """Everybody who does not keep it."""
    below = _COMPARISONS[demand.sign]
    return (one for bus in buses for one in _measurements(demand, bus) if not below(one.found, demand.limit))


def _measurements(demand: LoadRequirement, bus: BusLoadEstimate) -> Iterator[RequirementViolation]:
    if demand.quantity == "load":
        yield RequirementViolation(demand, bus.bus, bus.load_percent)
        return
    for drive in bus.drives:
        if demand.quantity == "stop":
            yield RequirementViolation(demand, drive.drive, drive.stop_bound_s)
        else:
            signal, refresh_s = drive.slowest
            yield RequirementViolation(demand, drive.drive, refresh_s, signal)
