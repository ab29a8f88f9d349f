"""The plant's own process: four benches on ptys, told by JSON lines on standard input what happens to them.

A process of its own keeps the lines baud-accurate while the host's screen is drawn. It ends when its input does, so a
killed demo leaves nothing behind. Commands: ``{"do": "unplug", "line": 2}``, ``plug``, ``trip`` (with ``address``).
"""

from __future__ import annotations

import asyncio
import json
import shutil
import sys
from collections.abc import Sequence
from typing import Any

from drivebus.cli.demo.layout import LINES, DemoBus
from drivebus.serial_settings import SerialSettings
from drivebus.simulator.bus import SimulatedBus
from drivebus.simulator.models.catalog import make_station
from drivebus.simulator.motor import Trip


def make_bench(line: DemoBus, seed: int = 1) -> SimulatedBus:
    """One line of the plant."""
    stations = [make_station(line.model, drive.address, line.settings, line.load) for drive in line.drives]
    for station in stations:
        station.set_ramps(line.ramp_s, line.ramp_s)
    return SimulatedBus(stations, SerialSettings.parse(line.baud, line.format), seed=seed, name=f"demo-{line.name}")


def obey(benches: Sequence[SimulatedBus], order: dict[str, Any]) -> None:
    """Do what the story says."""
    bench = benches[order["line"]]
    if order["do"] == "unplug":
        bench.unplug()
    elif order["do"] == "plug":
        bench.replug()
    elif order["do"] == "trip":
        bench.station(order["address"]).trip(Trip.OVERCURRENT_RUNNING)


async def serve(folder: str) -> None:
    """Put every line on a pty under a name that survives unplugging; print the URLs; obey until the input ends."""
    from drivebus.simulator.pty_server import serve_pty

    benches = [make_bench(line, seed) for seed, line in enumerate(LINES, 1)]
    servers = [await serve_pty(bench, f"{folder}/line-{bench.name[-1]}") for bench in benches]
    print(json.dumps({"urls": [server.url for server in servers]}), flush=True)
    loop = asyncio.get_running_loop()
    try:
        while text := await loop.run_in_executor(None, sys.stdin.readline):
            obey(benches, json.loads(text))
    finally:
        for server in servers:
            await server.close()
        shutil.rmtree(folder, ignore_errors=True)  # a parent that was killed with its terminal can't


if __name__ == "__main__":
    asyncio.run(serve(sys.argv[1]))
