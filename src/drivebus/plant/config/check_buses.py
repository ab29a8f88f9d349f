"""Buses: LINKs that can be understood, and no device twice. Opens nothing."""

from __future__ import annotations

import os
from collections.abc import Iterator

from drivebus import i18n, ports
from drivebus.errors import ConfigurationError, DrivebusError
from drivebus.line import LineSettings
from drivebus.plant.config.draft import Draft
from drivebus.plant.config.schema import BusTable
from drivebus.ports.link import NETWORK_SCHEMES, Link, parse_link
from drivebus.profiles.complaint import Problem, problem
from drivebus.profiles.model import Text

_UNREAD = ("memory", "replay")
"""To make a port of these takes one end of a wire, or reads a file; one with a name is shared with whoever has it."""


def problems(draft: Draft) -> Iterator[Problem]:
    taken: dict[tuple[str, ...], str] = {}
    for id, bus in draft.file.bus.items():
        path = ("bus", id, "link")
        wrong = bus.format is not None and not is_format(bus.format)
        if wrong:
            yield problem("line_format", ("bus", id, "format"), bus.format)
        try:
            link = _link(bus.model_copy(update={"format": None}) if wrong else bus)
        except ConfigurationError as error:
            yield problem("link", path, bus.link, why=said(error))
            continue
        device = device_of(link)
        if device in taken:
            yield problem("one_device", path, bus.link, other=taken[device], device=device[-1])
        taken.setdefault(device, id)
        if not wrong:
            draft.links[id] = link


def is_format(text: str) -> bool:
    """Data bits, parity, stop bits."""
    try:
        LineSettings.parse(9600, text)
    except ValueError:
        return False
    return True


def _link(bus: BusTable) -> Link:
    """Raises LinkError, ConfigurationError: also for an option that the scheme does not have."""
    link = parse_link(bus.link, baud=bus.baud, format=bus.format)
    if link.scheme not in _UNREAD and "name" not in link.options:
        ports.open_port(bus.link, baud=bus.baud, format=bus.format)
    return link


def said(error: DrivebusError) -> Text:
    """An error's sentence in both languages."""
    return Text(*(error.text(language) for language in i18n.LANGUAGES))


def device_of(link: Link) -> tuple[str, ...]:
    """What a LINK stands for: two that are equal are one pair of wires."""
    if link.scheme in NETWORK_SCHEMES:
        return ("network", f"{link.host}:{link.port}")
    if link.scheme == "serial":
        return ("serial", os.path.realpath(link.path))
    name = link.options.get("name", "") if link.scheme == "sim" else link.path
    return (link.scheme, name) if name else (link.scheme, link.text, str(id(link)))
