"""The virtual plant as the demo's host sees it: four LINKs, and what the story may do to them."""

from __future__ import annotations

import asyncio
import contextlib
import json
import signal
import sys
import tempfile
from typing import Any, Protocol

from drivebus.cli.demo.layout import LINES


class DemoPlant(Protocol):
    """Four lines of pretend drives."""

    kind: str
    """``pty`` or ``memory``."""
    links: list[str]

    async def start(self) -> None: ...

    async def close(self) -> None: ...

    def apply(self, order: dict[str, Any]) -> None:
        """``unplug`` or ``plug`` a line, or ``trip`` a drive."""
        ...


def create_demo_plant() -> DemoPlant:
    """On ptys in a process of its own where the platform has them, else in memory."""
    try:
        import pty  # noqa: F401
    except ImportError:
        return MemoryDemoPlant()
    return PtyDemoPlant()


class PtyDemoPlant:
    """Lines on ptys, served by a child process that dies with us (its input ends)."""

    kind = "pty"

    def __init__(self) -> None:
        self.links: list[str] = []
        self._child: asyncio.subprocess.Process | None = None
        self._folder: tempfile.TemporaryDirectory[str] | None = None

    async def start(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="drivebus-demo-")
        self._child = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "drivebus.cli.demo.stations",
            self._folder.name,
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            start_new_session=True,
        )
        assert self._child.stdout is not None
        self.links = json.loads(await self._child.stdout.readline())["urls"]

    def apply(self, order: dict[str, Any]) -> None:
        if self._child is not None and self._child.stdin is not None:
            self._child.stdin.write((json.dumps(order) + "\n").encode())

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
    """The same lines within this process, for platforms without ptys; still paced by the clock."""

    kind = "memory"

    def __init__(self) -> None:
        self.links: list[str] = []

    async def start(self) -> None:
        self.links = [_sim_link(index) for index in range(len(LINES))]

    def apply(self, order: dict[str, Any]) -> None:
        from drivebus.cli.demo.stations import obey
        from drivebus.simulator.port import find_simulated_bus

        obey([find_simulated_bus(f"demo-{line.name}") for line in LINES], order)

    async def close(self) -> None:
        from drivebus.simulator.port import clear_simulated_buses

        clear_simulated_buses()


def _sim_link(index: int) -> str:
    line = LINES[index]
    more = "".join(f"&{name}={value}" for name, value in line.settings.items())
    return (
        f"sim://{line.target}?baud={line.baud}&format={line.format}&load={line.load}&ramp={line.ramp_s}"
        f"&seed={index + 1}&name=demo-{line.name}{more}"
    )
