"""Which device a serial port means: the one it was told at first, and ever after the same one by its identity (F12).

An adapter that was ttyUSB0 and came back as ttyUSB1 is found; another adapter that took the name ttyUSB0 is refused:
to speak to the wrong bus can start the wrong motor. Blocking calls only.
"""

# ruff: noqa: E402  # the assertion below must come first: type checkers stop there on Windows

from __future__ import annotations

import errno
import os
import sys

from drivebus.errors import PortUnavailable
from drivebus.ports import open_errors
from drivebus.ports.device_users import device_users
from drivebus.ports.discovery import discover_ports
from drivebus.serial_settings import SerialSettings

assert sys.platform != "win32"

from drivebus.ports.locks import DeviceBusy, lock_owner
from drivebus.ports.tty import SerialDescriptor, open_device


def open_by_identity(
    path: str, identity: str, settings: SerialSettings, *, rs485: bool = False
) -> tuple[SerialDescriptor, str]:
    """The device with ``identity`` (empty: the one at ``path``), opened, and its identity. Raises PortUnavailable."""
    target = find_device(path, identity)
    try:
        descriptor = open_device(target, settings, rs485=rs485)
    except OSError as error:
        pid = error.pid if isinstance(error, DeviceBusy) and error.pid else _lock_owner(target, error)
        raise open_errors.open_error(path, error, pid) from error
    try:
        _refuse_if_in_use(path, descriptor)
        return descriptor, identity or identify(path)
    except BaseException:
        descriptor.close()
        raise


def identify(path: str) -> str:
    """The identity of what is at ``path`` now; a link that nobody knows is trusted to be the user's own rule."""
    real = os.path.realpath(path)
    return next((port.identity for port in discover_ports() if port.device == real), f"device:{path}")


def find_device(path: str, identity: str) -> str:
    """Where the device with that identity is now. Raises PortUnavailable where it is not plugged in."""
    if not identity or identity.startswith("device:"):
        return path
    found = next((port.device for port in discover_ports() if port.identity == identity), None)
    if found is None:
        raise PortUnavailable("ports.unplugged", port=path, identity=identity)
    return found


def _refuse_if_in_use(path: str, descriptor: SerialDescriptor) -> None:
    """Another program that had the device open before us and took no lock would be a second master (F14).

    The peer of a pty is no second master, so ptys are not asked.
    """
    if descriptor.capabilities.has_line_timing:
        for holder in device_users({descriptor.device})[descriptor.device]:
            if holder.pid != os.getpid():
                raise open_errors.in_use_error(path, holder)


def _lock_owner(path: str, error: OSError) -> int | None:
    return lock_owner(os.path.realpath(path)) if error.errno == errno.EBUSY else None
