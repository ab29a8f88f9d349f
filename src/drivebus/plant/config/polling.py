"""What a drive of a ``plant.toml`` is on its line: its profile with the periods asked for, its dialect, its polls."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

from drivebus import profiles
from drivebus.bus.planner import BusArithmetic, Poll, arithmetic
from drivebus.drives.dialect import Dialect
from drivebus.drives.make import make_dialect
from drivebus.drives.monitor import wanted
from drivebus.line import LineSettings
from drivebus.plant.model import BusSetting, DriveSetting, PlantSetting
from drivebus.ports.link import parse_link
from drivebus.profiles.model import DriveProfile

FULL_PERCENT = 100.0
PACES_S = (0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0, 7.5, 10.0, 15.0, 20.0, 30.0, 60.0)
"""Floors that are tried for drives that ask for no periods; few, so that one more drive seldom changes the others'."""


def profile_of(drive: DriveSetting) -> DriveProfile:
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


def names_of(drive: DriveSetting, profile: DriveProfile) -> tuple[str, ...]:
    """The signals that are polled: those asked for, else every one."""
    return tuple(name for name in drive.signals or profile.signals if name in profile.signals)


def dialect_of(drive: DriveSetting) -> Dialect:
    """Raises ProfileError, ConfigurationError."""
    settings = dict(drive.settings)
    return make_dialect(profile_of(drive), drive.address, encoding=drive.encoding, settings=settings)


def polls_of(drive: DriveSetting, dialect: Dialect) -> list[Poll]:
    """What ``Monitor(bus, dialect, drive.signals or None, period_s=drive.fastest_s)`` asks for."""
    return wanted(dialect, names_of(drive, dialect.profile), drive.fastest_s)


def line_of(bus: BusSetting, profile: DriveProfile | None) -> LineSettings:
    """The bus's own line, else the LINK's, else the factory's of a drive on it. Raises LinkError, ValueError."""
    link = parse_link(bus.link, baud=bus.baud, format=bus.format)
    if profile is None:
        return link.settings
    baud = link.settings.baud if "baud" in link.given else profile.line.baud
    return LineSettings.parse(baud, link.settings.format if "format" in link.given else profile.line.format)


def line_in(plant: PlantSetting, bus: str) -> LineSettings:
    """The line of a bus of the plant. Raises KeyError."""
    setting = next((one for one in plant.buses if one.id == bus), None)
    if setting is None:
        raise KeyError(bus)
    first = next((drive for drive in plant.drives if drive.bus == bus), None)
    return line_of(setting, None if first is None else profiles.load(first.model))


def cost(drives: Iterable[tuple[DriveSetting, Dialect]], line: LineSettings) -> BusArithmetic:
    """What these drives' polls cost their line if each takes its whole time to answer."""
    return arithmetic([(dialect.link, polls_of(drive, dialect)) for drive, dialect in drives], line)


def paced(drives: list[tuple[DriveSetting, Dialect]], line: LineSettings, free: frozenset[str]) -> list[DriveSetting]:
    """The drives, those in ``free`` (which ask for no periods) polled no oftener than the line can do."""
    for pace_s in (0.0, *PACES_S):
        tried = [(replace(drive, fastest_s=pace_s) if drive.id in free else drive, way) for drive, way in drives]
        if not free or cost(tried, line).load_percent <= FULL_PERCENT:
            break
    return [drive for drive, _ in tried]
