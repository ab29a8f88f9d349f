"""Local serial ports: the factory, which picks the implementation of this operating system."""

from __future__ import annotations

import sys

from drivebus.ports.link import Link
from drivebus.ports.port import Port


def open_port(link: Link) -> Port:
    """``serial://DEVICE?baud=…&format=…&rs485=on&echo=…``, a device path or a COM name. Raises LinkError."""
    if sys.platform == "win32":
        from drivebus.ports.windows import WindowsPort as LocalPort
    else:
        from drivebus.ports.terminal import SerialPort as LocalPort

    return LocalPort(link)
