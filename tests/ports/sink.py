"""A receiver that remembers what it was told."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from drivebus.errors import PortLost


class Sink:
    """Collects bytes, marks and losses, and the loop time of each chunk."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.marks = 0
        self.chunks: list[tuple[float, bytes]] = []
        self.lost: list[PortLost] = []

    def data_received(self, data: bytes, marks: int = 0) -> None:
        self.data += data
        self.marks += marks
        self.chunks.append((asyncio.get_running_loop().time(), data))

    def port_lost(self, error: PortLost) -> None:
        self.lost.append(error)


async def until(condition: Callable[[], object], deadline_s: float = 5.0) -> None:
    """Turn the loop until ``condition`` holds; fails at the deadline."""
    async with asyncio.timeout(deadline_s):
        while not condition():  # noqa: ASYNC110  # conditions are plain state, no event exists for them
            await asyncio.sleep(0.002)
