"""Checks of buses and drives: port URLs, models, addresses, options, limits, signals, and the load of each bus.

Nothing is opened.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from difflib import get_close_matches
from typing import Any

from drivebus import ports, profiles
from drivebus.bus.compatibility import protocol_of
from drivebus.bus.load import estimate_bus_load
from drivebus.bus.prepared_request import Poll
from drivebus.drives.dialects.base import Dialect
from drivebus.drives.dialects.create import create_dialect
from drivebus.drives.monitor import READING_VALIDITY_PERIODS
from drivebus.errors import ConfigurationError, DrivebusError
from drivebus.ports.url import NETWORK_SCHEMES, PortUrl, parse_port_url
from drivebus.profiles.diagnostics import Diagnostic, Issue, KeyPath, issue, nearest_names
from drivebus.profiles.model import DriveProfile
from drivebus.serial_settings import SerialSettings
from drivebus.service.config import build
from drivebus.service.config.build import ParsedPlant, is_model_path, polled_signals
from drivebus.service.config.bus_load import (
    CANDIDATE_INTERVALS_S,
    FULL_LOAD_PERCENT,
    polling_load,
    serial_settings_of,
    with_periods,
)
from drivebus.service.config.model import DriveConfig
from drivebus.service.config.schema import BusTable, DriveTable
from drivebus.values import Text

_UNOPENED_SCHEMES = ("memory", "replay")
"""Ports of these schemes cannot be created for a check: they take one end of a connection or read a file."""


def bus_issues(parsed: ParsedPlant) -> Iterator[Issue]:
    """Yield invalid port URLs and formats, and ports that two buses share; fill in ``parsed.port_urls``."""
    bus_by_device: dict[tuple[str, ...], str] = {}
    for id, bus in parsed.file.bus.items():
        path = ("bus", id, "port")
        wrong = bus.format is not None and not is_format(bus.format)
        if wrong:
            yield issue("serial_format", ("bus", id, "format"), bus.format)
        try:
            url = _parse_port_url(bus.model_copy(update={"format": None}) if wrong else bus)
        except ConfigurationError as error:
            yield issue("port_url", path, bus.port, why=error_text(error))
            continue
        device = device_of(url)
        if device in bus_by_device:
            yield issue("one_device", path, bus.port, other=bus_by_device[device], device=device[-1])
        bus_by_device.setdefault(device, id)
        if not wrong:
            parsed.port_urls[id] = url


def is_format(text: str) -> bool:
    """Return whether ``text`` names data bits, parity and stop bits, such as 8E1."""
    try:
        SerialSettings.parse(9600, text)
    except ValueError:
        return False
    return True


def _parse_port_url(bus: BusTable) -> PortUrl:
    """Parse the port URL of a bus. Raises PortUrlError, ConfigurationError, also for an unknown option."""
    url = parse_port_url(bus.port, baud=bus.baud, format=bus.format)
    if url.scheme not in _UNOPENED_SCHEMES:
        name = "" if url.scheme == "sim" else None  # a simulated bus with a name would stay in this process
        ports.open_port(bus.port, baud=bus.baud, format=bus.format, name=name)
    return url


def error_text(error: DrivebusError) -> Text:
    """Return an error's message in both languages."""
    return Text.per_language(error.text)


def device_of(url: PortUrl) -> tuple[str, ...]:
    """Return the identity of a port: equal ones are the same pair of wires."""
    if url.scheme in NETWORK_SCHEMES:
        return ("network", f"{url.host}:{url.port}")
    if url.scheme == "serial":
        return ("serial", os.path.realpath(url.path))
    name = url.options.get("name", "") if url.scheme == "sim" else url.path
    return (url.scheme, name) if name else (url.scheme, url.text, str(id(url)))


