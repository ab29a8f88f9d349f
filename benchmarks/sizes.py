"""How soon a service has its first readings, what it holds and how quick it answers, with few and with many drives."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.__main__ import ROOT
from benchmarks.hall import Hall, memory_mb, serving
from benchmarks.harness import Figures
from drivebus.errors import ServiceUnavailable
from drivebus.plant.actor import local
from drivebus.plant.socket_client import SocketClient

PLANTS = {12: (3, 4), 300: (10, 30)}
"""Drives: lines and drives on each. The simulated drives live in the plant process and are in its figures."""
BAUD = 19_200
WEBSOCKETS = 50
ASKING_S = 8.0
ME = local("bench", "sizes")


def sizes(settle_s: float) -> Figures:
    """Each plant by itself, nothing else beside it; nothing for 0."""
    return {str(drives): one(*plant, settle_s) for drives, plant in PLANTS.items()} if settle_s else {}


def one(lines: int, drives: int, settle_s: float) -> Figures:
    links = [f"sim://vc660@1-{drives}?seed={line + 1}" for line in range(lines)]
    with tempfile.TemporaryDirectory() as name, serving(Path(name), links, drives, BAUD) as hall:
        first_s, every_s = asyncio.run(readings(hall, lines * drives))
        found: Figures = {
            "lines": lines,
            "seconds_to": {
                "socket": round(hall.socket_at - hall.begun, 2),
                "web": round(hall.web_at - hall.begun, 2),
                "first_reading": round(first_s - hall.begun, 2),
                "reading_of_every_drive": round(every_s - hall.begun, 2),
            },
        }
        for connections in (1, 8):
            found[f"rest_{connections}"] = asking(hall, lines, drives, connections)
        time.sleep(max(0.0, hall.begun + settle_s - time.monotonic()))
        found["memory_mb"] = {"plant": memory_mb(hall.plant), "web": memory_mb(hall.web)}
    return found


async def readings(hall: Hall, drives: int) -> tuple[float, float]:
    """When any drive had a good reading, and when every one had."""
    client, good, first = SocketClient(hall.directory / "plant.sock"), set[str](), 0.0
    async for message in _live(client):
        good |= {topic for topic, content in message["topics"].items() if _is_good(content)}
        first = first or (time.monotonic() if good else 0.0)
        if len(good) == drives:
            break
    await client.close()
    return first, time.monotonic()


async def _live(client: SocketClient) -> Any:
    while True:
        try:
            async for message in client.live(["drives/*"], ME, 0.1):
                yield message
        except ServiceUnavailable:  # its socket is there a moment before it answers
            await asyncio.sleep(0.01)


def _is_good(content: dict[str, Any]) -> bool:
    return any(signal["quality"] == "good" for signal in content.get("signals", {}).values())


def asking(hall: Hall, lines: int, drives: int, connections: int) -> Figures:
    """REST as fast as it is answered, beside fifty WebSockets."""
    given = [hall.port, lines, drives, WEBSOCKETS, connections, 0]
    words = [sys.executable, "-m", "benchmarks.clients.visitors", *map(str, given)]
    with subprocess.Popen(words, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(ASKING_S)
        return dict(json.loads(process.communicate()[0]))
