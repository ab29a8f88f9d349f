"""A bench behind a TCP port, as a raw serial server. Real time, paced at the line's own baud rate.

Each connection is a host of its own: two of them are two masters. Unplugging closes the connections and the port.
"""

from __future__ import annotations

import asyncio
import socket

from drivebus.serial_settings import SerialSettings
from drivebus.simulator.bus import SimulatedBus

TCP_JITTER_S = 0.001
"""By how much network and operating system may shorten a silence that a host kept."""


class _TcpMaster(asyncio.Protocol):
    """One host. A TCP client has no line settings that could be wrong."""

    settings: SerialSettings | None = None

    def __init__(self, bench: SimulatedBus) -> None:
        self._bench = bench
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        connected = transport.get_extra_info("socket")
        if connected is not None:
            connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if self._bench.wire.plugged:
            self._bench.attach(self)
        else:
            transport.abort()

    def data_received(self, data: bytes) -> None:
        self._bench.transmit(self, data)

    def connection_lost(self, error: Exception | None) -> None:
        self._transport = None
        self._bench.detach(self)

    def receive(self, data: bytes, marks: int) -> None:
        if self._transport is not None:
            self._transport.write(data)

    def on_unplugged(self) -> None:
        if self._transport is not None:
            self._transport.abort()


class TcpServer:
    """A listening bench. Made by ``serve_tcp``."""

    def __init__(self, bench: SimulatedBus, server: asyncio.Server, host: str) -> None:
        self.simulated_bus = bench
        self.host = host
        self._server = server

    @property
    def port(self) -> int:
        """The port that is listened on, also where 0 was asked for."""
        found: int = self._server.sockets[0].getsockname()[1]
        return found

    @property
    def url(self) -> str:
        return f"tcp://{self.host}:{self.port}?baud={self.simulated_bus.settings.baud}&format={self.simulated_bus.settings.format}"

    async def close(self) -> None:
        """Stop listening and drop the connections of this bench's TCP hosts."""
        self._server.close()
        for host in list(self.simulated_bus.masters):
            if isinstance(host, _TcpMaster):
                self.simulated_bus.detach(host)
                host.on_unplugged()
        await self._server.wait_closed()


async def serve_tcp(bench: SimulatedBus, host: str = "127.0.0.1", port: int = 0) -> TcpServer:
    """Listen; port 0 takes a free one. Raises OSError where the port is taken."""
    loop = asyncio.get_running_loop()
    bench.set_jitter_tolerance(TCP_JITTER_S)
    server = await loop.create_server(lambda: _TcpMaster(bench), host, port)
    return TcpServer(bench, server, host)
