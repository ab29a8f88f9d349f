"""Buses: LINKs that can be understood, and no device twice. Opens nothing."""

from __future__ import annotations

import os
from collections.abc import Iterator

from drivebus import i18n, ports
from drivebus.errors import ConfigurationError, DrivebusError
from drivebus.ports.url import NETWORK_SCHEMES, PortUrl, parse_port_url
from drivebus.profiles.diagnostics import Issue, issue
from drivebus.profiles.model import Text
from drivebus.serial_settings import SerialSettings
from drivebus.service.config.parsed import ParsedPlant
from drivebus.service.config.schema import BusTable

_UNOPENED_SCHEMES = ("memory", "replay")
"""To make a port of these takes one end of a wire, or reads a file; one with a name is shared with whoever has it."""


def bus_problems(draft: ParsedPlant) -> Iterator[Issue]:
    taken: dict[tuple[str, ...], str] = {}
    for id, bus in draft.file.bus.items():
        path = ("bus", id, "link")
        wrong = bus.format is not None and not is_format(bus.format)
        if wrong:
            yield issue("line_format", ("bus", id, "format"), bus.format)
        try:
            link = _parse_bus_link(bus.model_copy(update={"format": None}) if wrong else bus)
        except ConfigurationError as error:
            yield issue("link", path, bus.link, why=error_text(error))
            continue
        device = device_of(link)
        if device in taken:
            yield issue("one_device", path, bus.link, other=taken[device], device=device[-1])
        taken.setdefault(device, id)
        if not wrong:
            draft.links[id] = link


def is_format(text: str) -> bool:
    """Data bits, parity, stop bits."""
    try:
        SerialSettings.parse(9600, text)
    except ValueError:
        return False
    return True


def _parse_bus_link(bus: BusTable) -> PortUrl:
    """Raises PortUrlError, ConfigurationError: also for an option that the scheme does not have."""
    link = parse_port_url(bus.link, baud=bus.baud, format=bus.format)
    if link.scheme not in _UNOPENED_SCHEMES and "name" not in link.options:
        ports.open_port(bus.link, baud=bus.baud, format=bus.format)
    return link


def error_text(error: DrivebusError) -> Text:
    """An error's sentence in both languages."""
    return Text(*(error.text(language) for language in i18n.LANGUAGES))


def device_of(link: PortUrl) -> tuple[str, ...]:
    """What a LINK stands for: two that are equal are one pair of wires."""
    if link.scheme in NETWORK_SCHEMES:
        return ("network", f"{link.host}:{link.port}")
    if link.scheme == "serial":
        return ("serial", os.path.realpath(link.path))
    name = link.options.get("name", "") if link.scheme == "sim" else link.path
    return (link.scheme, name) if name else (link.scheme, link.text, str(id(link)))
