"""Adapter for serialx, the only module that imports it: configure a descriptor, open a Windows port, list devices.

serialx raises RTS and DTR on open and lowers them on close; on adapters whose driver is switched by RTS that would
block the bus. Here both stay as they are.
"""

from __future__ import annotations

import asyncio
import errno
from typing import Any, cast

import serialx

from drivebus.serial_settings import SerialSettings

Device = serialx.SerialPortInfo
_UNCHANGED = serialx.PinState.UNDEFINED


def list_devices() -> list[Device]:
    """Return the serial devices of this machine."""
    return serialx.list_serial_ports()


def has_unique_serial_number(device: Device) -> bool:
    """Return whether the serial number distinguishes an adapter from others of its kind (a CH340 has none)."""
    return not serialx.is_non_unique_serial(device.serial_number)


def configure(fd: int, path: str, settings: SerialSettings) -> None:
    """Apply serial settings to an open POSIX descriptor, low latency where the driver permits it. Raises OSError."""
    try:
        _configure(fd, path, settings)
    except OSError as error:
        if error.errno in (errno.EIO, errno.ENXIO, errno.ENODEV, errno.ENOTTY, errno.EBADF):
            raise
        _configure(fd, path, settings, low_latency=False)  # a driver that refuses TIOCSSERIAL


def _configure(fd: int, path: str, settings: SerialSettings, **latency: bool) -> None:
    """Configure with VMIN 1, VTIME 0: a read without data is EAGAIN, so that an empty read means a hang-up."""
    posix = cast(Any, serialx.Serial)  # its annotation is the base class; the POSIX one takes a descriptor
    port = posix(
        path,
        settings.baud,
        fileno=fd,
        parity=settings.parity,
        stopbits=settings.stop_bits,
        byte_size=settings.data_bits,
        exclusive=False,
        rts_on_open=_UNCHANGED,
        dtr_on_open=_UNCHANGED,
        rts_on_close=_UNCHANGED,
        dtr_on_close=_UNCHANGED,
        min_read_size=1,
        inter_byte_timeout=0,
        **(latency if posix.__name__ == "LinuxSerial" else {}),
    )
    try:
        port.reconfigure_port(baudrate=settings.baud)
    except serialx.UnsupportedSetting as error:
        raise OSError(errno.EINVAL, str(error)) from error


async def connect_windows(path: str, settings: SerialSettings, protocol: asyncio.Protocol) -> asyncio.Transport:
    """Open a COM port exclusively on a proactor loop. Raises OSError."""
    transport, _ = await serialx.create_serial_connection(
        asyncio.get_running_loop(),
        lambda: protocol,
        path,
        settings.baud,
        serialx.Parity(settings.parity),
        serialx.StopBits(settings.stop_bits),
        exclusive=True,
        byte_size=settings.data_bits,
        rts_on_open=_UNCHANGED,
        dtr_on_open=_UNCHANGED,
        rts_on_close=_UNCHANGED,
        dtr_on_close=_UNCHANGED,
    )
    return transport