def drive_issues(parsed: ParsedPlant) -> Iterator[Issue | Diagnostic]:
    """Yield the issues of each drive by itself and equal addresses on a bus; fill in ``parsed.dialects``."""
    drive_by_station: dict[tuple[str, int], str] = {}
    for id, drive in parsed.file.drive.items():
        path = ("drive", id)
        if drive.bus not in parsed.known_ids("bus"):
            yield issue("unknown_bus", (*path, "bus"), drive.bus, **suggestions(drive.bus, parsed.known_ids("bus")))
        station = (drive.bus, drive.address)
        if station in drive_by_station:
            other = drive_by_station[station]
            yield issue("same_address", (*path, "address"), drive.address, other=other, bus=drive.bus)
        drive_by_station.setdefault(station, id)
        if id in parsed.unread_models:
            yield issue("model_outside", ("drive", id, "model"), drive.model, folder=str(parsed.base))
        elif id in parsed.profile_errors:
            yield from _check_profile(parsed, id, drive)
        elif id in parsed.profiles:
            yield from _check_drive(parsed, id, drive, parsed.profiles[id])


def suggestions(name: str, choices: list[str]) -> dict[str, Any]:
    """Return the parameters of an issue about an unknown name: known names and similar ones."""
    close = nearest_names(name, choices) or get_close_matches(name, choices, 1, 0.0)
    return {"known": tuple(choices) or "-", "near": tuple(close) or "-"}


def _check_profile(parsed: ParsedPlant, id: str, drive: DriveTable) -> Iterator[Issue | Diagnostic]:
    """Yield the issues of a profile that could not be loaded."""
    params = parsed.profile_errors[id].params
    path = ("drive", id, "model")
    kinds = [diagnostic.kind for diagnostic in params["diagnostics"]]
    if kinds == ["no_model"]:
        yield issue("unknown_model", path, drive.model, **suggestions(drive.model, profiles.models()))
        return
    if kinds == ["no_file"] and is_model_path(drive.model):
        yield issue("no_file", path, parsed.model_of(drive))
        return
    yield issue("refused_model", path, drive.model, count=len(kinds))
    first = next(other for other in parsed.profile_errors if parsed.profile_errors[other] is parsed.profile_errors[id])
    yield from params["diagnostics"] if first == id else ()


def _check_drive(parsed: ParsedPlant, id: str, drive: DriveTable, profile: DriveProfile) -> Iterator[Issue]:
    faults = [
        *_check_address(id, drive, profile),
        *_check_encoding(id, drive, profile),
        *_check_options(id, drive, profile),
    ]
    yield from faults
    yield from _check_limits(id, drive, profile)
    yield from _check_signals(parsed, id, drive, profile)
    if not faults:
        polled = with_periods(profile, drive.signals)
        parsed.dialects[id] = create_dialect(polled, drive.address, encoding=drive.encoding, options=drive.options)


def _check_address(id: str, drive: DriveTable, profile: DriveProfile) -> Iterator[Issue]:
    low, high = profile.addresses
    path = ("drive", id, "address")
    if drive.address == profile.broadcast:
        yield issue("broadcast_address", path, drive.address, model=profile.model, low=low, high=high)
    elif not low <= drive.address <= high:
        yield issue("address", path, drive.address, model=profile.model, low=low, high=high)


def _check_encoding(id: str, drive: DriveTable, profile: DriveProfile) -> Iterator[Issue]:
    if drive.encoding is not None and drive.encoding not in profile.encodings:
        yield issue("choice", ("drive", id, "encoding"), drive.encoding, choices=tuple(profile.encodings))


def _check_options(id: str, drive: DriveTable, profile: DriveProfile) -> Iterator[Issue]:
    for name, value in drive.options.items():
        path = ("drive", id, "options", name)
        if name not in profile.options:
            yield issue("unknown_option", path, name, model=profile.model, **suggestions(name, list(profile.options)))
        elif not profile.question(name).allows(value):
            yield issue("choice", path, value, choices=profile.question(name).expected)


