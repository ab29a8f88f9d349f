"""A serial device opened on a POSIX system: locked, set up, its settings read back and enforced. Blocking calls only.

Python's usual way to open a port clears INPCK, so that the kernel passes a byte with bad parity as good; for DZB100
parity is the only check there is. Here INPCK | PARMRK is set on every real port and proved by reading back (F07).
"""

# ruff: noqa: E402  # the assertion below must come first: type checkers stop there on Windows

from __future__ import annotations

import contextlib
import os
import struct
import sys
from dataclasses import dataclass, replace
from pathlib import Path

assert sys.platform != "win32"

import fcntl
import termios

from drivebus.errors import PortUnavailable
from drivebus.ports import serialx_adapter
from drivebus.ports.base import Capabilities
from drivebus.ports.locks import DeviceLock
from drivebus.serial_settings import SerialSettings

_TCGETS2 = 0x802C542A
_TIOCSRS485, _TIOCGRS485 = 0x542F, 0x542E
"""asm-generic numbers (x86, ARM, RISC-V); other machines have others and are not asked."""
_GENERIC_MACHINES = ("x86_64", "i", "aarch64", "arm", "riscv")
_RS485_ENABLED, _RS485_RTS_ON_SEND = 1, 2
"""struct serial_rs485: flags, delays before and after send in ms, padding (kernel serial-rs485.rst)."""
_CMSPAR = 0o10000000000
_UNIX98_SLAVES = range(136, 144)
"""Major numbers of Linux ptys."""
TTY_CLASS = Path("/sys/class/tty")
BAUD_TOLERANCE = 0.02
"""A driver may round to its own divisors; a UART tolerates about 4 % between both ends, so each may err by half."""


@dataclass(slots=True)
class SerialDescriptor:
    """An open device and what is true of it."""

    fd: int
    device: str
    capabilities: Capabilities
    lock: DeviceLock
    low_latency: bool
    marks_line_errors: bool
    """INPCK | PARMRK is in force: the bytes need decoding."""

    def close(self) -> None:
        """Release and close. A real port sends what the kernel still holds. Idempotent."""
        fd, self.fd = self.fd, -1
        if fd >= 0:
            self.lock.release()
            os.close(fd)


def open_device(path: str, settings: SerialSettings, *, rs485: bool = False) -> SerialDescriptor:
    """Open, lock, set up and prove. Raises OSError (Busy with the owner's pid), or PortUnavailable (F07)."""
    device = os.path.realpath(path)
    fd = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        pty = is_pty(fd)
        lock = DeviceLock(fd, device, exclusive=not pty)
        try:
            return _configured(fd, path, device, settings, lock, pty=pty, rs485=rs485)
        except BaseException:
            lock.release()
            raise
    except termios.error as error:
        os.close(fd)
        raise OSError(*error.args) from error
    except BaseException:
        os.close(fd)
        raise


def _configured(
    fd: int, path: str, device: str, settings: SerialSettings, lock: DeviceLock, *, pty: bool, rs485: bool
) -> SerialDescriptor:
    serialx_adapter.configure(fd, device, _pty_settings(settings) if pty else settings)
    _apply_termios(fd, marks_line_errors=not pty)
    if not pty:
        _verify_termios(fd, path, settings)
    if rs485:
        _enable_rs485(fd, path)
    termios.tcflush(fd, termios.TCIFLUSH)  # what came before the marks were on
    capabilities = Capabilities(not pty, not pty and settings.parity != "N", rs485)
    return SerialDescriptor(fd, device, capabilities, lock, _set_low_latency(device), marks_line_errors=not pty)


def _pty_settings(settings: SerialSettings) -> SerialSettings:
    """What a pty can take: asked for parity again, with nothing else to change, the C library answers EINVAL."""
    return replace(settings, parity="N", data_bits=8)


def is_pty(fd: int) -> bool:
    """Ptys have no baud, and the Linux kernel drops PARENB and character size on them (ruling 9)."""
    if sys.platform == "linux":
        return os.major(os.fstat(fd).st_rdev) in _UNIX98_SLAVES
    return os.ttyname(fd).startswith("/dev/ttys")


def _apply_termios(fd: int, *, marks_line_errors: bool) -> None:
    """Raw, no flow control, modem lines kept on close; marks for parity and framing errors.

    Marks are set without parity too: then they tell framing errors (a wrong baud rate) and breaks.
    """
    attributes = termios.tcgetattr(fd)
    attributes[0] = termios.INPCK | termios.PARMRK if marks_line_errors else 0
    attributes[1] = 0
    attributes[2] &= ~(termios.HUPCL | termios.CRTSCTS | _CMSPAR)
    attributes[2] |= termios.CREAD | termios.CLOCAL
    attributes[3] = 0
    termios.tcsetattr(fd, termios.TCSANOW, attributes)


def _verify_termios(fd: int, path: str, settings: SerialSettings) -> None:
    """Read back and compare. Raises PortUnavailable with what was asked for and what the driver made of it."""
    iflag, oflag, cflag, lflag, _, speed, _ = termios.tcgetattr(fd)
    raw = iflag == termios.INPCK | termios.PARMRK and not oflag & termios.OPOST
    raw = raw and not lflag & (termios.ICANON | termios.ECHO | termios.ISIG | termios.IEXTEN)
    if not raw or cflag & (termios.CRTSCTS | _CMSPAR):
        found = f"iflag {iflag:#x}, oflag {oflag:#x}, cflag {cflag:#x}, lflag {lflag:#x}"
        raise PortUnavailable("ports.flags", port=path, found=found)
    if _format(cflag) != settings.format:
        raise PortUnavailable("ports.format-readback", port=path, expected=settings.format, found=_format(cflag))
    baud = _baud(fd, speed)
    if baud is not None and abs(baud - settings.baud) > settings.baud * BAUD_TOLERANCE:
        raise PortUnavailable("ports.baud-readback", port=path, expected=settings.baud, found=baud)


def _format(cflag: int) -> str:
    bits = {termios.CS5: 5, termios.CS6: 6, termios.CS7: 7, termios.CS8: 8}[cflag & termios.CSIZE]
    parity = "N" if not cflag & termios.PARENB else "O" if cflag & termios.PARODD else "E"
    return f"{bits}{parity}{2 if cflag & termios.CSTOPB else 1}"


def _baud(fd: int, speed: int) -> int | None:
    """The rate that the driver says it uses; None where this system can't tell."""
    if sys.platform == "linux" and os.uname().machine.startswith(_GENERIC_MACHINES):
        with contextlib.suppress(OSError):
            return int(struct.unpack_from("=I", fcntl.ioctl(fd, _TCGETS2, bytes(44)), 40)[0])
    names = (name for name in dir(termios) if name[0] == "B" and name[1:].isdigit())
    return next((int(name[1:]) for name in names if getattr(termios, name) == speed), None)


def _enable_rs485(fd: int, path: str) -> None:
    """Let the kernel switch the RS485 driver with RTS. Raises PortUnavailable where it can't: the user asked for it."""
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


def _set_low_latency(device: str) -> bool:
    """FTDI hands bytes over each 16 ms unless its latency timer is 1 (F04). True if it is known to be short."""
    timer = TTY_CLASS / Path(device).name / "device" / "latency_timer"
    try:
        if int(timer.read_text()) > 1:
            timer.write_text("1")
        return int(timer.read_text()) <= 1
    except (OSError, ValueError):
        return not timer.exists()
