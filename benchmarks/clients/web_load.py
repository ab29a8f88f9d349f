"""Load of pages and programs on a service: WebSockets that read everything, and REST requests at a given rate.

    python -m benchmarks.clients.web_load PORT LINES STATIONS WEBSOCKETS CONNECTIONS PER_SECOND

PER_SECOND 0: each connection requests as fast as it is answered. Prints "ready" when every WebSocket has received its
first message, and at the end of its standard input the figures as JSON.
"""

from __future__ import annotations

import asyncio
import itertools
import json
import sys
import time
from collections import Counter
from collections.abc import Iterator

from benchmarks.clients.plain_http import PlainHttpConnection
from benchmarks.latency import quantiles
from benchmarks.service_fixture import BENCHMARK_TOKEN, drive_id

OPEN_AT_ONCE = 20


class WebClients:
    """WebSocket and REST clients of one service, and their counts."""

    def __init__(self, port: int, lines: int, stations: int) -> None:
        self.port, self._lines, self._stations = port, lines, stations
        self.statuses: Counter[int] = Counter()
        self.times_s: list[float] = []
        self.messages = self.bytes = self.closed = 0

    def request_paths(self, first: int) -> Iterator[str]:
        """Return the paths of the usual reads without end, every second one that of a single drive."""
        places = itertools.product(range(1, self._stations + 1), range(self._lines))
        for number, (address, line) in enumerate(itertools.cycle(places), first):
            path = f"/api/v1/drives/{drive_id(line, address)}"
            others = "/api/v1/plant", f"/api/v1/buses/line-{line}", "/api/v1/drives", "/api/v1/alarms", "/api/v1/groups"
            yield path if number % 2 else others[number // 2 % len(others)]

    async def request_periodically(self, first: int, period_s: float, phase_s: float) -> None:
        connection = PlainHttpConnection(self.port)
        due = time.monotonic() + phase_s
        for path in self.request_paths(first):
            if period_s:
                await asyncio.sleep(due - time.monotonic())
                due += period_s
            begun = time.monotonic()
            status, _ = await connection.request("GET", path)
            self.statuses[status] += 1
            self.times_s.append(time.monotonic() - begun)

    async def listen(self, gate: asyncio.Semaphore, begun: asyncio.Event) -> None:
        import websockets

        address = f"ws://127.0.0.1:{self.port}/api/v1/live"
        headers = {"Authorization": f"Bearer {BENCHMARK_TOKEN}"}
        async with gate:
            socket = await websockets.connect(address, additional_headers=headers, max_size=None, compression=None)
        try:
            async for text in socket:
                self.messages += 1
                self.bytes += len(text)
                begun.set()
        finally:
            self.closed += 1
            begun.set()

    def figures(self, seconds: float) -> dict[str, object]:
        return {
            "requests_per_s_answered": round(self.statuses[200] / seconds, 1),
            "statuses": {str(status): count for status, count in sorted(self.statuses.items())},
            "answer_ms": quantiles(1000 * time_s for time_s in self.times_s) if self.times_s else {},
            "messages_per_s": round(self.messages / seconds, 1),
            "mebibytes_per_s": round(self.bytes / seconds / 2**20, 2),
            "websockets_closed": self.closed,
        }


async def main() -> None:
    port, lines, stations, sockets, connections = (int(text) for text in sys.argv[1:6])
    per_second = float(sys.argv[6])
    clients, gate, over = WebClients(port, lines, stations), asyncio.Semaphore(OPEN_AT_ONCE), asyncio.Event()
    asyncio.get_running_loop().add_reader(0, over.set)
    firsts = [asyncio.Event() for _ in range(sockets)]
    listening = [asyncio.create_task(clients.listen(gate, first)) for first in firsts]
    await asyncio.gather(*(first.wait() for first in firsts))
    print("ready", flush=True)
    period_s = connections / per_second if per_second else 0.0
    phase_s = 1 / per_second if per_second else 0.0
    begun, clients.messages, clients.bytes = time.monotonic(), 0, 0
    requesting = [
        asyncio.create_task(clients.request_periodically(place, period_s, place * phase_s))
        for place in range(connections)
    ]
    await over.wait()
    figures = clients.figures(time.monotonic() - begun)
    for task in (*listening, *requesting):
        task.cancel()
    print(json.dumps(figures), flush=True)


if __name__ == "__main__":
    asyncio.run(main())
