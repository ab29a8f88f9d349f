"""Entry point of scheme ``serial``: the implementation for this operating system."""

from __future__ import annotations

import sys

from drivebus.ports.base import Port
from drivebus.ports.url import PortUrl


def open_port(url: PortUrl) -> Port:
    """``serial://DEVICE?baud=…&format=…&rs485=on&echo=…``, a device path or a COM name. Raises PortUrlError."""
    if sys.platform == "win32":
        from drivebus.ports.serial_windows import WindowsPort as LocalPort
    else:
        from drivebus.ports.serial_posix import SerialPort as LocalPort

    return LocalPort(url)
