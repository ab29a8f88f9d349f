"""Simulated bus behind a TCP port, as a raw serial server, paced at its baud rate.

Every connection is a master of its own. Unplugging the bus closes the connections.
"""

from __future__ import annotations

import asyncio
import socket

from drivebus.serial_settings import SerialSettings
from drivebus.simulator.bus import SimulatedBus

TCP_JITTER_S = 0.001
"""Time by which network and operating system may shorten a silence."""


class _TcpMaster(asyncio.Protocol):
    """Master of one TCP connection, which has no serial settings."""

    settings: SerialSettings | None = None

    def __init__(self, bus: SimulatedBus) -> None:
        self._bus = bus
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        connected = transport.get_extra_info("socket")
        if connected is not None:
            connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if self._bus.wire.plugged:
            self._bus.attach(self)
        else:
            transport.abort()

    def data_received(self, data: bytes) -> None:
        self._bus.transmit(self, data)

    def connection_lost(self, error: Exception | None) -> None:
        self._transport = None
        self._bus.detach(self)

    def receive(self, data: bytes, line_errors: int) -> None:
        if self._transport is not None:
            self._transport.write(data)

    def on_unplugged(self) -> None:
        if self._transport is not None:
            self._transport.abort()


class TcpServer:
    """TCP server of a simulated bus. Created by ``serve_tcp``."""

    def __init__(self, bus: SimulatedBus, server: asyncio.Server, host: str) -> None:
        self.simulated_bus = bus
        self.host = host
        self._server = server

    @property
    def port(self) -> int:
        """Port number, also where port 0 was requested."""
        number: int = self._server.sockets[0].getsockname()[1]
        return number

    @property
    def url(self) -> str:
        return f"tcp://{self.host}:{self.port}?baud={self.simulated_bus.settings.baud}&format={self.simulated_bus.settings.format}"

    async def close(self) -> None:
        """Stop listening and close the connections."""
        self._server.close()
        for master in list(self.simulated_bus.masters):
            if isinstance(master, _TcpMaster):
                self.simulated_bus.detach(master)
                master.on_unplugged()
        await self._server.wait_closed()


async def serve_tcp(bus: SimulatedBus, host: str = "127.0.0.1", port: int = 0) -> TcpServer:
    """Serve a simulated bus; port 0 takes a free one. Raises OSError where the port is in use."""
    loop = asyncio.get_running_loop()
    bus.set_jitter_tolerance(TCP_JITTER_S)
    server = await loop.create_server(lambda: _TcpMaster(bus), host, port)
    return TcpServer(bus, server, host)
