"""HTTP connections and WebSockets with limits that the library does not have: no slow head, no endless head, no slow
reader, no address that takes all connections (S14).
"""

from __future__ import annotations

import asyncio
import ipaddress
from typing import Any

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

HEAD_S = 10.0
"""From the connection, or the first octet of a later request, to the empty line."""
HEAD_LARGEST = 32 * 1024
READ_S = 30.0
"""So long the other side may leave its answer unread."""
CLOSE_S = 2.0
"""So long a WebSocket may take to answer that it is closed; until then it has one of the connections."""
PER_ADDRESS = 128
"""Connections of one address; this machine's own (a reverse proxy) may have all."""


class _ReadInTime(asyncio.Protocol):
    """Closes the connection of whoever leaves an answer unread."""

    loop: asyncio.AbstractEventLoop
    transport: asyncio.Transport
    _unread: asyncio.TimerHandle | None = None

    def connection_lost(self, exc: Exception | None) -> None:
        self._is_read()
        super().connection_lost(exc)

    def pause_writing(self) -> None:
        super().pause_writing()
        self._unread = self.loop.call_later(READ_S, self.transport.abort)

    def resume_writing(self) -> None:
        super().resume_writing()
        self._is_read()

    def _is_read(self) -> None:
        if self._unread is not None:
            self._unread.cancel()
        self._unread = None


class Patience(_ReadInTime, HttpToolsProtocol):
    """Closes whoever takes too long or too much."""

    _timer: asyncio.TimerHandle | None = None
    _head = 0
    """Octets of a head that is not complete."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        if self._too_many():
            transport.abort()
            return
        self._await_head()

    def connection_lost(self, exc: Exception | None) -> None:
        self._head_is_there()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        awaited = self._timer
        super().data_received(data)
        if awaited is not None and self._timer is awaited:  # all of it is head: a body may come with its end
            self._head += len(data)
            if self._head > HEAD_LARGEST:
                self.transport.abort()

    def on_message_begin(self) -> None:
        super().on_message_begin()
        self._await_head()

    def on_headers_complete(self) -> None:
        self._head_is_there()
        super().on_headers_complete()

    def on_response_complete(self) -> None:
        super().on_response_complete()
        if self.cycle is not None and self.cycle.more_body:
            self.transport.close()

    def _await_head(self) -> None:
        if self._timer is None:
            self._timer = self.loop.call_later(HEAD_S, self.transport.abort)

    def _head_is_there(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
        self._timer, self._head = None, 0

    def _too_many(self) -> bool:
        if self.client is None or _is_this_machine(self.client[0]):
            return False
        others = (getattr(one, "client", None) for one in self.connections)
        return len([other for other in others if other is not None and other[0] == self.client[0]]) > PER_ADDRESS


def _is_this_machine(address: str) -> bool:
    """127.0.0.1 comes as ``::ffff:127.0.0.1`` where IPv6 is listened for too."""
    found = ipaddress.ip_address(address)
    return (getattr(found, "ipv4_mapped", None) or found).is_loopback


class PatientSocket(_ReadInTime, WebSocketsSansIOProtocol):
    """A WebSocket that nobody reads, or that does not end when it is told to, keeps its connection from nobody else.

    What waits to be sent holds a mere ``close`` back for ever.
    """

    def __init__(self, *args: Any, **more: Any) -> None:
        super().__init__(*args, **more)
        self.close_timeout = CLOSE_S
