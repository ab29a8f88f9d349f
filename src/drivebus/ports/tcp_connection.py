"""A TCP connection to a serial server: what ``tcp`` and ``rfc2217`` share. Knows sockets, no protocol.

A frame that the network holds back is a hazard: a start could reach the drive long after anybody wants it. So the
connection is given up, with what it still holds, when the peer has taken nothing for STALL_S.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from contextlib import suppress

from drivebus.errors import PortLost, PortUnavailable

TCP_STALL_TIMEOUT_S = 2.0
"""As long as a start may be old (ruling 12)."""
CONNECT_TIMEOUT_S = 3.0
"""Default of the ``timeout`` option: a serial server on the same site answers within milliseconds."""
SEND_BUFFER_BYTES = 4096
"""Small, so that a peer that takes nothing shows at once."""
_KEEPALIVE = {
    "TCP_KEEPIDLE": 5,
    "TCP_KEEPINTVL": 2,
    "TCP_KEEPCNT": 3,
    "TCP_USER_TIMEOUT": int(TCP_STALL_TIMEOUT_S * 1000),
}
"""A server that vanished is noticed within 11 s of silence, within 2 s of a frame that it does not take (Linux)."""


class TcpConnection(asyncio.Protocol):
    """One TCP connection. ``lost`` is called once, unless ``close`` was called first."""

    def __init__(self, name: str, received: Callable[[bytes], None], lost: Callable[[PortLost], None]) -> None:
        self._name = name
        self._lost: Callable[[PortLost], None] | None = lost
        self._transport: asyncio.Transport | None = None
        self.data_received = received  # type: ignore[method-assign, assignment]  # one call less for each chunk

    async def connect(self, host: str, port: int, timeout_s: float) -> None:
        """Raises PortUnavailable with why and what to do."""
        try:
            async with asyncio.timeout(timeout_s):
                connected = await _connect(host, port)
                transport, _ = await asyncio.get_running_loop().create_connection(lambda: self, sock=connected)
        except TimeoutError as error:
            raise PortUnavailable("ports.net-timeout", port=self._name, seconds=timeout_s) from error
        except socket.gaierror as error:
            raise PortUnavailable("ports.net-name", port=self._name, host=host) from error
        except ConnectionRefusedError as error:
            raise PortUnavailable("ports.net-refused", port=self._name, number=port) from error
        except OSError as error:
            raise PortUnavailable("ports.net", port=self._name, reason=error.strerror or str(error)) from error
        self._transport = transport

    def write(self, data: bytes) -> None:
        """Raises PortLost where the connection is gone or still holds an earlier frame."""
        transport = self._transport
        if transport is None or transport.is_closing():
            raise PortLost("ports.not-open", port=self._name)
        if transport.get_write_buffer_size():
            transport.abort()
            raise PortLost("ports.lost", port=self._name, reason="stalled")
        transport.write(data)

    def close(self) -> None:
        """End it; the server still gets what was written. Idempotent."""
        self._lost = None
        transport, self._transport = self._transport, None
        if transport is not None:
            transport.close()

    def connection_lost(self, exc: Exception | None) -> None:
        lost, self._lost = self._lost, None
        self._transport = None
        if lost is not None:
            lost(PortLost("ports.lost", port=self._name, reason=_reason(exc)))


def _reason(exc: Exception | None) -> str:
    if exc is None:
        return "the server closed the connection"
    return getattr(exc, "strerror", None) or str(exc)


async def _connect(host: str, port: int) -> socket.socket:
    """Each address of the host in turn; the error of the last one tells why."""
    loop = asyncio.get_running_loop()
    failure: OSError | None = None
    for family, kind, protocol, _, address in await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM):
        one = socket.socket(family, kind, protocol)
        try:
            one.setblocking(False)
            _set_socket_options(one)
            await loop.sock_connect(one, address)
            return one
        except OSError as error:
            one.close()
            failure = error
        except BaseException:
            one.close()
            raise
    raise failure or OSError("no address")


def _set_socket_options(one: socket.socket) -> None:
    """Frames go out at once; a dead peer is noticed."""
    one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    one.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    one.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
    for name, value in _KEEPALIVE.items():
        if hasattr(socket, name):  # each system has some of them
            with suppress(OSError):
                one.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
