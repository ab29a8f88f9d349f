"""USB adapters that are unplugged and replugged under another name: a simulated one, and real ptys."""

from __future__ import annotations

import asyncio
import os
import tempfile
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from random import Random
from typing import Any

from drivebus.errors import PortLost, PortUnavailable
from drivebus.ports import discovery, open_port, serialx_adapter
from drivebus.ports import tty as serial_tty
from drivebus.types import Receiver

# --- simulated adapter ------------------------------------------------------------------------------------------------

DEVICE_NAMES = tuple(f"/dev/ttyUSB{number}" for number in range(6))
FTDI, CH340 = (0x0403, 0x6001), (0x1A86, 0x7523)


_DEVICE_MODULE: Any = serial_tty
"""Module in which the product looks up the connected devices."""


@dataclass(slots=True)
class UsbHost:
    """Simulated host: the connected adapters with their names and serial numbers."""

    rng: Random
    serial: str | None
    """Serial number of the bus's adapter; None: it has none and is identified by its socket."""
    name: str = DEVICE_NAMES[0]
    """Device name of the bus's adapter; "" while it is unplugged."""
    other_adapters: dict[str, str] = field(default_factory=dict)
    """Other adapters: name → serial number."""

    def unplug(self) -> None:
        """Unplug the adapter; at random another adapter takes its name or disappears."""
        name, self.name = self.name, ""
        if len(self.other_adapters) > len(DEVICE_NAMES) // 2 or (self.other_adapters and self.rng.random() < 0.5):
            self.other_adapters.pop(self.rng.choice(sorted(self.other_adapters)))
        if self.rng.random() < 0.5:
            self.other_adapters[name] = f"STRANGER{len(self.other_adapters)}"

    def replug(self) -> str:
        """Plug the adapter in under a random free name; return the name."""
        self.name = self.rng.choice([name for name in DEVICE_NAMES if name not in self.other_adapters])
        return self.name

    @contextmanager
    def patched_ports(self) -> Iterator[None]:
        """Let the product discover the ports of this host within the context."""
        real, _DEVICE_MODULE.discover_ports = _DEVICE_MODULE.discover_ports, self._ports
        try:
            yield
        finally:
            _DEVICE_MODULE.discover_ports = real

    def _ports(self) -> list[discovery.PortInfo]:
        ours = [self._device(self.name, self.serial, FTDI if self.serial else CH340)] if self.name else []
        others = [self._device(name, serial, FTDI) for name, serial in sorted(self.other_adapters.items())]
        sockets = {self.name: "/dev/serial/by-path/pci-0000:00:14.0-usb-0:2:1.0-port0"} if self.name else {}
        return discovery.describe([*ours, *others], {}, sockets)

    def _device(self, name: str, serial: str | None, kind: tuple[int, int]) -> serialx_adapter.Device:
        vid, pid = kind
        return serialx_adapter.Device(name, name, vid, pid, serial, "maker", "adapter", None, None, 0)


class UsbAdapter:
    """Port that finds its device by identity as the product does, and counts its openings."""

    def __init__(self, port: Any, machine: UsbHost) -> None:
        self._port, self.machine = port, machine
        self._identity = ""
        self._receiver: Receiver | None = None
        self._fails_on_write = False
        """Whether the adapter was unplugged without a hang-up, so that only a write fails."""
        self.opened = self.closed = 0
        self.opened_names: list[str] = []
        """Device names under which the port was opened."""

    def __getattr__(self, name: str) -> Any:
        return getattr(self._port, name)

    @property
    def identity(self) -> str:
        return self._identity

    async def open(self, receiver: Receiver) -> None:
        with self.machine.patched_ports():
            name = serial_tty.find_device(DEVICE_NAMES[0], self._identity)
            if name != self.machine.name and name not in self.machine.other_adapters:
                raise PortUnavailable("ports.unplugged", port=name, identity=self._identity)
            identity = self._identity or serial_tty.identify(name)
        self.opened_names.append(name)
        if name == self.machine.name:
            await self._port.open(receiver)
        self._identity, self._receiver, self._fails_on_write = identity, receiver, False
        self.opened += 1

    def write(self, data: bytes, /) -> None:
        if not self._fails_on_write:
            return self._port.write(data)  # type: ignore[no-any-return]
        error = PortLost("ports.lost", port=DEVICE_NAMES[0], reason="Input/output error")
        if self._receiver is not None:
            asyncio.get_running_loop().call_soon(self._receiver.port_lost, error)
            self._receiver = None
        raise error

    def unplug(self, *, hangs_up: bool) -> None:
        """Unplug the adapter; ``hangs_up``: the kernel reports it at once, else the next write fails."""
        self.machine.unplug()
        self._fails_on_write = not hangs_up
        if hangs_up:
            self._port.simulated_bus.unplug()
        else:
            self._port.simulated_bus.wire.plugged = False
            self._port.simulated_bus.wire.discard_pending()

    def replug(self) -> str:
        name = self.machine.replug()
        self._port.simulated_bus.replug()
        return name

    async def close(self) -> None:
        if self.opened > self.closed:
            self.closed += 1
        self._receiver = None
        await self._port.close()


# --- real ports -------------------------------------------------------------------------------------------------------

ADAPTER_SERIAL = "usb:0403:6001:FT4ZK1X9:0"
WARM_UP_OPENINGS = 10
"""Openings before the descriptors are counted; the first ones create executor threads."""
PORT_LOSS_TIMEOUT_S = 5.0


class PortLossReceiver:
    """Receiver that waits for the loss of the port."""

    def __init__(self) -> None:
        self.lost = asyncio.Event()

    def data_received(self, data: bytes, line_errors: int = 0) -> None: ...

    def port_lost(self, error: PortLost) -> None:
        self.lost.set()


def reopen_ports(times: int) -> dict[str, Any]:
    """Open a port on a new pty ``times`` times; return the numbers of leaked descriptors and of device names."""
    previous = os.environ.get("XDG_STATE_HOME")
    with tempfile.TemporaryDirectory() as folder:
        os.environ["XDG_STATE_HOME"] = folder  # lock files
        try:
            return asyncio.run(_reopen_repeatedly(times))
        finally:
            if previous is None:
                del os.environ["XDG_STATE_HOME"]
            else:
                os.environ["XDG_STATE_HOME"] = previous


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
            receiver = PortLossReceiver()
            await port.open(receiver)
        for descriptor in (master, other):
            if descriptor >= 0:
                os.close(descriptor)
        at = asyncio.get_running_loop().time()
        await asyncio.wait_for(receiver.lost.wait(), PORT_LOSS_TIMEOUT_S)
        slowest_s = max(slowest_s, asyncio.get_running_loop().time() - at)
        await port.close()
    return {"descriptors": _descriptors() - before, "names": len(names), "slowest_s": slowest_s}


def _pty() -> tuple[int, str]:
    """Return the master descriptor and the terminal name of a new pty."""
    master, slave = os.openpty()
    tty.setraw(slave)
    path = os.ttyname(slave)
    os.close(slave)
    return master, path


@contextmanager
def _patched_ports(path: str) -> Iterator[None]:
    """Let the product discover this terminal as the adapter within the context."""
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