def _check_limits(id: str, drive: DriveTable, profile: DriveProfile) -> Iterator[Issue]:
    """Yield limits wider than the model's own."""
    limits, own = drive.limits, profile.limits
    path = ("drive", id, "limits")
    highest = own.maximum_hz if limits.maximum_hz is None else limits.maximum_hz
    if highest > own.maximum_hz:
        yield issue("limit_wide", (*path, "maximum_hz"), highest, bound=f"<= {own.maximum_hz:g}", model=profile.model)
    if "minimum_hz" in limits.model_fields_set and limits.minimum_hz < own.minimum_hz:
        bound = f">= {own.minimum_hz:g}"
        yield issue("limit_wide", (*path, "minimum_hz"), limits.minimum_hz, bound=bound, model=profile.model)
    if limits.minimum_hz >= highest:
        yield issue("limits", (*path, "minimum_hz"), limits.minimum_hz, maximum=f"{highest:g}")
    if not (limits.forward or limits.reverse):
        yield issue("no_direction", (*path, "forward"), False)


def _check_signals(parsed: ParsedPlant, id: str, drive: DriveTable, profile: DriveProfile) -> Iterator[Issue]:
    known = polled_signals(parsed, id, drive.model_copy(update={"signals": {}}))
    for name in drive.signals:
        if name not in profile.signals:
            yield issue("unknown_signal", ("drive", id, "signals", name), name, drive=id, **suggestions(name, known))


def interval_warnings(parsed: ParsedPlant) -> Iterator[Issue]:
    """Yield intervals of polls that are longer than any that drivebus chooses, and than the signal's own period."""
    longest_s = CANDIDATE_INTERVALS_S[-1]
    for id, drive in parsed.file.drive.items():
        for name, period_s in drive.signals.items():
            signal = parsed.profiles[id].signals[name]
            yield from _check_interval(("drive", id, "signals", name), period_s, max(longest_s, signal.period_s))
        yield from _check_interval(("drive", id, "min_poll_interval_s"), drive.min_poll_interval_s, longest_s)


def _check_interval(path: KeyPath, interval_s: float | None, most_s: float) -> Iterator[Issue]:
    if interval_s is not None and interval_s > most_s:
        yield issue(
            "long_interval",
            path,
            int(interval_s) if interval_s.is_integer() else interval_s,
            most=f"{most_s:g}",
            given=f"{interval_s:g}",
            meant=f"{interval_s / 1000:g}",
            valid=f"{READING_VALIDITY_PERIODS * interval_s:g}",
        )


def bus_load_issues(parsed: ParsedPlant) -> Iterator[Issue]:
    """Yield drives and serial settings that do not fit one bus, and buses that can't carry their polls."""
    for bus in parsed.file.bus:
        drives = [(id, table) for id, table in parsed.drive_tables_of(bus) if id in parsed.profiles]
        faults = list(_check_families(parsed, drives)) or list(_check_serial_settings(parsed, bus, drives))
        yield from faults
        clear = bus in parsed.port_urls and not faults
        if clear and drives and all(id in parsed.dialects for id, _ in drives):
            yield from _check_load(parsed, bus, drives)


def _check_families(parsed: ParsedPlant, drives: list[tuple[str, DriveTable]]) -> Iterator[Issue]:
    """Yield drives of different protocols: bytes of one may look like a frame of another."""
    dialects = [(id, parsed.dialects[id]) for id, _ in drives if id in parsed.dialects]
    for id, dialect in dialects[1:]:
        first, other = dialects[0]
        if protocol_of(dialect.codec) != protocol_of(other.codec):
            found, expected = ("/".join(protocol_of(side.codec)) for side in (dialect, other))
            yield issue("mixed", ("drive", id, "bus"), found, other=first, expected=expected)


