"""What every test of this room needs: our stations behind a pty or TCP, and programs that are asked once."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass

from drivebus.line import LineSettings
from drivebus.sim.bench import Bench
from drivebus.sim.models import make_stations
from drivebus.sim.pty import serve_pty
from drivebus.sim.tcp import TcpServer, serve_tcp

PATIENCE_S = 10.0
"""Something outside this process that takes longer than this will not come."""


def bench(text: str, encoding: str = "rtu", line: LineSettings | None = None) -> Bench:
    """Stations with ramps as quick as their motors bear without a trip."""
    made = Bench(make_stations(text, {"encoding": encoding}), line or LineSettings(19200))
    for station in made.stations:
        station.set_ramps(0.5, 0.5)
    return made


@asynccontextmanager
async def on_pty(made: Bench) -> AsyncIterator[str]:
    """The path that a program opens."""
    server = await serve_pty(made)
    try:
        yield server.path
    finally:
        await server.close()


@asynccontextmanager
async def on_tcp(made: Bench) -> AsyncIterator[TcpServer]:
    """A raw serial server."""
    server = await serve_tcp(made)
    try:
        yield server
    finally:
        await server.close()


async def until(there: Callable[[], bool], what: str) -> None:
    """Wait for something, with a name for when it does not come."""
    ends_at = asyncio.get_running_loop().time() + PATIENCE_S
    while not there():
        assert asyncio.get_running_loop().time() < ends_at, f"{what} did not come in {PATIENCE_S} s"
        await asyncio.sleep(0.01)


@dataclass(frozen=True, slots=True)
class Told:
    """How a program ended and what it printed."""

    code: int
    text: str

    @property
    def registers(self) -> dict[int, int]:
        """The lines ``[12288]: <tab> 9`` of mbpoll."""
        pairs = (line.strip().split(":") for line in self.text.splitlines() if line.startswith("["))
        return {int(place.strip("[]")): int(value.split()[0], 0) for place, value in pairs}


async def told(*command: object) -> Told:
    """Run a program to its end while the bench goes on in this loop."""
    child = await asyncio.create_subprocess_exec(
        *[str(word) for word in command], stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT
    )
    try:
        out, _ = await asyncio.wait_for(child.communicate(), PATIENCE_S)
    except TimeoutError:
        child.kill()
        raise
    assert child.returncode is not None
    return Told(child.returncode, out.decode())
