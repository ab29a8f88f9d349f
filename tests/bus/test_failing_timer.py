"""The system has no timer left, or a bus was given a clock that stands still for a while."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path
from typing import Any

import pytest

from drivebus.bus import Bus
from drivebus.bus import timer as timers
from drivebus.simulator.timer import LoopTimer
from drivebus.testing.bus_script import ScriptedPort
from drivebus.testing.virtual_time import VirtualLoop, run
from drivebus.timerfd import TimerFd
from fixtures.bus import SETTINGS, FakeStation, read_request, station_config, wire_to

linux = pytest.mark.skipif(sys.platform != "linux", reason="only Linux has timerfd")


def open_files() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


class Scarce:
    """The ``fails``-th of these is one too many."""

    def __init__(self, plain: Any, fails: int) -> None:
        self.plain, self.fails, self.made = plain, fails, 0

    def __call__(self, *given: Any) -> Any:
        self.made += 1
        if self.made == self.fails:
            raise OSError(24, "Too many open files")
        return self.plain(*given)


@linux
@pytest.mark.parametrize("what", ["timer", "reader"])
@pytest.mark.parametrize("fails", [1, 2])
def test_without_a_kernel_timer_the_loops_own_is_used_and_nothing_is_left_open(
    monkeypatch: pytest.MonkeyPatch, fails: int, what: str
) -> None:
    async def main() -> None:
        before, loop = open_files(), asyncio.get_running_loop()
        with monkeypatch.context() as context:
            if what == "timer":
                context.setattr(timers, "TimerFd", Scarce(timers.TimerFd, fails))
            else:
                context.setattr(loop, "add_reader", Scarce(loop.add_reader, fails))
            timer = timers.acquire(loop)
        assert not timer.precise and open_files() == before
        rang = asyncio.Event()
        timer.create_timer(rang.set).set(timer.now() + 0.01)
        await asyncio.wait_for(rang.wait(), 5)
        timers.release(loop)

    asyncio.run(main())


@linux
@pytest.mark.parametrize("what", ["timer", "reader"])
def test_the_simulators_timer_fires_without_a_kernel_timer_too(monkeypatch: pytest.MonkeyPatch, what: str) -> None:
    async def main() -> None:
        before, loop, rang = open_files(), asyncio.get_running_loop(), asyncio.Event()
        with monkeypatch.context() as context:
            if what == "timer":
                context.setattr("drivebus.simulator.timer.TimerFd", Scarce(TimerFd, 1))
            else:
                context.setattr(loop, "add_reader", Scarce(loop.add_reader, 1))
            alarm = LoopTimer(loop, rang.set)
        assert open_files() == before
        alarm.set(loop.time() + 0.01)
        await asyncio.wait_for(rang.wait(), 5)
        alarm.close()

    asyncio.run(main())


def test_a_bus_whose_clock_stands_still_does_not_block_the_others() -> None:
    """A clock of its own (the seam), which says the same for 5 s while the loop's goes on."""

    async def main() -> None:
        loop, turns = asyncio.get_running_loop(), 0
        assert isinstance(loop, VirtualLoop)

        def clock() -> float:
            nonlocal turns
            turns += 1
            assert turns < 20_000, "reads the clock repeatedly without giving other tasks a turn"
            return loop.time() if not 1.0 < loop.time() < 6.0 else 1.0

        bus = Bus(ScriptedPort(wire_to(FakeStation()), SETTINGS), clock=clock)
        bus.add_station(station_config())
        await bus.open()
        await asyncio.sleep(0.99)
        await asyncio.wait_for(bus.transact(read_request()), 10)  # accepted or not: its time is not known
        assert 5.9 < loop.time() < 6.5
        assert (await bus.transact(read_request())).error is None
        await bus.close()

    run(main())
