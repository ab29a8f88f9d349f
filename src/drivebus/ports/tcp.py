"""A raw TCP serial server: bytes over the network, line settings made on the server itself.

``paced`` and ``parity`` are False: the network batches bytes, and nobody tells us of a parity error (ruling 9). The
baud rate of the LINK must be the server's own: the timing of the bus is computed from it.
"""

from __future__ import annotations

from drivebus.errors import PortLost, PortUnavailable
from drivebus.ports.base import Capabilities, EchoSetting, Receiver
from drivebus.ports.tcp_connection import CONNECT_TIMEOUT_S, TcpConnection
from drivebus.ports.url import PortUrl


class TcpPort:
    """``tcp://HOST:PORT?baud=…&format=…&timeout=3``."""

    def __init__(self, link: PortUrl) -> None:
        link.reject_unknown_options("echo", "timeout")
        self.settings = link.settings
        self.capabilities = Capabilities()
        self.echo: EchoSetting = link.echo()
        self.url = link.text
        self.identity = f"tcp:{link.host}:{link.port}"
        self._host, self._port = link.host, link.port or 0
        self._timeout_s = link.number("timeout", CONNECT_TIMEOUT_S, 0.1, 60)
        self._connection: TcpConnection | None = None

    async def open(self, receiver: Receiver) -> None:
        """Connect. Raises PortUnavailable with why and what to do."""
        if self._connection is not None:
            raise PortUnavailable("ports.already-open", port=self.identity)

        def lost(error: PortLost) -> None:
            self._connection = None
            receiver.port_lost(error)

        connection = TcpConnection(self.identity, receiver.data_received, lost)
        await connection.connect(self._host, self._port, self._timeout_s)
        self._connection = connection

    def write(self, data: bytes, /) -> None:
        """Raises PortLost; the receiver then hears of it once, later."""
        if self._connection is None:
            raise PortLost("ports.not-open", port=self.identity)
        self._connection.write(data)

    async def close(self) -> None:
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()


def open_port(link: PortUrl) -> TcpPort:
    """The factory of scheme ``tcp``. Raises PortUrlError."""
    return TcpPort(link)
