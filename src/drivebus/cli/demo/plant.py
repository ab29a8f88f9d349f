"""Simulated buses of the demo: their port URLs, and the events that the script applies to them."""

from __future__ import annotations

import asyncio
import contextlib
import json
import signal
import tempfile
from typing import Any, Protocol

from drivebus.cli.demo.layout import BUSES
from drivebus.service.process.module_command import module_command


class DemoPlant(Protocol):
    """Four buses of simulated drives."""

    kind: str
    """``pty`` or ``memory``."""
    urls: list[str]
    """Port URLs, in the order of ``BUSES``."""

    async def start(self) -> None: ...

    async def close(self) -> None: ...

    def apply(self, event: dict[str, Any]) -> None:
        """Unplug or plug a bus, or trip a drive: see ``stations.apply_event``."""
        ...


def create_demo_plant() -> DemoPlant:
    """Return a plant on ptys, or in memory on a platform without them."""
    try:
        import pty  # noqa: F401
    except ImportError:
        return MemoryDemoPlant()
    return PtyDemoPlant()


class PtyDemoPlant:
    """Buses on ptys, served by a child process that ends with its standard input."""

    kind = "pty"

    def __init__(self) -> None:
        self.urls: list[str] = []
        self._child: asyncio.subprocess.Process | None = None
        self._folder: tempfile.TemporaryDirectory[str] | None = None

    async def start(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="drivebus-demo-")
        self._child = await asyncio.create_subprocess_exec(
            *module_command("drivebus.cli.demo.stations", self._folder.name),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            start_new_session=True,
        )
        assert self._child.stdout is not None
        self.urls = json.loads(await self._child.stdout.readline())["urls"]

    def apply(self, event: dict[str, Any]) -> None:
        if self._child is not None and self._child.stdin is not None:
            self._child.stdin.write((json.dumps(event) + "\n").encode())

    async def close(self) -> None:
        child, self._child = self._child, None
        if child is not None and child.stdin is not None:
            child.stdin.close()
            try:
                await asyncio.wait_for(child.wait(), 3.0)
            except TimeoutError:
                with contextlib.suppress(ProcessLookupError):
                    child.send_signal(signal.SIGKILL)
                await child.wait()
        if self._folder is not None:
            self._folder.cleanup()


class MemoryDemoPlant:
    """Buses in this process, for platforms without ptys; frames still take real time."""

    kind = "memory"

    def __init__(self) -> None:
        self.urls: list[str] = []

    async def start(self) -> None:
        self.urls = [_sim_url(index) for index in range(len(BUSES))]

    def apply(self, event: dict[str, Any]) -> None:
        from drivebus.cli.demo.stations import apply_event
        from drivebus.simulator.port import find_simulated_bus

        apply_event([find_simulated_bus(f"demo-{bus.name}") for bus in BUSES], event)

    async def close(self) -> None:
        from drivebus.simulator.port import clear_simulated_buses

        clear_simulated_buses()


def _sim_url(index: int) -> str:
    bus = BUSES[index]
    more = "".join(f"&{name}={value}" for name, value in bus.options.items())
    return (
        f"sim://{bus.target}?baud={bus.baud}&format={bus.format}&load={bus.load}&ramp={bus.ramp_s}"
        f"&seed={index + 1}&name=demo-{bus.name}{more}"
    )
