"""A line and all that is on it: one setting that everybody can have, one family, and polls that it can carry."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from drivebus.bus.compatibility import protocol_of
from drivebus.bus.poll_schedule import Poll, estimate_bus_load
from drivebus.drives.dialects.base import Dialect
from drivebus.profiles.diagnostics import Issue, issue
from drivebus.profiles.model import DriveProfile
from drivebus.serial_settings import SerialSettings
from drivebus.service.config import build
from drivebus.service.config.model import DriveConfig
from drivebus.service.config.parsed import ParsedPlant
from drivebus.service.config.polling import CANDIDATE_INTERVALS_S, FULL_LOAD_PERCENT, polling_load, serial_settings_of
from drivebus.service.config.schema import DriveTable

SettingPath = tuple[str | int, ...]


def bus_load_problems(draft: ParsedPlant) -> Iterator[Issue]:
    for bus in draft.file.bus:
        drives = [(id, one) for id, one in draft.drives_on(bus) if id in draft.profiles]
        faults = list(_check_families(draft, drives)) or list(_check_serial_settings(draft, bus, drives))
        yield from faults
        clear = bus in draft.links and not faults
        if clear and drives and all(id in draft.dialects for id, _ in drives):
            yield from _check_load(draft, bus, drives)


def _check_families(draft: ParsedPlant, drives: list[tuple[str, DriveTable]]) -> Iterator[Issue]:
    """T18: bytes of one protocol may look like a frame of another."""
    spoken = [(id, draft.dialects[id]) for id, _ in drives if id in draft.dialects]
    for id, dialect in spoken[1:]:
        first, other = spoken[0]
        if protocol_of(dialect.codec) != protocol_of(other.codec):
            found, expected = ("/".join(protocol_of(one.codec)) for one in (dialect, other))
            yield issue("mixed", ("drive", id, "bus"), found, other=first, expected=expected)


def _check_serial_settings(draft: ParsedPlant, bus: str, drives: list[tuple[str, DriveTable]]) -> Iterator[Issue]:
    """The line's baud rate and format: known, and offered by every model on it."""
    link = draft.links.get(bus)
    if link is None:
        return
    for name in ("baud", "format"):
        path = _setting_path(draft, bus, name)
        if name in link.explicit:
            value = getattr(link.settings, name)
            yield from _not_offered(draft, drives, name, value, path)
        else:
            factory = {getattr(draft.profiles[id].serial, name) for id, _ in drives}
            if len(factory) > 1:
                values = ", ".join(str(one) for one in sorted(factory))
                yield issue("line_unclear", path, "-", name=name, values=values)


def _setting_path(draft: ParsedPlant, bus: str, name: str) -> SettingPath:
    """Where the value stands: a key of its own, else in the LINK."""
    own = getattr(draft.file.bus[bus], name) is not None
    return ("bus", bus, name) if own else ("bus", bus, "link")


def _not_offered(
    draft: ParsedPlant, drives: list[tuple[str, DriveTable]], name: str, value: int | str, path: SettingPath
) -> Iterator[Issue]:
    for id, _ in drives:
        offered = _offered(draft.profiles[id], name)
        if value not in offered:
            choices = ", ".join(str(one) for one in offered)
            yield issue("line_not_offered", path, value, drive=id, model=draft.profiles[id].model, choices=choices)
            return


def _offered(profile: DriveProfile, name: str) -> tuple[int | str, ...]:
    return profile.serial.bauds if name == "baud" else profile.serial.formats


def _check_load(draft: ParsedPlant, bus: str, drives: list[tuple[str, DriveTable]]) -> Iterator[Issue]:
    setting = build.bus_config(draft.file, bus)
    line = serial_settings_of(setting, draft.profiles[drives[0][0]])
    found = list(_check_periods(draft, drives, line))
    yield from found
    paced = [(one, draft.dialects[one.id]) for one in build.drives_on_bus(draft, setting)]
    load = polling_load(paced, line).load_percent
    if load > FULL_LOAD_PERCENT and not found:
        least = sufficient_interval(paced, line)
        yield issue("overload", ("bus", bus), f"{load:.0f} %", line=str(line), drives=len(paced), least=least)


def _check_periods(draft: ParsedPlant, drives: list[tuple[str, DriveTable]], line: SerialSettings) -> Iterator[Issue]:
    """One question and its answer take longer than the period that was asked for."""
    for id, drive in drives:
        for name, period_s in drive.signals.items():
            least_s = _poll_time_s(draft.dialects[id], name, line)
            if name in draft.profiles[id].signals and max(period_s, drive.fastest_s or 0.0) < least_s:
                path = ("drive", id, "signals", name)
                yield issue("too_often", path, f"{period_s:g} s", least=f"{least_s:.3f}", line=str(line))


def _poll_time_s(dialect: Dialect, name: str, line: SerialSettings) -> float:
    """The longest that one of the questions for this signal may take."""
    polls = [Poll(request, 1.0) for request, _ in dialect.polls((name,))]
    return max((estimate_bus_load([(dialect.station_config, [poll])], line).cycle_s for poll in polls), default=0.0)


def sufficient_interval(drives: list[tuple[DriveConfig, Dialect]], line: SerialSettings) -> str:
    """The ``fastest_s`` with which the line could carry all these drives."""
    for pace_s in CANDIDATE_INTERVALS_S:
        paced = [(replace(drive, fastest_s=max(pace_s, drive.fastest_s)), dialect) for drive, dialect in drives]
        if polling_load(paced, line).load_percent <= FULL_LOAD_PERCENT:
            return f"{pace_s:g}"
    return f"> {CANDIDATE_INTERVALS_S[-1]:g}"
