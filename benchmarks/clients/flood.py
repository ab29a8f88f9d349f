"""Flood of hostile clients: idle WebSockets, slow request heads, huge bodies, JSON bombs.

    python -m benchmarks.clients.flood PORT WEBSOCKETS SLOW

Prints "ready" when every WebSocket has been tried, and at the end of its standard input the counts of answers as JSON.
The clients read only the first line of an answer.
"""

from __future__ import annotations

import asyncio
import base64
import gzip
import json
import socket
import sys
from collections import Counter

from benchmarks.clients.plain_http import request
from drivebus.web.middleware.request_body import MAX_PUBLIC_BODY_BYTES as LARGEST

HUGE = 100 * 1024 * 1024
BODY_PIECE = b" " * 65536
DRIP_S = 1.0
"""Pause between two bytes of a slow head."""
BOMBS = {
    "deep JSON": (b"[" * (LARGEST - 1), ""),
    "wide JSON": (b'{"a":[' + b"{}," * (LARGEST // 3 - 10) + b"{}]}", ""),
    "packed JSON": (gzip.compress(b" " * HUGE), "Content-Encoding: gzip\r\n"),
}
LOGIN_PATH = "/api/v1/login"
"""Path whose body is read before authentication."""
Streams = tuple[asyncio.StreamReader, asyncio.StreamWriter]


class FloodClients:
    """Hostile clients of one web process, and the counts of the answers they got."""

    def __init__(self, port: int) -> None:
        self.port = port
        self.found: Counter[str] = Counter()
        self._open_streams: list[Streams] = []

    async def websocket(self) -> None:
        """Open a WebSocket and never read from it."""
        small = socket.socket()
        small.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 65536)
        small.setblocking(False)
        await asyncio.get_running_loop().sock_connect(small, ("127.0.0.1", self.port))
        streams = await asyncio.open_connection(sock=small, limit=4096)
        key = base64.b64encode(bytes(16)).decode()
        more = f"Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n"
        streams[1].write(
            request("GET", "/api/v1/live", self.port).replace(b"\r\n\r\n", b"\r\n" + more.encode() + b"\r\n")
        )
        self._open_streams.append(streams)
        await self._count("websockets", streams)

    async def send_slow_head(self) -> None:
        """Send a head without end, one byte at a time, again whenever the connection is closed."""
        while True:
            _, writer = await asyncio.open_connection("127.0.0.1", self.port)
            self.found["slow heads: begun"] += 1
            try:
                writer.write(b"GET /api/v1/health HTTP/1.1\r\nX-Slow: ")
                while not writer.transport.is_closing():
                    await asyncio.sleep(DRIP_S)
                    writer.write(b"x")
            finally:
                writer.close()

    async def send_large_body(self, name: str, head: str, *, chunked: bool) -> None:
        """Send 100 MB, with a Content-Length or in chunks, until the server stops reading."""
        while True:
            reader, writer = await asyncio.open_connection("127.0.0.1", self.port)
            writer.write(self._head(head))
            answer = asyncio.create_task(self._count(name, (reader, writer)))
            piece = b"%x\r\n%s\r\n" % (len(BODY_PIECE), BODY_PIECE) if chunked else BODY_PIECE
            try:
                for _ in range(HUGE // len(BODY_PIECE)):
                    if answer.done():
                        break
                    writer.write(piece)
                    await writer.drain()
            except OSError:
                pass
            await answer
            writer.close()

    async def send_bomb(self, name: str) -> None:
        data, more = BOMBS[name]
        while True:
            streams = await asyncio.open_connection("127.0.0.1", self.port)
            streams[1].write(self._head(f"Content-Length: {len(data)}\r\n{more}") + data)
            await self._count(name, streams)
            streams[1].close()

    def _head(self, more: str) -> bytes:
        host = f"Host: 127.0.0.1:{self.port}\r\nContent-Type: application/json\r\n"
        return f"POST {LOGIN_PATH} HTTP/1.1\r\n{host}{more}\r\n".encode()

    async def _count(self, name: str, streams: Streams) -> None:
        try:
            line = await streams[0].readline()
            self.found[f"{name}: {line.split()[1].decode() if line else 'cut off'}"] += 1
        except (OSError, ValueError):
            self.found[f"{name}: cut off"] += 1


async def main() -> None:
    port, sockets, slow = (int(text) for text in sys.argv[1:4])
    flood, over = FloodClients(port), asyncio.Event()
    asyncio.get_running_loop().add_reader(0, over.set)
    await asyncio.gather(*(flood.websocket() for _ in range(sockets)))
    length = f"Content-Length: {HUGE}\r\n"
    attacks = [
        *(asyncio.create_task(flood.send_slow_head()) for _ in range(slow)),
        asyncio.create_task(flood.send_large_body("100 MB with Content-Length", length, chunked=False)),
        asyncio.create_task(flood.send_large_body("100 MB in chunks", "Transfer-Encoding: chunked\r\n", chunked=True)),
        *(asyncio.create_task(flood.send_bomb(name)) for name in BOMBS),
    ]
    print("ready", flush=True)
    await over.wait()
    for attack in attacks:
        attack.cancel()
    ended = Counter(type(failure).__name__ for failure in await asyncio.gather(*attacks, return_exceptions=True))
    ended.pop("CancelledError", None)
    print(json.dumps({"answers": dict(sorted(flood.found.items())), "gave_up": dict(ended)}), flush=True)


if __name__ == "__main__":
    asyncio.run(main())
