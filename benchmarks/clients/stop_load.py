"""Load of stops: fills the buses of a plant and stops its drives at random instants over its socket and over the web.

    python -m benchmarks.clients.stop_load DIRECTORY PORT LINES STATIONS SECONDS ROUNDS SEED CALLS

Parameter reads over the plant's socket fill what the polls leave of each bus, so that a read is always due. The last
station of each bus is silent. Single drives are stopped for SECONDS, then everything ROUNDS times. CALLS gets a line
for each stop: interface, bus, address (0: all), nanosecond (CLOCK_MONOTONIC) of the call, and its outcome or error
key. Prints the stop bound, occupation and errors of the buses as JSON.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import random
import sys
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from benchmarks.clients.plain_http import PlainHttpConnection
from benchmarks.service_fixture import drive_id
from drivebus.errors import DrivebusError
from drivebus.service.auth.actor import local_actor
from drivebus.service.ipc.client import SocketClient
from drivebus.service.ipc.protocol import SERVICE_SOCKET, STOP_REQUEST, STOP_SOCKET
from drivebus.types import Json

STOP_LOAD_ACTOR = local_actor("bench", "stop_load")
READERS = 1
"""Readers of each bus: one fills it, more would delay its polls by seconds."""
SIGNALS = ["output_voltage", "output_power", "dc_bus_voltage", "temperature", "set_speed"] * 6
PAUSE_S = 0.2
"""Longest pause between the result of a stop and the next stop on its bus."""
WARM_UP_S = 2.0
"""Seconds in which the readers fill the buses before the first stop is measured."""
ONLINE_TIMEOUT_S = 20.0
MAX_LINE_BYTES = 4 * 1024 * 1024
"""Longest result of a stop of everything that is read from the stop socket."""
TimedStop = tuple[str, int, int, int, str]


class LoadedService:
    """Client of the measured plant: fills its buses and stops its drives."""

    def __init__(self, directory: Path, port: int, lines: int, stations: int) -> None:
        self.directory, self.port, self.lines = directory, port, range(lines)
        self.alive = range(1, stations)
        self._client = SocketClient(directory / SERVICE_SOCKET)

    async def buses(self) -> list[Json]:
        return list((await self._client.call("buses.list", {}, STOP_LOAD_ACTOR))["buses"])

    async def wait_until_online(self) -> None:
        """Wait until each responding station has been online once, at most ``ONLINE_TIMEOUT_S``."""
        online: set[str] = set()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(ONLINE_TIMEOUT_S):
                while len(online) < len(self.lines) * len(self.alive):
                    found = [drive for bus in await self.buses() for drive in self.responding(bus)]
                    online |= {drive["drive"] for drive in found if drive["presence"] == "online"}
                    await asyncio.sleep(0.5)

    def responding(self, bus: Json) -> list[Json]:
        return [station for station in bus["stations"] if station["address"] in self.alive]

    async def fill(self, line: int, reader: int) -> None:
        """Read parameters of one drive after the other without end."""
        for address in itertools.cycle([*self.alive[reader:], *self.alive[:reader]]):
            try:
                await self._client.call(
                    "parameters.read", {"drive": drive_id(line, address), "names": SIGNALS}, STOP_LOAD_ACTOR
                )
            except DrivebusError:
                await asyncio.sleep(0.01)

    async def stops(self, line: int, until: float, seed: str) -> list[TimedStop]:
        """Stop drives of one bus one after the other, because a stop queued behind another has a longer bound."""
        chance, calls = random.Random(f"{seed}/{line}"), list[TimedStop]()
        interfaces = {"socket": _SocketStops(self.directory), "web": _WebStops(self.port)}
        while time.monotonic() < until:
            await asyncio.sleep(chance.uniform(0.0, PAUSE_S))
            address, interface = chance.choice(self.alive), chance.choice(sorted(interfaces))
            await interfaces[interface].open()
            at = time.monotonic_ns()
            calls.append((interface, line, address, at, await interfaces[interface].stop(drive_id(line, address))))
        return calls

    async def stop_all(self, interface: str) -> list[TimedStop]:
        """Stop everything, over the socket that only takes "stop all" or over the web."""
        if interface == "socket":
            reader, writer = await asyncio.open_unix_connection(self.directory / STOP_SOCKET, limit=MAX_LINE_BYTES)
            at = time.monotonic_ns()
            writer.write(STOP_REQUEST)
            await reader.readline()  # the acknowledgement
            buses = json.loads(await reader.readline())["buses"]
            writer.close()
        else:
            web = PlainHttpConnection(self.port)
            await web.open()
            at = time.monotonic_ns()
            status, body = await web.request("POST", "/api/v1/stop", {})
            buses = json.loads(body)["buses"] if status == 200 else {}
            web.close()
        silent = {drive_id(line, self.alive.stop) for line in self.lines}
        confirmed = all(set(bus["unconfirmed"]) <= silent for bus in buses.values()) and bool(buses)
        outcome = "confirmed" if confirmed else "not confirmed"
        return [(f"stop-all-{interface}", line, 0, at, outcome) for line in self.lines]


class _SocketStops:
    """Stops over the plant's socket."""

    def __init__(self, directory: Path) -> None:
        self._client = SocketClient(directory / SERVICE_SOCKET)

    async def open(self) -> None:
        await self._client.call("plant.get", {}, STOP_LOAD_ACTOR)

    async def stop(self, drive: str) -> str:
        try:
            return str((await self._client.call("drive.stop", {"drive": drive}, STOP_LOAD_ACTOR))["outcome"]["status"])
        except DrivebusError as error:
            return error.key


