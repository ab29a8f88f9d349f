"""Raw TCP serial servers, and the TCP connection that ``rfc2217`` uses too.

The serial settings are made on the server itself; the port URL has the same baud rate, because bus timing is computed
from it. Line timing and parity checks are lost: the network batches bytes and no parity error is reported.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from contextlib import suppress

from drivebus.errors import PortLost, PortUnavailable, SystemReason
from drivebus.ports.url import PortUrl
from drivebus.types import Capabilities, EchoSetting, Receiver

TCP_STALL_TIMEOUT_S = 2.0  # the expiry of a start command
CONNECT_TIMEOUT_S = 3.0  # default of the option ``timeout``: a serial server on the same site answers in milliseconds
SEND_BUFFER_BYTES = 4096  # small, so that a peer that accepts nothing is noticed at once
_KEEPALIVE = {  # a vanished server is noticed within 11 s of silence, on Linux within 2 s of a frame not acknowledged
    "TCP_KEEPIDLE": 5,
    "TCP_KEEPINTVL": 2,
    "TCP_KEEPCNT": 3,
    "TCP_USER_TIMEOUT": int(TCP_STALL_TIMEOUT_S * 1000),
}


class TcpConnection(asyncio.Protocol):
    """TCP connection of a port. ``on_lost`` is called once, unless ``close`` was called first.

    It is dropped, with the bytes that it still holds, when the peer has accepted nothing for ``TCP_STALL_TIMEOUT_S``: a
    start could reach the drive long after it was requested.
    """

    def __init__(self, name: str, on_data: Callable[[bytes], None], on_lost: Callable[[PortLost], None]) -> None:
        self._name = name
        self._on_lost: Callable[[PortLost], None] | None = on_lost
        self._transport: asyncio.Transport | None = None
        self.data_received = on_data  # type: ignore[method-assign, assignment]  # one call less for each chunk

    async def connect(self, host: str, port: int, timeout_s: float) -> None:
        """Raises PortUnavailable with the reason and the remedy."""
        try:
            async with asyncio.timeout(timeout_s):
                connected = await _connect(host, port)
                transport, _ = await asyncio.get_running_loop().create_connection(lambda: self, sock=connected)
        except TimeoutError as error:
            raise PortUnavailable("ports.net_timeout", port=self._name, seconds=timeout_s) from error
        except socket.gaierror as error:
            raise PortUnavailable("ports.net_name", port=self._name, host=host) from error
        except ConnectionRefusedError as error:
            raise PortUnavailable("ports.net_refused", port=self._name, number=port) from error
        except OSError as error:
            raise PortUnavailable("ports.net", port=self._name, reason=SystemReason(error)) from error
        self._transport = transport

    def write(self, data: bytes) -> None:
        """Raises PortLost where the connection is gone or still holds an earlier frame."""
        transport = self._transport
        if transport is None or transport.is_closing():
            raise PortLost("ports.not_open", port=self._name)
        if transport.get_write_buffer_size():
            transport.abort()
            raise PortLost("ports.lost", port=self._name, reason=PortLost("ports.stalled"))
        transport.write(data)

    def close(self) -> None:
        """Close the connection; the server still gets what was written. Idempotent."""
        self._on_lost = None
        transport, self._transport = self._transport, None
        if transport is not None:
            transport.close()

    def connection_lost(self, exc: Exception | None) -> None:
        on_lost, self._on_lost = self._on_lost, None
        self._transport = None
        if on_lost is not None:
            on_lost(PortLost("ports.lost", port=self._name, reason=_reason(exc)))


def _reason(exc: Exception | None) -> SystemReason | PortLost:
    return PortLost("ports.server_closed") if exc is None else SystemReason(exc)


async def _connect(host: str, port: int) -> socket.socket:
    """Try each address of the host in turn. Raises the error of the last address."""
    loop = asyncio.get_running_loop()
    failure: OSError | None = None
    for family, kind, protocol, _, address in await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM):
        sock = socket.socket(family, kind, protocol)
        try:
            sock.setblocking(False)
            _set_socket_options(sock)
            await loop.sock_connect(sock, address)
            return sock
        except OSError as error:
            sock.close()
            failure = error
        except BaseException:
            sock.close()
            raise
    raise failure or OSError("no address")


def _set_socket_options(sock: socket.socket) -> None:
    """Send frames at once and notice a dead peer."""
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
    for name, value in _KEEPALIVE.items():
        if hasattr(socket, name):  # each system has some of them
            with suppress(OSError):
                sock.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)


class SerialServerPort:
    """Attributes of a port behind a TCP connection."""

    def __init__(self, url: PortUrl) -> None:
        """Raises PortUrlError for an unknown option."""
        url.reject_unknown_options("echo", "timeout")
        self.settings = url.settings
        self.capabilities = Capabilities()
        self.echo: EchoSetting = url.echo()
        self.url = url.text
        self.identity = f"{url.scheme}:{url.host}:{url.port}"  # a key of stored counters and calibrations
        self._name = url.text.partition("?")[0]  # in messages, as the user writes it
        self._host, self._port = url.host, url.port or 0
        self._timeout_s = url.number("timeout", CONNECT_TIMEOUT_S, 0.1, 60)
        self._connection: TcpConnection | None = None


class TcpPort(SerialServerPort):
    """Port of a raw TCP serial server: ``tcp://HOST:PORT?baud=…&format=…&timeout=3``."""

    async def open(self, receiver: Receiver) -> None:
        """Connect to the converter. Raises PortUnavailable with the reason and the remedy."""
        if self._connection is not None:
            raise PortUnavailable("ports.already_open", port=self._name)

        def on_lost(error: PortLost) -> None:
            self._connection = None
            receiver.port_lost(error)

        connection = TcpConnection(self._name, receiver.data_received, on_lost)
        await connection.connect(self._host, self._port, self._timeout_s)
        self._connection = connection

    def write(self, data: bytes, /) -> None:
        """Raises PortLost; the receiver gets ``port_lost`` once, later."""
        if self._connection is None:
            raise PortLost("ports.not_open", port=self._name)
        self._connection.write(data)

    async def close(self) -> None:
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()


def open_port(url: PortUrl) -> TcpPort:
    """Return the port of a URL ``tcp://``. Raises PortUrlError."""
    return TcpPort(url)
