"""Opening of a serial device on a POSIX system by blocking calls: find by identity, lock, configure, read back.

INPCK | PARMRK is set on every real port and verified by reading back: without INPCK the kernel passes a byte with bad
parity as good, and for DZB100 parity is the only check there is.

A port keeps its device: an adapter that was ttyUSB0 and came back as ttyUSB1 is found, and another adapter that took
the name ttyUSB0 is rejected, because a frame on the wrong bus can start the wrong motor.
"""

# ruff: noqa: E402  # the assertion below must come first: type checkers stop there on Windows

from __future__ import annotations

import contextlib
import errno
import os
import struct
import sys
from dataclasses import dataclass, replace

assert sys.platform != "win32"

import fcntl
import termios

from drivebus.errors import PortUnavailable
from drivebus.ports import latency_timer, open_errors, serialx_adapter
from drivebus.ports.discovery import device_users, discover_ports
from drivebus.ports.locks import DeviceBusy, DeviceLock, lock_owner
from drivebus.serial_settings import SerialSettings
from drivebus.types import Capabilities

_TCGETS2 = 0x802C542A
_TIOCSRS485, _TIOCGRS485 = 0x542F, 0x542E
_GENERIC_MACHINES = ("x86_64", "i", "aarch64", "arm", "riscv")  # these use the asm-generic ioctl numbers above
_RS485_ENABLED, _RS485_RTS_ON_SEND = 1, 2  # flags of struct serial_rs485 (kernel documentation, serial-rs485.rst)
_CMSPAR = 0o10000000000
_UNIX98_SLAVES = range(136, 144)  # major numbers of Linux ptys
BAUD_TOLERANCE = 0.02  # a UART tolerates about 4 % between both ends, so each may be off by half of it


@dataclass(slots=True, kw_only=True)
class SerialDescriptor:
    """An open device and its properties."""

    fd: int
    device: str
    capabilities: Capabilities
    lock: DeviceLock
    low_latency: bool
    marks_line_errors: bool
    """INPCK | PARMRK is in force: received bytes must be decoded."""

    def close(self) -> None:
        """Release and close; the kernel still sends the bytes that it has accepted. Idempotent."""
        fd, self.fd = self.fd, -1
        if fd >= 0:
            self.lock.release()
            os.close(fd)


# --- identity --------------------------------------------------------------------------------------------------------


def open_by_identity(
    path: str, identity: str, settings: SerialSettings, *, rs485: bool = False
) -> tuple[SerialDescriptor, str]:
    """Open the device with ``identity`` (empty: the one at ``path``) and return it with its identity.

    Raises PortUnavailable with the reason and the remedy.
    """
    target = find_device(path, identity)
    try:
        descriptor = open_device(target, settings, rs485=rs485)
    except OSError as error:
        pid = error.pid if isinstance(error, DeviceBusy) and error.pid else None
        if pid is None and error.errno == errno.EBUSY:
            pid = lock_owner(os.path.realpath(target))
        raise open_errors.open_error(path, error, pid) from error
    try:
        _refuse_if_in_use(path, descriptor)
        return descriptor, identity or identify(path)
    except BaseException:
        descriptor.close()
        raise


def identify(path: str) -> str:
    """Return the identity of the device at ``path``; a link unknown to udev is taken as the user's own name."""
    real = os.path.realpath(path)
    return next((port.identity for port in discover_ports() if port.device == real), f"device:{path}")


def find_device(path: str, identity: str) -> str:
    """Return the path of the device with that identity. Raises PortUnavailable where it is not plugged in."""
    if not identity or identity.startswith("device:"):
        return path
    device = next((port.device for port in discover_ports() if port.identity == identity), None)
    if device is None:
        raise PortUnavailable("ports.unplugged", port=path, identity=identity)
    return device


def _refuse_if_in_use(path: str, descriptor: SerialDescriptor) -> None:
    """Raise PortUnavailable where another program opened the device before us without a lock: a second master.

    The peer of a pty is no second master, so ptys are not checked.
    """
    if descriptor.capabilities.has_line_timing:
        for user in device_users({descriptor.device})[descriptor.device]:
            if user.pid != os.getpid():
                raise open_errors.in_use_error(path, user)


# --- open and configure ----------------------------------------------------------------------------------------------


def open_device(path: str, settings: SerialSettings, *, rs485: bool = False) -> SerialDescriptor:
    """Open, lock, configure and verify. Raises OSError (DeviceBusy with the owner's pid), or PortUnavailable."""
    device = os.path.realpath(path)
    fd = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        pty = is_pty(fd)
        lock = DeviceLock(fd, device, exclusive=not pty)
        try:
            return _configure_and_verify(fd, path, device, settings, lock, pty=pty, rs485=rs485)
        except BaseException:
            lock.release()
            raise
    except termios.error as error:
        os.close(fd)
        raise OSError(*error.args) from error
    except BaseException:
        os.close(fd)
        raise


