"""HTTP and WebSocket protocols with limits that uvicorn lacks.

They limit the time and size of headers and the time of an unread response.
"""

from __future__ import annotations

import asyncio
from typing import Any

from httptools import HttpParserError
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

HEADER_TIMEOUT_S = 10.0  # from the connection, or the first byte of a later request, to the empty line
MAX_HEADER_BYTES = 32 * 1024
_HEADER_LINE_BYTES = 4  # ": " and the line end of a header
WRITE_STALL_TIMEOUT_S = 30.0  # a client may leave a response unread this long
INVALID_UTF8_CLOSE_CODE = 1007  # RFC 6455, 7.4.1
WEBSOCKET_CLOSE_TIMEOUT_S = 2.0  # for the close handshake; until then the connection counts


class _WriteStallTimeout(asyncio.Protocol):
    """Closes the connection of a client that leaves a response unread."""

    loop: asyncio.AbstractEventLoop
    transport: asyncio.Transport
    _stall_timer: asyncio.TimerHandle | None = None

    def connection_lost(self, exc: Exception | None) -> None:
        self._cancel_stall_timer()
        super().connection_lost(exc)

    def pause_writing(self) -> None:
        super().pause_writing()
        self._stall_timer = self.loop.call_later(WRITE_STALL_TIMEOUT_S, self.transport.abort)

    def resume_writing(self) -> None:
        super().resume_writing()
        self._cancel_stall_timer()

    def _cancel_stall_timer(self) -> None:
        if self._stall_timer is not None:
            self._stall_timer.cancel()
        self._stall_timer = None


class LimitedHttpProtocol(_WriteStallTimeout, HttpToolsProtocol):
    """HTTP/1.1 with limits of the headers' time and size."""

    _header_timer: asyncio.TimerHandle | None = None
    _header_bytes = 0
    """Bytes of headers that are not complete yet."""
    _parsed_header_bytes = 0
    """Bytes of the address and the headers of the current request, however they arrived."""
    _headers_complete = False
    """Whether further fields of the current request are trailers. They are ignored: no proxy adds to them."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._start_header_timer()

    def connection_lost(self, exc: Exception | None) -> None:
        self._cancel_header_timer()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        awaited = self._header_timer
        super().data_received(data)
        if awaited is not None and self._header_timer is awaited:  # all of it is header: a body may come with its end
            self._header_bytes += len(data)
            if self._header_bytes > MAX_HEADER_BYTES:
                self.transport.abort()

    def on_message_begin(self) -> None:
        self._parsed_header_bytes, self._headers_complete = 0, False
        super().on_message_begin()
        self._start_header_timer()

    def on_url(self, url: bytes) -> None:
        self._count_header(len(url))
        super().on_url(url)

    def on_header(self, name: bytes, value: bytes) -> None:
        self._count_header(len(name) + len(value) + _HEADER_LINE_BYTES)
        if not self._headers_complete:
            super().on_header(name, value)

    def _count_header(self, size: int) -> None:
        """Count bytes of headers. Raises HttpParserError, answered as a malformed request, beyond the limit."""
        self._parsed_header_bytes += size
        if self._parsed_header_bytes > MAX_HEADER_BYTES:
            raise HttpParserError(f"more than {MAX_HEADER_BYTES} bytes of headers")

    def on_headers_complete(self) -> None:
        self._cancel_header_timer()
        self._headers_complete = True
        super().on_headers_complete()

    def handle_websocket_upgrade(self) -> None:
        """Upgrade the connection; close it after its response where an earlier request on it has none yet.

        uvicorn would write both answers in any order, and end the WebSocket as an idle HTTP connection.
        """
        if self.cycle is None or self.cycle.response_complete:
            super().handle_websocket_upgrade()
        else:
            self.cycle.keep_alive = False

    def on_response_complete(self) -> None:
        super().on_response_complete()
        if self.cycle is not None and self.cycle.more_body:
            self.transport.close()

    def _start_header_timer(self) -> None:
        if self._header_timer is None:
            self._header_timer = self.loop.call_later(HEADER_TIMEOUT_S, self.transport.abort)

    def _cancel_header_timer(self) -> None:
        if self._header_timer is not None:
            self._header_timer.cancel()
        self._header_timer, self._header_bytes = None, 0


class LimitedWebSocketProtocol(_WriteStallTimeout, WebSocketsSansIOProtocol):
    """WebSocket that closes in time although its client reads nothing.

    Pending data would delay a plain ``close`` without limit.
    """

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.close_timeout = WEBSOCKET_CLOSE_TIMEOUT_S

    def data_received(self, data: bytes) -> None:
        """Take in data; close a connection whose handshake is no request, which uvicorn leaves open unanswered.

        The first data is the whole head of a request that httptools accepted; the limits of this parser are stricter.
        """
        super().data_received(data)
        if not self.handshake_initiated:
            self.transport.write(b"".join(self.conn.data_to_send()))
            self.transport.close()

    async def send(self, message: Any) -> None:
        """Send a message; an HTTP response completes the handshake, for which uvicorn would log an error."""
        await super().send(message)
        if message["type"] == "websocket.http.response.body":
            self.handshake_complete = True

    def send_receive_event_to_app(self) -> None:
        """Forward a message; close the connection for invalid UTF-8, for which uvicorn would log a traceback."""
        if self.curr_msg_data_type == "text" and not self.close_sent:
            try:
                b"".join(self.frames).decode()
            except UnicodeDecodeError:
                self.frames = []
                self.conn.send_close(INVALID_UTF8_CLOSE_CODE)
                self.handle_parser_exception()
                return
        super().send_receive_event_to_app()
