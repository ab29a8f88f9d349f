"""Bytes in and out: serial ports, TCP serial servers, RFC 2217, memory, replay. Chosen by the scheme of a LINK.

Nothing here knows a frame. Modules of a scheme are imported when it is used, through the entry-point group
``drivebus.ports``: a factory ``open_port(link: drivebus.ports.link.Link) -> Port``.
"""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Any

from drivebus.errors import LinkError
from drivebus.ports.link import EXAMPLES, Link, parse_link
from drivebus.ports.port import Capabilities, Port, Receiver

if TYPE_CHECKING:
    from drivebus.ports.listing import PortInfo

__all__ = ["Capabilities", "Link", "Port", "Receiver", "list_ports", "open_port", "parse_link"]


def open_port(link: str, *, baud: int | None = None, format: str | None = None, **options: Any) -> Port:
    """The port that ``link`` names, not yet opened. Explicit arguments beat the link's query. Raises LinkError."""
    parsed = parse_link(link, baud=baud, format=format, **options)
    found = [entry for entry in entry_points(group="drivebus.ports") if entry.name == parsed.scheme]
    if not found:
        known = ", ".join(sorted({entry.name for entry in entry_points(group="drivebus.ports")}))
        raise LinkError("ports.scheme", link=link, found=parsed.scheme, expected=known, examples=EXAMPLES)
    port: Port = found[0].load()(parsed)
    return port


def list_ports() -> list[PortInfo]:
    """The serial ports of this machine: device, what it is, its stable name, who holds it."""
    from drivebus.ports.listing import list_ports as listed

    return listed()