def _configure_and_verify(
    fd: int, path: str, device: str, settings: SerialSettings, lock: DeviceLock, *, pty: bool, rs485: bool
) -> SerialDescriptor:
    serialx_adapter.configure(fd, device, _pty_settings(settings) if pty else settings)
    _apply_termios(fd, marks_line_errors=not pty)
    if not pty:
        _verify_termios(fd, path, settings)
    if rs485:
        _enable_rs485(fd, path)
    termios.tcflush(fd, termios.TCIFLUSH)  # bytes that came before the marks were on
    return SerialDescriptor(
        fd=fd,
        device=device,
        capabilities=Capabilities(
            has_line_timing=not pty, parity=not pty and settings.parity != "N", direction_control=rs485
        ),
        lock=lock,
        low_latency=latency_timer.set_low_latency(device),
        marks_line_errors=not pty,
    )


def _pty_settings(settings: SerialSettings) -> SerialSettings:
    """Return settings that a pty accepts: parity set again with no other change is EINVAL in the C library."""
    return replace(settings, parity="N", data_bits=8)


def is_pty(fd: int) -> bool:
    """Return whether this is a pty: it has no baud rate, and Linux drops parity and character size on it."""
    if sys.platform == "linux":
        return os.major(os.fstat(fd).st_rdev) in _UNIX98_SLAVES
    return os.ttyname(fd).startswith("/dev/ttys")


def _apply_termios(fd: int, *, marks_line_errors: bool) -> None:
    """Set raw mode, no flow control, modem lines kept on close, and marks for parity and framing errors.

    The marks are set without parity too: then they show framing errors (a wrong baud rate) and breaks.
    """
    attributes = termios.tcgetattr(fd)
    attributes[0] = termios.INPCK | termios.PARMRK if marks_line_errors else 0
    attributes[1] = 0
    attributes[2] &= ~(termios.HUPCL | termios.CRTSCTS | _CMSPAR)
    attributes[2] |= termios.CREAD | termios.CLOCAL
    attributes[3] = 0
    termios.tcsetattr(fd, termios.TCSANOW, attributes)


def _verify_termios(fd: int, path: str, settings: SerialSettings) -> None:
    """Read the settings back. Raises PortUnavailable with the settings requested and those of the driver."""
    iflag, oflag, cflag, lflag, _, speed, _ = termios.tcgetattr(fd)
    raw = iflag == termios.INPCK | termios.PARMRK and not oflag & termios.OPOST
    raw = raw and not lflag & (termios.ICANON | termios.ECHO | termios.ISIG | termios.IEXTEN)
    if not raw or cflag & (termios.CRTSCTS | _CMSPAR):
        reported = f"iflag {iflag:#x}, oflag {oflag:#x}, cflag {cflag:#x}, lflag {lflag:#x}"
        raise PortUnavailable("ports.flags", port=path, found=reported)
    if _format(cflag) != settings.format:
        raise PortUnavailable("ports.format_readback", port=path, expected=settings.format, found=_format(cflag))
    baud = _baud(fd, speed)
    if baud is not None and abs(baud - settings.baud) > settings.baud * BAUD_TOLERANCE:
        raise PortUnavailable("ports.baud_readback", port=path, expected=settings.baud, found=baud)


def _format(cflag: int) -> str:
    bits = {termios.CS5: 5, termios.CS6: 6, termios.CS7: 7, termios.CS8: 8}[cflag & termios.CSIZE]
    parity = "N" if not cflag & termios.PARENB else "O" if cflag & termios.PARODD else "E"
    return f"{bits}{parity}{2 if cflag & termios.CSTOPB else 1}"


def _baud(fd: int, speed: int) -> int | None:
    """Return the rate that the driver reports; None where this system reports none."""
    if sys.platform == "linux" and os.uname().machine.startswith(_GENERIC_MACHINES):
        with contextlib.suppress(OSError):
            return int(struct.unpack_from("=I", fcntl.ioctl(fd, _TCGETS2, bytes(44)), 40)[0])
    names = (name for name in dir(termios) if name[0] == "B" and name[1:].isdigit())
    return next((int(name[1:]) for name in names if getattr(termios, name) == speed), None)


def _enable_rs485(fd: int, path: str) -> None:
    """Let the kernel switch the RS485 driver with RTS. Raises PortUnavailable where it can't."""
    wanted = _RS485_ENABLED | _RS485_RTS_ON_SEND
    try:
        if sys.platform != "linux" or not os.uname().machine.startswith(_GENERIC_MACHINES):
            raise OSError
        fcntl.ioctl(fd, _TIOCSRS485, struct.pack("=3I5I", wanted, 0, 0, 0, 0, 0, 0, 0))
        flags = struct.unpack_from("=I", fcntl.ioctl(fd, _TIOCGRS485, bytes(32)))[0]
    except OSError as error:
        raise PortUnavailable("ports.rs485", port=path) from error
    if not flags & _RS485_ENABLED:
        raise PortUnavailable("ports.rs485", port=path)
