"""Start-up time, memory and request times of a service with few and with many drives."""

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
"""Number of drives: buses, and drives on each. The service simulates them, so its figures include them."""
BAUD = 19_200
WEBSOCKETS = 50
REQUESTS_S = 8.0
PACED_PER_S = 200
READING_TIMEOUT_S = 120.0
BENCHMARK_ACTOR = local_actor("bench", "scaling")


def measure_sizes(settle_s: float) -> Figures:
    """Measure one service after the other; return no figures where ``settle_s`` is 0."""
    return {str(drives): measure_size(*plant, settle_s) for drives, plant in PLANT_SIZES.items()} if settle_s else {}


def measure_size(lines: int, drives: int, settle_s: float) -> Figures:
    links = [f"sim://vc660@1-{drives}?seed={line + 1}" for line in range(lines)]
    watching: list[Future[tuple[float, float]]] = []
    with tempfile.TemporaryDirectory() as name, ThreadPoolExecutor(1) as threads:

        def wait_for_readings(directory: Path) -> None:
            watching.append(threads.submit(lambda: asyncio.run(first_readings(directory, lines * drives))))

        with running_service(Path(name), links, drives, BAUD, wait_for_readings) as service:
            first_s, every_s = watching[0].result()
            found: Figures = {"lines": lines, "seconds_to": seconds_to(service, first_s, every_s)}
            for connections in (1, 8):
                found[f"rest_{connections}"] = measure_requests(service, lines, drives, connections)
            found[f"rest_{PACED_PER_S}_per_s"] = measure_requests(service, lines, drives, 8, PACED_PER_S)
            time.sleep(max(0.0, service.begun + settle_s - time.monotonic()))
            return found | {"memory_mb": {"plant": memory_mb(service.plant), "web": memory_mb(service.web)}}


def seconds_to(service: BenchmarkService, first_s: float, every_s: float) -> dict[str, float]:
    """Return the seconds from the start command to each event."""
    moments = {
        "socket": service.socket_at,
        "web": service.web_at,
        "first_reading": first_s,
        "reading_of_every_drive": every_s,
    }
    return {name: round(at - service.begun, 2) for name, at in moments.items()}


async def first_readings(directory: Path, drives: int) -> tuple[float, float]:
    """Return when the first drive and when every drive had a good reading. Raises TimeoutError."""
    client, good, first = SocketClient(directory / "plant.sock"), set[str](), 0.0
    async with asyncio.timeout(READING_TIMEOUT_S):
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
        except ServiceUnavailable:  # the socket file exists a moment before the service answers
            await asyncio.sleep(0.01)


def _is_good(content: dict[str, Any]) -> bool:
    return any(signal["quality"] == "good" for signal in content.get("signals", {}).values())


def measure_requests(
    service: BenchmarkService, lines: int, drives: int, connections: int, per_second: int = 0
) -> Figures:
    """Measure REST requests beside fifty WebSockets; ``per_second`` 0: as fast as they are answered."""
    arguments = [service.port, lines, drives, WEBSOCKETS, connections, per_second]
    words = [sys.executable, "-m", "benchmarks.clients.web_load", *map(str, arguments)]
    with subprocess.Popen(
        words, cwd=PROJECT_FOLDER, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(REQUESTS_S)
        return dict(json.loads(process.communicate()[0]))