def _check_serial_settings(parsed: ParsedPlant, bus: str, drives: list[tuple[str, DriveTable]]) -> Iterator[Issue]:
    """Yield serial settings that are unknown or that a model on the bus does not have."""
    url = parsed.port_urls.get(bus)
    if url is None:
        return
    for name in ("baud", "format"):
        path = _setting_path(parsed, bus, name)
        if name in url.explicit:
            value = getattr(url.settings, name)
            yield from _check_offered(parsed, drives, name, value, path)
        else:
            factory = {getattr(parsed.profiles[id].serial, name) for id, _ in drives}
            if len(factory) > 1:
                values = tuple(str(number) for number in sorted(factory))
                yield issue("serial_unclear", path, None, name=name, values=values)


def _setting_path(parsed: ParsedPlant, bus: str, name: str) -> KeyPath:
    """Return the key that holds the setting: its own, else the port URL."""
    own = getattr(parsed.file.bus[bus], name) is not None
    return ("bus", bus, name) if own else ("bus", bus, "port")


def _check_offered(
    parsed: ParsedPlant, drives: list[tuple[str, DriveTable]], name: str, value: int | str, path: KeyPath
) -> Iterator[Issue]:
    for id, _ in drives:
        offered = _offered(parsed.profiles[id], name)
        if value not in offered:
            choices = tuple(str(each) for each in offered)
            yield issue("serial_not_offered", path, value, drive=id, model=parsed.profiles[id].model, choices=choices)
            return


def _offered(profile: DriveProfile, name: str) -> tuple[int | str, ...]:
    return profile.serial.bauds if name == "baud" else profile.serial.formats


def _check_load(parsed: ParsedPlant, bus: str, drives: list[tuple[str, DriveTable]]) -> Iterator[Issue]:
    config = build.bus_config(parsed.file, bus)
    settings = serial_settings_of(config, parsed.profiles[drives[0][0]])
    issues = list(_check_periods(parsed, drives, settings))
    yield from issues
    paced = [(drive, parsed.dialects[drive.id]) for drive in build.drives_on_bus(parsed, config)]
    load = polling_load(paced, settings).load_percent
    if load > FULL_LOAD_PERCENT and not issues:
        least_s = sufficient_interval_s(paced, settings)
        kind = "overload" if least_s is not None else "too_many_drives"
        shown = f"{least_s or CANDIDATE_INTERVALS_S[-1]:g}"
        yield issue(kind, ("bus", bus), f"{load:.0f} %", line=str(settings), drives=len(paced), least=shown)


def _check_periods(
    parsed: ParsedPlant, drives: list[tuple[str, DriveTable]], settings: SerialSettings
) -> Iterator[Issue]:
    """Yield signals whose period is shorter than one request with its reply."""
    for id, drive in drives:
        for name, period_s in drive.signals.items():
            least_s = _poll_time_s(parsed.dialects[id], name, settings)
            if name in parsed.profiles[id].signals and max(period_s, drive.min_poll_interval_s or 0.0) < least_s:
                path = ("drive", id, "signals", name)
                yield issue("too_often", path, f"{period_s:g} s", least=f"{least_s:.3f}", line=str(settings))


def _poll_time_s(dialect: Dialect, name: str, settings: SerialSettings) -> float:
    """Return the longest time of one request for this signal, in seconds."""
    polls = [Poll(request, 1.0) for request, _ in dialect.polls((name,))]
    return max((estimate_bus_load([(dialect.station_config, [poll])], settings).cycle_s for poll in polls), default=0.0)


def sufficient_interval_s(drives: list[tuple[DriveConfig, Dialect]], settings: SerialSettings) -> float | None:
    """Return the ``min_poll_interval_s`` with which the bus could carry all these drives; None if none suffices."""
    for interval_s in CANDIDATE_INTERVALS_S:
        paced = [
            (replace(drive, min_poll_interval_s=max(interval_s, drive.min_poll_interval_s)), dialect)
            for drive, dialect in drives
        ]
        if polling_load(paced, settings).load_percent <= FULL_LOAD_PERCENT:
            return interval_s
    return None
