"""A USB adapter that is pulled and comes back under another name, in front of a simulated bench (F12).

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
from drivebus.ports import device, door, listing
from drivebus.ports.port import Receiver

NAMES = tuple(f"/dev/ttyUSB{number}" for number in range(6))
FTDI, CH340 = (0x0403, 0x6001), (0x1A86, 0x7523)


_SEEN: Any = device
"""Where the product looks for what is plugged in."""


@dataclass(slots=True)
class Machine:
    """What is plugged into which socket, and the name that the kernel gave it."""

    rng: Random
    serial: str | None
    """Of our adapter; None: it has none of its own, and is known by its socket."""
    name: str = NAMES[0]
    """Of our adapter; "" while it is pulled."""
    strangers: dict[str, str] = field(default_factory=dict)
    """Adapters of others: name → serial number."""

    def pull(self) -> None:
        """Now and then another adapter takes the name that has become free, or another one goes."""
        name, self.name = self.name, ""
        if len(self.strangers) > len(NAMES) // 2 or (self.strangers and self.rng.random() < 0.5):
            self.strangers.pop(self.rng.choice(sorted(self.strangers)))
        if self.rng.random() < 0.5:
            self.strangers[name] = f"STRANGER{len(self.strangers)}"

    def put_back(self) -> str:
        """The kernel gives it any free name; which."""
        self.name = self.rng.choice([name for name in NAMES if name not in self.strangers])
        return self.name

    @contextmanager
    def listed(self) -> Iterator[None]:
        """The product sees this machine."""
        real, _SEEN.known_ports = _SEEN.known_ports, self._ports
        try:
            yield
        finally:
            _SEEN.known_ports = real

    def _ports(self) -> list[listing.PortInfo]:
        ours = [self._device(self.name, self.serial, FTDI if self.serial else CH340)] if self.name else []
        others = [self._device(name, serial, FTDI) for name, serial in sorted(self.strangers.items())]
        sockets = {self.name: "/dev/serial/by-path/pci-0000:00:14.0-usb-0:2:1.0-port0"} if self.name else {}
        return listing.describe([*ours, *others], {}, sockets)

    def _device(self, name: str, serial: str | None, kind: tuple[int, int]) -> door.Device:
        vid, pid = kind
        return door.Device(name, name, vid, pid, serial, "maker", "adapter", None, None, 0)


class Adapter:
    """The bus's port: finds its device as ``ports.device.open_same`` does. Counts what is open."""

    def __init__(self, port: Any, machine: Machine) -> None:
        self._port, self.machine = port, machine
        self._identity = ""
        self._receiver: Receiver | None = None
        self._mute = False
        """Pulled without a hang-up: only writing to it tells."""
        self.opened = self.closed = 0
        self.found: list[str] = []
        """The names under which it was opened."""

    def __getattr__(self, name: str) -> Any:
        return getattr(self._port, name)

    @property
    def identity(self) -> str:
        return self._identity

    async def open(self, receiver: Receiver) -> None:
        with self.machine.listed():
            name = device.find(NAMES[0], self._identity)
            if name != self.machine.name and name not in self.machine.strangers:
                raise PortUnavailable("ports.unplugged", port=name, identity=self._identity)
            identity = self._identity or device.identify(name)
        self.found.append(name)
        if name == self.machine.name:
            await self._port.open(receiver)
        self._identity, self._receiver, self._mute = identity, receiver, False
        self.opened += 1

    def write(self, data: bytes, /) -> None:
        if not self._mute:
            return self._port.write(data)  # type: ignore[no-any-return]
        error = PortLost("ports.lost", port=NAMES[0], reason="Input/output error")
        if self._receiver is not None:
            asyncio.get_running_loop().call_soon(self._receiver.port_lost, error)
            self._receiver = None
        raise error

    def pull(self, hangs_up: bool) -> None:
        """``hangs_up``: the kernel tells at once; else a write is the first to notice."""
        self.machine.pull()
        self._mute = not hangs_up
        if hangs_up:
            self._port.bench.unplug()
        else:
            self._port.bench.wire.plugged = False
            self._port.bench.wire.cut()

    def put_back(self) -> str:
        name = self.machine.put_back()
        self._port.bench.replug()
        return name

    async def close(self) -> None:
        if self.opened > self.closed:
            self.closed += 1
        self._receiver = None
        await self._port.close()
