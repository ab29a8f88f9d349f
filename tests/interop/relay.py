"""A bad wire between two programs: two ptys; what one side writes reaches the other late, or never, but in order."""

from __future__ import annotations

import asyncio
import contextlib
import os
import tty
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from random import Random

SILENCE_S = 0.004
"""What is written without such a pause is one frame, and is lost or delayed as one."""


@dataclass(frozen=True, slots=True)
class Weather:
    """Shares of frames, each way. ``delay_s`` is the longest."""

    loss: float = 0.0
    delay: float = 0.0
    delay_s: float = 0.0


class Relay:
    """``ours`` and ``theirs`` are the paths that the two programs open."""

    def __init__(self, weather: Weather, seed: int) -> None:
        self.weather, self._chance = weather, Random(seed)
        self.lost = self.delayed = self.passed = 0
        self._loop = asyncio.get_running_loop()
        self._ends = [_pty(), _pty()]
        self.ours, self.theirs = (os.ttyname(slave) for _, slave in self._ends)
        self._frames = [bytearray(), bytearray()]
        self._timers: list[asyncio.TimerHandle | None] = [None, None]
        self._free_at = [0.0, 0.0]
        for side in (0, 1):
            self._loop.add_reader(self._ends[side][0], self._readable, side)

    def _readable(self, side: int) -> None:
        with contextlib.suppress(OSError):
            self._frames[side] += os.read(self._ends[side][0], 4096)
        if (timer := self._timers[side]) is not None:
            timer.cancel()
        self._timers[side] = self._loop.call_later(SILENCE_S, self._pass, side)

    def _pass(self, side: int) -> None:
        frame, self._frames[side] = bytes(self._frames[side]), bytearray()
        if self._chance.random() < self.weather.loss:
            self.lost += 1
            return
        at = self._loop.time()
        if self._chance.random() < self.weather.delay:
            self.delayed += 1
            at += self._chance.random() * self.weather.delay_s
        self.passed += 1
        at = self._free_at[side] = max(at, self._free_at[side] + 0.005)
        self._loop.call_at(at, self._give, 1 - side, frame)

    def _give(self, side: int, frame: bytes) -> None:
        with contextlib.suppress(OSError):
            os.write(self._ends[side][0], frame)

    def close(self) -> None:
        for master, slave in self._ends:
            self._loop.remove_reader(master)
            os.close(master)
            os.close(slave)


def _pty() -> tuple[int, int]:
    """Raw, and held open, so that it outlives a program that ends."""
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    return master, slave


@asynccontextmanager
async def relay(weather: Weather, seed: int = 1) -> AsyncIterator[Relay]:
    made = Relay(weather, seed)
    try:
        yield made
    finally:
        made.close()
