"""Process of the simulated buses, each on a pty: their times stay exact while another process draws the screen.

It takes events as JSON lines on standard input: ``{"do": "unplug", "bus": 2}``, ``plug``, ``trip`` (with ``address``).
It ends with its input, so that a killed demo leaves nothing behind.
"""

from __future__ import annotations

import asyncio
import json
import shutil
import sys
from collections.abc import Sequence
from typing import Any

from drivebus.cli.demo.layout import BUSES, DemoBus
from drivebus.serial_settings import SerialSettings
from drivebus.simulator.bus import SimulatedBus
from drivebus.simulator.models.catalog import make_station
from drivebus.simulator.motor import Trip


def make_bus(layout: DemoBus, seed: int = 1) -> SimulatedBus:
    """Return one bus of the plant."""
    stations = [make_station(layout.model, drive.address, layout.options, layout.load) for drive in layout.drives]
    for station in stations:
        station.set_ramps(layout.ramp_s, layout.ramp_s)
    return SimulatedBus(
        stations, SerialSettings.parse(layout.baud, layout.format), seed=seed, name=f"demo-{layout.name}"
    )


def apply_event(buses: Sequence[SimulatedBus], event: dict[str, Any]) -> None:
    """Unplug or plug a bus, or trip a drive."""
    bus = buses[event["bus"]]
    if event["do"] == "unplug":
        bus.unplug()
    elif event["do"] == "plug":
        bus.replug()
    elif event["do"] == "trip":
        bus.station(event["address"]).trip(Trip.OVERCURRENT_RUNNING)


async def serve(folder: str) -> None:
    """Serve every bus on a pty and print the URLs; apply events until the input ends.

    A name survives unplugging.
    """
    from drivebus.simulator.pty_server import serve_pty

    buses = [make_bus(layout, seed) for seed, layout in enumerate(BUSES, 1)]
    servers = [await serve_pty(bus, f"{folder}/bus-{bus.name[-1]}") for bus in buses]
    print(json.dumps({"urls": [server.url for server in servers]}), flush=True)
    loop = asyncio.get_running_loop()
    try:
        while text := await loop.run_in_executor(None, sys.stdin.readline):
            apply_event(buses, json.loads(text))
    finally:
        for server in servers:
            await server.close()
        shutil.rmtree(folder, ignore_errors=True)  # a killed parent cannot


if __name__ == "__main__":
    asyncio.run(serve(sys.argv[1]))
