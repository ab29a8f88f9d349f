"""``BoundedListener``: a listening socket that closes connections beyond its limits as soon as it has accepted them.

The limits hold before a TLS handshake and before a protocol exists. A process without free file descriptors closes the
waiting connections with a reserved one: asyncio alone would log each of them without end.
"""

from __future__ import annotations

import errno
import os
import socket
from collections.abc import Callable
from typing import Any

from drivebus.service.auth.client_address import client_network, parse_address

MAX_CONNECTIONS = 512
OVERLOAD_CONNECTIONS = 64  # beyond MAX_CONNECTIONS; they are answered that the server is busy
MAX_CONNECTIONS_PER_ADDRESS = 128  # a reverse proxy on this machine, or a trusted one, may have all
MAX_CLOSED_AT_ONCE = 100  # connections that are closed before the event loop goes on
_OUT_OF_DESCRIPTORS = frozenset({errno.EMFILE, errno.ENFILE})


class BoundedListener(socket.socket):
    """Listening socket with limits for all connections and for those of one address."""

    def __init__(self, *args: Any, is_proxy: Callable[[str], bool]) -> None:
        """``is_proxy``: whether an address is that of a trusted proxy, which may have all connections."""
        super().__init__(*args)
        self._is_proxy = is_proxy
        self._open: list[tuple[socket.socket, str | None]] = []
        """Connections with the network of their client; None: of this machine or a trusted proxy."""
        self.closed_count = 0  # connections that were closed at once
        self._reserve = os.open(os.devnull, os.O_RDONLY)

    @property
    def open_count(self) -> int:
        """Number of connections that are open."""
        return sum(connection.fileno() >= 0 for connection, _ in self._open)

    def accept(self) -> tuple[socket.socket, Any]:
        """Return the next connection within the limits; close those beyond. Raises BlockingIOError, OSError."""
        for _ in range(MAX_CLOSED_AT_ONCE):
            try:
                connection, address = super().accept()
            except OSError as error:
                if error.errno not in _OUT_OF_DESCRIPTORS:
                    raise
                self._close_waiting()
                continue
            client = str(address[0])
            network = None if self._is_proxy(client) else limited_network(client)
            self._open = [(accepted, of) for accepted, of in self._open if accepted.fileno() >= 0]
            same = network is not None and sum(of == network for _, of in self._open) >= MAX_CONNECTIONS_PER_ADDRESS
            if not same and len(self._open) < MAX_CONNECTIONS + OVERLOAD_CONNECTIONS:
                self._open.append((connection, network))
                return connection, address
            connection.close()
            self.closed_count += 1
        raise BlockingIOError

    def close(self) -> None:
        """Close the listener; its connections go on."""
        super().close()
        self._close_reserve()

    def _close_waiting(self) -> None:
        """Accept one connection with the reserved descriptor and close it. Raises OSError."""
        self._close_reserve()
        try:
            super().accept()[0].close()
            self.closed_count += 1
        finally:
            self._reserve = os.open(os.devnull, os.O_RDONLY)

    def _close_reserve(self) -> None:
        """Close the reserved descriptor once: its number may be that of another file afterwards."""
        reserve, self._reserve = self._reserve, -1
        if reserve >= 0:
            os.close(reserve)


def limited_network(address: str) -> str | None:
    """Return the network whose connections are counted together; None for this machine itself."""
    parsed = parse_address(address)
    return None if parsed.is_loopback else client_network(parsed)