class _WebStops:
    """Stops over the web on a connection that is already open."""

    def __init__(self, port: int) -> None:
        self._connection = PlainHttpConnection(port)

    async def open(self) -> None:
        await self._connection.open()

    async def stop(self, drive: str) -> str:
        status, body = await self._connection.request("POST", f"/api/v1/drives/{drive}/stop", {})
        return str(json.loads(body)["outcome"]["status"]) if status == 200 else str(status)


def station_errors(plant: LoadedService, buses: Sequence[Json]) -> Counter[str]:
    """Return the errors of the responding stations since the plant started, by kind."""
    return sum((Counter(drive["errors"]) for bus in buses for drive in plant.responding(bus)), Counter[str]())


async def run_stop_load(plant: LoadedService, rounds: int, seed: str) -> list[TimedStop]:
    chance, calls = random.Random(f"{seed}/all"), list[TimedStop]()
    for number in range(rounds):
        await asyncio.sleep(chance.uniform(0.5, 1.0))
        calls += await plant.stop_all(("socket", "web")[number % 2])
    return calls


async def main() -> None:
    plant = LoadedService(Path(sys.argv[1]), *(int(text) for text in sys.argv[2:5]))
    seconds, rounds, seed, file = float(sys.argv[5]), int(sys.argv[6]), sys.argv[7], Path(sys.argv[8])
    await plant.wait_until_online()
    filling = [asyncio.create_task(plant.fill(line, reader)) for line in plant.lines for reader in range(READERS)]
    await asyncio.sleep(WARM_UP_S)
    before, begun = station_errors(plant, await plant.buses()), time.monotonic()
    many = await asyncio.gather(*(plant.stops(line, begun + seconds, seed) for line in plant.lines if seconds))
    ended, buses = time.monotonic(), await plant.buses()
    calls = [*(call for calls in many for call in calls), *await run_stop_load(plant, rounds, seed)]
    file.write_text("".join(" ".join(map(str, call)) + "\n" for call in calls))  # noqa: ASYNC240  at the end
    found = {
        "bound_s": max(bus["stop_bound_s"] for bus in buses),
        "occupied_percent": min(bus["occupied_percent"] for bus in buses),
        "errors": dict(station_errors(plant, buses) - before),
        "begun": begun,
        "ended": ended,
    }
    print(json.dumps(found), flush=True)
    for task in filling:
        task.cancel()


if __name__ == "__main__":
    asyncio.run(main())
