"""A USB adapter that is pulled and comes back under another name, in front of a simulated bench.

The machine's list of devices is the laboratory's; what the product makes of it (``ports.listing``, ``ports.device``) is
real: which identity a device has, and where the device with an identity is now.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from random import Random
from typing import Any

from drivebus.errors import PortLost, PortUnavailable
from drivebus.ports import discovery, serialx_adapter, tty
from drivebus.types import Receiver

DEVICE_NAMES = tuple(f"/dev/ttyUSB{number}" for number in range(6))
FTDI, CH340 = (0x0403, 0x6001), (0x1A86, 0x7523)


_DEVICE_MODULE: Any = tty
"""Where the product looks for what is plugged in."""


@dataclass(slots=True)
class UsbHost:
    """What is plugged into which socket, and the name that the kernel gave it."""

    rng: Random
    serial: str | None
    """Of our adapter; None: it has none of its own, and is known by its socket."""
    name: str = DEVICE_NAMES[0]
    """Of our adapter; "" while it is pulled."""
    other_adapters: dict[str, str] = field(default_factory=dict)
    """Adapters of others: name → serial number."""

    def unplug(self) -> None:
        """Now and then another adapter takes the name that has become free, or another one goes."""
        name, self.name = self.name, ""
        if len(self.other_adapters) > len(DEVICE_NAMES) // 2 or (self.other_adapters and self.rng.random() < 0.5):
            self.other_adapters.pop(self.rng.choice(sorted(self.other_adapters)))
        if self.rng.random() < 0.5:
            self.other_adapters[name] = f"STRANGER{len(self.other_adapters)}"

    def replug(self) -> str:
        """The kernel gives it any free name; which."""
        self.name = self.rng.choice([name for name in DEVICE_NAMES if name not in self.other_adapters])
        return self.name

    @contextmanager
    def patched_ports(self) -> Iterator[None]:
        """The product sees this machine."""
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
    """The bus's port: finds its device as ``ports.device.open_same`` does. Counts what is open."""

    def __init__(self, port: Any, machine: UsbHost) -> None:
        self._port, self.machine = port, machine
        self._identity = ""
        self._receiver: Receiver | None = None
        self._fails_on_write = False
        """Pulled without a hang-up: only writing to it tells."""
        self.opened = self.closed = 0
        self.opened_names: list[str] = []
        """The names under which it was opened."""

    def __getattr__(self, name: str) -> Any:
        return getattr(self._port, name)

    @property
    def identity(self) -> str:
        return self._identity

    async def open(self, receiver: Receiver) -> None:
        with self.machine.patched_ports():
            name = tty.find_device(DEVICE_NAMES[0], self._identity)
            if name != self.machine.name and name not in self.machine.other_adapters:
                raise PortUnavailable("ports.unplugged", port=name, identity=self._identity)
            identity = self._identity or tty.identify(name)
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

    def unplug(self, hangs_up: bool) -> None:
        """``hangs_up``: the kernel tells at once; else a write is the first to notice."""
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
