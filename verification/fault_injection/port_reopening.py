"""Real serial ports on real ptys, opened, hung up and opened again under another name: how many descriptors stay."""

from __future__ import annotations

import asyncio
import os
import tempfile
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from drivebus.errors import PortLost
from drivebus.ports import discovery, open_port
from drivebus.ports import tty as serial_tty

ADAPTER_SERIAL = "usb:0403:6001:FT4ZK1X9:0"
WARM_UP_OPENINGS = 10
"""Executor threads and the like are made in the first few."""
PORT_LOSS_TIMEOUT_S = 5.0


_DEVICE_MODULE: Any = serial_tty
"""Where the product looks for what is plugged in."""


class PortLossReceiver:
    """Hears that the port is lost."""

    def __init__(self) -> None:
        self.lost = asyncio.Event()

    def data_received(self, data: bytes, marks: int = 0) -> None: ...

    def port_lost(self, error: PortLost) -> None:
        self.lost.set()


def reopen_ports(times: int) -> dict[str, Any]:
    """Open as often on a fresh pty each. ``descriptors``: how many more are open afterwards; ``names``: how many."""
    kept = os.environ.get("XDG_STATE_HOME")
    with tempfile.TemporaryDirectory() as folder:
        os.environ["XDG_STATE_HOME"] = folder  # lock files
        try:
            return asyncio.run(_reopen_repeatedly(times))
        finally:
            if kept is None:
                del os.environ["XDG_STATE_HOME"]
            else:
                os.environ["XDG_STATE_HOME"] = kept


async def _reopen_repeatedly(times: int) -> dict[str, Any]:
    port: Any = None
    before, names, slowest_s = 0, set(), 0.0
    for turn in range(WARM_UP_OPENINGS + times):
        if turn == WARM_UP_OPENINGS:
            before = _descriptors()
        other = _pty()[0] if turn % 2 else -1  # it takes the name that has become free
        master, path = _pty()
        names.add(path)
        with _patched_ports(path):
            port = port or open_port(path)
            ear = PortLossReceiver()
            await port.open(ear)
        for descriptor in (master, other):
            if descriptor >= 0:
                os.close(descriptor)
        at = asyncio.get_running_loop().time()
        await asyncio.wait_for(ear.lost.wait(), PORT_LOSS_TIMEOUT_S)
        slowest_s = max(slowest_s, asyncio.get_running_loop().time() - at)
        await port.close()
    return {"descriptors": _descriptors() - before, "names": len(names), "slowest_s": slowest_s}


def _pty() -> tuple[int, str]:
    """Its master, and the name of the terminal."""
    master, slave = os.openpty()
    tty.setraw(slave)
    path = os.ttyname(slave)
    os.close(slave)
    return master, path


@contextmanager
def _patched_ports(path: str) -> Iterator[None]:
    """The adapter is known by its serial number, whatever its name."""
    real = _DEVICE_MODULE.discover_ports
    _DEVICE_MODULE.discover_ports = lambda: [
        discovery.PortInfo(device=path, description="", identity=ADAPTER_SERIAL, url=path)
    ]
    try:
        yield
    finally:
        _DEVICE_MODULE.discover_ports = real


def _descriptors() -> int:
    return len(os.listdir("/proc/self/fd"))  # noqa: PTH208
