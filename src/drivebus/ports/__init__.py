"""Ports: serial, TCP serial servers, RFC 2217, memory and replay, chosen by the scheme of a port URL.

Ports transport bytes and do not know frames. A scheme is an entry point of the group ``drivebus.ports``, a function
``open_port(url: PortUrl) -> Port``, imported when it is used.
"""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Any

from drivebus.errors import PortUrlError
from drivebus.ports.base import Port
from drivebus.ports.url import PORT_URL_EXAMPLES, PortUrl, parse_port_url
from drivebus.types import Capabilities, Receiver

if TYPE_CHECKING:
    from drivebus.ports.discovery import PortInfo

__all__ = ["Capabilities", "Port", "PortUrl", "Receiver", "list_ports", "open_port", "parse_port_url"]


def open_port(url: str, *, baud: int | None = None, format: str | None = None, **options: Any) -> Port:
    """Return the port of a URL, not yet opened; arguments override the query. Raises PortUrlError."""
    parsed = parse_port_url(url, baud=baud, format=format, **options)
    found = [entry for entry in entry_points(group="drivebus.ports") if entry.name == parsed.scheme]
    if not found:
        known = ", ".join(sorted({entry.name for entry in entry_points(group="drivebus.ports")}))
        raise PortUrlError("ports.scheme", link=url, found=parsed.scheme, expected=known, examples=PORT_URL_EXAMPLES)
    port: Port = found[0].load()(parsed)
    return port


def list_ports() -> list[PortInfo]:
    """Return the serial ports of this machine: device, description, stable name, processes that use it."""
    from drivebus.ports.discovery import list_ports as listed

    return listed()
