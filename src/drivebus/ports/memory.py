"""Two ports connected in memory, for tests and for programs without hardware.

Not modelled: parity, framing errors, collisions, echo, noise, half duplex (each direction has its own wire) and the
buffers of the operating system. With ``line_timing=on`` each byte arrives when its last stop bit would, by the event
loop's own clock, so that a virtual loop gives exact durations; without, whole chunks arrive at the next turn.
"""

from __future__ import annotations

import asyncio
from weakref import WeakValueDictionary

from drivebus.errors import PortLost, PortUnavailable, PortUrlError
from drivebus.ports.url import PortUrl
from drivebus.serial_settings import SerialSettings
from drivebus.types import Capabilities, EchoSetting, Receiver


class _Wire:
    """State shared by both ends. Ends opened by name are handed out once each."""

    __slots__ = ("__weakref__", "ends", "opened_ends", "plugged")

    def __init__(self) -> None:
        self.ends: list[MemoryPort] = []
        self.plugged = True
        self.opened_ends = 0


class MemoryPort:
    """End of a pair of ports; see ``create_pair``."""

    def __init__(self, wire: _Wire, name: str, settings: SerialSettings, *, has_line_timing: bool) -> None:
        self.settings = settings
        self.capabilities = Capabilities(has_line_timing=has_line_timing)
        self.echo: EchoSetting = "off"
        self._wire = wire
        self._name = name
        self._receiver: Receiver | None = None
        self._open_count = 0
        """Openings and closings so far: bytes of an earlier opening are dropped."""
        self._free_at = 0.0
        wire.ends.append(self)

    @property
    def identity(self) -> str:
        return f"memory:{self._name}"

    @property
    def url(self) -> str:
        return f"memory://{self._name}"

    @property
    def peer(self) -> MemoryPort:
        """The other end."""
        left, right = self._wire.ends
        return right if self is left else left

    async def open(self, receiver: Receiver) -> None:
        """Raises PortUnavailable while unplugged or already open."""
        if not self._wire.plugged:
            raise PortUnavailable("ports.memory_unplugged", port=self.url)
        if self._receiver is not None:
            raise PortUnavailable("ports.already_open", port=self.url)
        self._receiver = receiver
        self._open_count += 1
        self._free_at = 0.0

    def write(self, data: bytes, /) -> None:
        """Send to the peer; bytes to a peer that is not open are lost. Raises PortLost where the port is not open."""
        if self._receiver is None:
            raise PortLost("ports.not_open", port=self.url)
        loop = asyncio.get_running_loop()
        peer = self.peer
        if not self.capabilities.has_line_timing:
            loop.call_soon(peer._deliver, bytes(data), peer._open_count)
            return
        at = max(loop.time(), self._free_at)
        for index in range(len(data)):
            at += self.settings.character_s
            loop.call_at(at, peer._deliver, data[index : index + 1], peer._open_count)
        self._free_at = at

    async def close(self) -> None:
        """Close; bytes on their way to this end are dropped."""
        self._receiver = None
        self._open_count += 1

    def unplug(self) -> None:
        """Let both ends lose their port; they can't be opened until ``plug``."""
        self._wire.plugged = False
        for end in self._wire.ends:
            end._lose()

    def plug(self) -> None:
        """Make the pair openable again."""
        self._wire.plugged = True

    def _lose(self) -> None:
        receiver, self._receiver = self._receiver, None
        self._open_count += 1
        if receiver is not None:
            receiver.port_lost(PortLost("ports.lost", port=self.url, reason=PortLost("ports.pulled")))

    def _deliver(self, data: bytes, open_count: int) -> None:
        if self._receiver is not None and open_count == self._open_count:
            self._receiver.data_received(data)


_named: WeakValueDictionary[str, _Wire] = WeakValueDictionary()


def create_pair(
    settings: SerialSettings | None = None,
    *,
    has_line_timing: bool = False,
    name: str = "pair",
) -> tuple[MemoryPort, MemoryPort]:
    """Return two connected ports, not yet opened: each receives what the other writes."""
    wire = _Wire()
    settings = settings or SerialSettings()
    return MemoryPort(wire, name, settings, has_line_timing=has_line_timing), MemoryPort(
        wire, name, settings, has_line_timing=has_line_timing
    )


def open_port(url: PortUrl) -> MemoryPort:
    """Return an end of ``memory://NAME``: two callers get one each. Raises PortUrlError for a third."""
    url.reject_unknown_options("line_timing", "echo")
    wire = _named.get(url.path)
    if wire is None:
        left, _ = create_pair(url.settings, has_line_timing=url.flag("line_timing"), name=url.path)
        wire = _named[url.path] = left._wire
    if wire.opened_ends == 2:
        raise PortUrlError("ports.memory_taken", port=url.text, name=url.path)
    port = wire.ends[wire.opened_ends]
    if "echo" in url.options:
        port.echo = url.echo()
    wire.opened_ends += 1
    return port
