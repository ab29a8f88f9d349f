"""Age of live values at many pages: ``python -m benchmarks.web`` (about two minutes).

Three processes: a hub with the plant's socket, the real web process, and the pages. Each drive of the hub gets ten
values once a second, each with the monotonic second of its publication; the second part adds a program that requests
single drives over REST without a pause. ``busy`` is the machine's load at the start: its figures are then upper
bounds.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from benchmarks.__main__ import current_commit, print_figures
from benchmarks.service_fixture import BENCHMARK_TOKEN, add_benchmark_user, cpu_s, memory_mb
from drivebus.types import Json

SIGNALS = 10
PUBLISHED = re.compile(r'"signal_0":{"value":([0-9.]+)')
"""Pattern of one value of a drive: parsing all of fifty pages' JSON would measure the pages, not the service."""


class SyntheticService:
    """A ``ServiceClient`` of drives that exist in the hub only."""

    def __init__(self, drives: int) -> None:
        from drivebus.service.live.hub import Hub

        self.hub = Hub(lambda: time.time_ns() // 1_000_000)
        self.names = [f"drive-{number}" for number in range(drives)]

    async def call(self, operation: str, params: Json, actor: Any) -> Json:
        return self.hub.topics[f"drives/{params['drive']}"]

    async def call_json(self, operation: str, params: Json, actor: Any) -> bytes:
        return json.dumps(await self.call(operation, params, actor)).encode()

    def live(self, stream: str, actor: Any) -> AsyncIterator[Json]:
        return self.hub.subscribe(stream)

    async def record(self, entry: Json, actor: Any) -> None:
        return

    async def publish(self) -> None:
        """Publish each drive once a second."""
        begun, turn = time.monotonic(), 0
        while True:
            now = time.monotonic()
            time_ms = time.time_ns() // 1_000_000
            signal = {"value": now, "unit": "Hz", "quality": "good", "reason": None, "source_time_ms": time_ms}
            name = self.names[turn % len(self.names)]
            signals = {f"signal_{number}": signal for number in range(SIGNALS)}
            self.hub.publish(f"drives/{name}", {**constant_fields(name), "signals": signals})
            turn += 1
            await asyncio.sleep(max(0.0, begun + turn / len(self.names) - time.monotonic()))


def constant_fields(name: str) -> Json:
    """Return the fields of a drive that do not change here."""
    return {
        "id": name,
        "title": {"en": name, "zh": name},
        "bus": "line-1",
        "address": 1,
        "model": "vc660",
        "grade": "bench",
        "capabilities": [],
        "groups": [],
        "presence": "online",
        "state": "running",
        "state_reason": None,
        "direction": "forward",
        "fault": None,
        "commanded_hz": 25.0,
        "minimum_hz": 0.0,
        "maximum_hz": 50.0,
        "comm_loss": {"kind": "trips", "after_s": 2.0, "text": None, "waiver": None},
        "lease": None,
        "start_inhibited": False,
        "stop_pending": False,
        "start_blockers": [],
        "alarms": {},
    }


async def plant(directory: Path, drives: int) -> None:
    from drivebus.service.ipc.server import SocketServer

    synthetic = SyntheticService(drives)
    server = SocketServer(synthetic, directory / "plant.sock")
    await server.open()
    print("ready", flush=True)
    await synthetic.publish()


async def start_web(directory: Path) -> None:
    from drivebus.service.auth.service import AuthService
    from drivebus.service.ipc.client import SocketClient
    from drivebus.web.app import make_app
    from drivebus.web.gateway import WebConfig
    from drivebus.web.server import EmbeddedServer, bind_listener, server_config

    add_benchmark_user(directory)
    listener = bind_listener("127.0.0.1", 0)
    config = WebConfig(port=listener.getsockname()[1])
    app = make_app(SocketClient(directory / "plant.sock"), AuthService(directory), config)
    server = EmbeddedServer(server_config(app))
    print(config.port, flush=True)
    await server.serve([listener])


async def count_page_messages(port: int, until: float, delays: list[float], sizes: list[int]) -> None:
    """Count the messages of one WebSocket, except those of the first second, which holds the snapshot."""
    import websockets

    headers = {"Authorization": f"Bearer {BENCHMARK_TOKEN}"}
    address = f"ws://127.0.0.1:{port}/api/v1/live?topics=drives/*"
    async with websockets.connect(address, additional_headers=headers, max_size=None, compression=None) as socket:
        counted_from = time.monotonic() + 1.0
        while (now := time.monotonic()) < until:
            text = await socket.recv()
            now = time.monotonic()
            if now < counted_from:
                continue
            sizes.append(len(text))
            delays.extend(now - float(at) for at in PUBLISHED.findall(text))


def request_repeatedly(port: int, until: float, times_s: list[float]) -> None:
    """Send one request after the other on one connection."""
    import http.client

    connection = http.client.HTTPConnection("127.0.0.1", port)
    headers = {"Authorization": f"Bearer {BENCHMARK_TOKEN}"}
    while (begun := time.monotonic()) < until:
        connection.request("GET", "/api/v1/drives/drive-7", headers=headers)
        answer = connection.getresponse()
        assert len(answer.read()) > 100 and answer.status == 200
        times_s.append(time.monotonic() - begun)
    connection.close()


async def many_pages(port: int, count: int, seconds: float, *, with_requests: bool) -> Json:
    delays: list[float] = []
    sizes: list[int] = []
    times_s: list[float] = []
    until = time.monotonic() + seconds
    requests = asyncio.to_thread(request_repeatedly, port, until, times_s) if with_requests else asyncio.sleep(0)
    await asyncio.gather(*(count_page_messages(port, until, delays, sizes) for _ in range(count)), requests)
    found: Json = {
        "values": len(delays),
        "delay_ms": spread(delays),
        "mebibytes_per_s": round(sum(sizes) / seconds / 2**20, 2),
    }
    return found | (
        {"requests_per_s": round(len(times_s) / seconds, 1), "answer_ms": spread(times_s)} if with_requests else {}
    )


def spread(seconds: list[float]) -> Json:
    known = sorted(seconds)
    pick = {"p50": 0.5, "p99": 0.99, "max": 1.0}
    return {name: round(1000 * known[min(len(known) - 1, int(share * len(known)))], 1) for name, share in pick.items()}


@contextmanager
def child(*words: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Run another part of this file as a process; yields the process and its first line."""
    process = subprocess.Popen([sys.executable, "-m", "benchmarks.web", *words], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        yield process, process.stdout.readline().strip()
    finally:
        process.kill()
        process.communicate()


def measure_web(drives: int, clients: int, seconds: float) -> Json:
    found: Json = {"commit": current_commit(), "drives": drives, "clients": clients, "signals": SIGNALS}
    found["busy"] = round(os.getloadavg()[0], 2)
    with (
        tempfile.TemporaryDirectory() as directory,
        child("--plant", directory, "--drives", str(drives)) as (hub, _),
        child("--web", directory) as (server, port),
    ):
        words = ["--pages", port, "--clients", str(clients), "--seconds", str(seconds)]
        for name, more in (("quiet", []), ("with_rest", ["--with-requests"])):
            before = cpu_s(hub.pid), cpu_s(server.pid)
            with child(*words, *more) as (_, message):
                found[name] = json.loads(message)
            used = cpu_s(hub.pid) - before[0], cpu_s(server.pid) - before[1]
            shares = [round(100 * item / seconds, 1) for item in used]
            found[name] |= {"cpu_percent": {"hub": shares[0], "web": shares[1]}}
        found["memory_mb"] = {"hub": memory_mb(hub.pid)["rss"], "web": memory_mb(server.pid)["rss"]}
    return found


def main() -> None:
    options = argparse.ArgumentParser(prog="python -m benchmarks.web", description=__doc__)
    options.add_argument("--drives", type=int, default=300)
    options.add_argument("--clients", type=int, default=50)
    options.add_argument("--seconds", type=float, default=30.0, help="of each part")
    options.add_argument("--write", action="store_true", help="write docs/reports/web.json")
    for hidden in ("--plant", "--web", "--pages"):
        options.add_argument(hidden, help=argparse.SUPPRESS)
    options.add_argument("--with-requests", action="store_true", help=argparse.SUPPRESS)
    chosen = options.parse_args()
    if chosen.plant:
        asyncio.run(plant(Path(chosen.plant), chosen.drives))
    elif chosen.web:
        asyncio.run(start_web(Path(chosen.web)))
    elif chosen.pages:
        figures = asyncio.run(
            many_pages(int(chosen.pages), chosen.clients, chosen.seconds, with_requests=chosen.with_requests)
        )
        print(json.dumps(figures))
    else:
        print_figures(measure_web(chosen.drives, chosen.clients, chosen.seconds), "web.json", write=chosen.write)


if __name__ == "__main__":
    main()
