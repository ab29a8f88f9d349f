"""Ports, which send and receive bytes: serial ports, TCP serial servers, RFC 2217, memory, replay.

The scheme of a port URL selects the port. The module of a scheme is imported when it is used, through the entry-point
group ``drivebus.ports``: a function ``(url: drivebus.ports.url.PortUrl) -> Port``.
"""

from __future__ import annotations

import sys
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, Any

from drivebus.errors import PortUrlError
from drivebus.ports.base import Port
from drivebus.ports.url import DEFAULT_SETTINGS, PORT_URL_EXAMPLES, PortUrl, parse_port_url
from drivebus.serial_settings import SerialSettings
from drivebus.types import Capabilities, Receiver

if TYPE_CHECKING:
    from drivebus.ports.discovery import PortInfo

__all__ = ["Capabilities", "Port", "PortUrl", "Receiver", "list_ports", "open_port", "parse_port_url"]


def open_port(
    url: str,
    *,
    baud: int | None = None,
    format: str | None = None,
    defaults: SerialSettings = DEFAULT_SETTINGS,
    **options: Any,
) -> Port:
    """Return the port of a URL, not yet opened; arguments override its query, which overrides ``defaults``.

    Raises PortUrlError, for a simulated drive ConfigurationError, and for a replay CaptureError.
    """
    parsed = parse_port_url(url, baud=baud, format=format, defaults=defaults, **options)
    entries = _entry_points()
    if parsed.scheme not in entries:
        known = tuple(sorted(entries))
        raise PortUrlError("ports.scheme", port=url, found=parsed.scheme, expected=known, examples=PORT_URL_EXAMPLES)
    port: Port = entries[parsed.scheme].load()(parsed)
    return port


@cache
def _entry_points() -> dict[str, EntryPoint]:
    """Return the entry points of the ports by scheme; the search through all installed packages takes about 10 ms."""
    found: dict[str, EntryPoint] = {}
    for entry in entry_points(group="drivebus.ports"):
        found.setdefault(entry.name, entry)
    return found


def open_serial_port(url: PortUrl) -> Port:
    """Return the port of ``serial://DEVICE?baud=…&format=…&rs485=on&echo=…``, a device path or a COM name.

    Entry point of scheme ``serial``. Raises PortUrlError.
    """
    if sys.platform == "win32":
        from drivebus.ports.serial_windows import WindowsPort as LocalPort
    else:
        from drivebus.ports.serial_posix import SerialPort as LocalPort

    return LocalPort(url)


def list_ports() -> list[PortInfo]:
    """Return the serial ports of this machine with their stable names and the processes that use them."""
    from drivebus.ports import discovery

    return discovery.list_ports()
