"""Minimal HTTP/1.1 client: one persistent connection, one request at a time."""

from __future__ import annotations

import asyncio
import json
from typing import Any

from benchmarks.service_fixture import BENCHMARK_TOKEN


class PlainHttpConnection:
    """Connection to 127.0.0.1, opened by the first request and again after the server has closed it."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None

    async def open(self) -> None:
        if self._streams is None:
            self._streams = await asyncio.open_connection("127.0.0.1", self._port)

    async def request(self, method: str, path: str, body: Any = None) -> tuple[int, bytes]:
        """Return status and body; status 0 where the connection ended without an answer."""
        try:
            await self.open()
            assert self._streams is not None
            self._streams[1].write(request(method, path, self._port, body))
            status, keep, found = await _read_response(self._streams[0])
        except (OSError, asyncio.IncompleteReadError):
            self.close()
            return 0, b""
        if not keep:
            self.close()
        return status, found

    def close(self) -> None:
        if self._streams is not None:
            self._streams[1].close()
            self._streams = None


def request(method: str, path: str, port: int, body: Any = None) -> bytes:
    data = b"" if body is None else json.dumps(body).encode()
    kind = "" if body is None else f"Content-Type: application/json\r\nContent-Length: {len(data)}\r\n"
    head = (
        f"{method} {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nAuthorization: Bearer {BENCHMARK_TOKEN}\r\n{kind}\r\n"
    )
    return head.encode() + data


async def _read_response(reader: asyncio.StreamReader) -> tuple[int, bool, bytes]:
    head = (await reader.readuntil(b"\r\n\r\n")).lower()
    length = int(head.partition(b"content-length:")[2].partition(b"\r\n")[0] or 0)
    return int(head.split(b" ", 2)[1]), b"connection: close" not in head, await reader.readexactly(length)
