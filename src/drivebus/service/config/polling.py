"""What a drive of a ``plant.toml`` is on its line: its profile with the periods asked for, its dialect, its polls."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

from drivebus import profiles
from drivebus.bus.poll_schedule import BusLoad, Poll, estimate_bus_load
from drivebus.drives.dialects.base import Dialect
from drivebus.drives.dialects.create import create_dialect
from drivebus.drives.monitor import status_polls
from drivebus.ports.url import parse_port_url
from drivebus.profiles.model import DriveProfile
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
    """What ``Monitor(bus, dialect, drive.signals or None, period_s=drive.fastest_s)`` asks for."""
    return status_polls(dialect, polled_names(drive, dialect.profile), drive.fastest_s)


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


def polling_load(drives: Iterable[tuple[DriveConfig, Dialect]], line: SerialSettings) -> BusLoad:
    """What these drives' polls cost their line if each takes its whole time to answer."""
    return estimate_bus_load([(dialect.station_config, polls_of(drive, dialect)) for drive, dialect in drives], line)


def with_sufficient_interval(
    drives: list[tuple[DriveConfig, Dialect]], line: SerialSettings, free: frozenset[str]
) -> list[DriveConfig]:
    """The drives, those in ``free`` (which ask for no periods) polled no oftener than the line can do."""
    for pace_s in (0.0, *CANDIDATE_INTERVALS_S):
        tried = [(replace(drive, fastest_s=pace_s) if drive.id in free else drive, way) for drive, way in drives]
        if not free or polling_load(tried, line).load_percent <= FULL_LOAD_PERCENT:
            break
    return [drive for drive, _ in tried]
