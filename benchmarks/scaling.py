"""How soon a service has its first readings, what it holds and how quick it answers, with few and with many drives."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
import tempfile
import time
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

from benchmarks.__main__ import PROJECT_FOLDER
from benchmarks.harness import Figures
from benchmarks.service_fixture import BenchmarkService, memory_mb, running_service
from drivebus.errors import ServiceUnavailable
from drivebus.service.auth.actor import local_actor
from drivebus.service.ipc.client import SocketClient

PLANT_SIZES = {12: (3, 4), 300: (10, 30)}
"""Drives: lines and drives on each. The simulated drives live in the plant process and are in its figures."""
BAUD = 19_200
WEBSOCKETS = 50
ASKING_S = 8.0
PATIENCE_S = 120.0
BENCHMARK_ACTOR = local_actor("bench", "sizes")


def measure_sizes(settle_s: float) -> Figures:
    """Each plant by itself, nothing else beside it; nothing for 0."""
    return {str(drives): measure_size(*plant, settle_s) for drives, plant in PLANT_SIZES.items()} if settle_s else {}


def measure_size(lines: int, drives: int, settle_s: float) -> Figures:
    links = [f"sim://vc660@1-{drives}?seed={line + 1}" for line in range(lines)]
    watching: list[Future[tuple[float, float]]] = []
    with tempfile.TemporaryDirectory() as name, ThreadPoolExecutor(1) as threads:

        def there(directory: Path) -> None:
            """The web process is still on its way."""
            watching.append(threads.submit(lambda: asyncio.run(first_readings(directory, lines * drives))))

        with running_service(Path(name), links, drives, BAUD, there) as hall:
            first_s, every_s = watching[0].result()
            found: Figures = {"lines": lines, "seconds_to": seconds_to(hall, first_s, every_s)}
            for connections in (1, 8):
                found[f"rest_{connections}"] = measure_requests(hall, lines, drives, connections)
            time.sleep(max(0.0, hall.begun + settle_s - time.monotonic()))
            return found | {"memory_mb": {"plant": memory_mb(hall.plant), "web": memory_mb(hall.web)}}


def seconds_to(hall: BenchmarkService, first_s: float, every_s: float) -> dict[str, float]:
    """From the command on."""
    moments = {
        "socket": hall.socket_at,
        "web": hall.web_at,
        "first_reading": first_s,
        "reading_of_every_drive": every_s,
    }
    return {name: round(at - hall.begun, 2) for name, at in moments.items()}


async def first_readings(directory: Path, drives: int) -> tuple[float, float]:
    """When any drive had a good reading, and when every one had. Raises TimeoutError."""
    client, good, first = SocketClient(directory / "plant.sock"), set[str](), 0.0
    async with asyncio.timeout(PATIENCE_S):
        async for message in _live(client):
            good |= {
                topic
                for topic, content in message["topics"].items()
                if topic.startswith("drives/") and _is_good(content)
            }
            first = first or (time.monotonic() if good else 0.0)
            if len(good) == drives:
                break
    await client.close()
    return first, time.monotonic()


async def _live(client: SocketClient) -> Any:
    while True:
        try:
            async for message in client.live("state", BENCHMARK_ACTOR):
                yield message
        except ServiceUnavailable:  # its socket is there a moment before it answers
            await asyncio.sleep(0.01)


def _is_good(content: dict[str, Any]) -> bool:
    return any(signal["quality"] == "good" for signal in content.get("signals", {}).values())


def measure_requests(hall: BenchmarkService, lines: int, drives: int, connections: int) -> Figures:
    """REST as fast as it is answered, beside fifty WebSockets."""
    given = [hall.port, lines, drives, WEBSOCKETS, connections, 0]
    words = [sys.executable, "-m", "benchmarks.clients.web_load", *map(str, given)]
    with subprocess.Popen(
        words, cwd=PROJECT_FOLDER, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(ASKING_S)
        return dict(json.loads(process.communicate()[0]))
