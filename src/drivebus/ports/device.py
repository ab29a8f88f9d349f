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
from drivebus.line import LineSettings
from drivebus.ports import diagnose
from drivebus.ports.holders import holders
from drivebus.ports.listing import known_ports

assert sys.platform != "win32"

from drivebus.ports.locks import Busy, owner
from drivebus.ports.posix import Descriptor, open_device


def open_same(path: str, identity: str, settings: LineSettings, *, rs485: bool = False) -> tuple[Descriptor, str]:
    """The device with ``identity`` (empty: the one at ``path``), opened, and its identity. Raises PortUnavailable."""
    target = find(path, identity)
    try:
        descriptor = open_device(target, settings, rs485=rs485)
    except OSError as error:
        pid = error.pid if isinstance(error, Busy) and error.pid else _owner(target, error)
        raise diagnose.unavailable(path, error, pid) from error
    try:
        _refuse_company(path, descriptor)
        return descriptor, identity or identify(path)
    except BaseException:
        descriptor.close()
        raise


def identify(path: str) -> str:
    """The identity of what is at ``path`` now; a link that nobody knows is trusted to be the user's own rule."""
    real = os.path.realpath(path)
    return next((port.identity for port in known_ports() if port.device == real), f"device:{path}")


def find(path: str, identity: str) -> str:
    """Where the device with that identity is now. Raises PortUnavailable where it is not plugged in."""
    if not identity or identity.startswith("device:"):
        return path
    found = next((port.device for port in known_ports() if port.identity == identity), None)
    if found is None:
        raise PortUnavailable("ports.unplugged", port=path, identity=identity)
    return found


def _refuse_company(path: str, descriptor: Descriptor) -> None:
    """Another program that had the device open before us and took no lock would be a second master (F14).

    The peer of a pty is no second master, so ptys are not asked.
    """
    if descriptor.capabilities.paced:
        for holder in holders({descriptor.device})[descriptor.device]:
            if holder.pid != os.getpid():
                raise diagnose.held(path, holder)


def _owner(path: str, error: OSError) -> int | None:
    return owner(os.path.realpath(path)) if error.errno == errno.EBUSY else None
