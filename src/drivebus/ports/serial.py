"""Local serial ports: the factory, which picks the implementation of this operating system."""

from __future__ import annotations

import sys

from drivebus.ports.base import Port
from drivebus.ports.url import PortUrl


def open_port(link: PortUrl) -> Port:
    """``serial://DEVICE?baud=…&format=…&rs485=on&echo=…``, a device path or a COM name. Raises PortUrlError."""
    if sys.platform == "win32":
        from drivebus.ports.serial_windows import WindowsPort as LocalPort
    else:
        from drivebus.ports.serial_posix import SerialPort as LocalPort

    return LocalPort(link)
