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


class FailAfter:
    """Callable that raises OSError at its ``fails``-th call."""

    def __init__(self, plain: Any, fails: int) -> None:
        self.plain, self.fails, self.made = plain, fails, 0

    def __call__(self, *given: Any) -> Any:
        self.made += 1
        if self.made == self.fails:
            raise OSError(24, "Too many open files")
        return self.plain(*given)


@linux
@pytest.mark.parametrize("resource", ["timer", "reader"])
@pytest.mark.parametrize("fails", [1, 2])
def test_without_a_kernel_timer_the_loops_own_is_used_and_nothing_is_left_open(
    monkeypatch: pytest.MonkeyPatch, fails: int, resource: str
) -> None:
    async def main() -> None:
        before, loop = open_files(), asyncio.get_running_loop()
        with monkeypatch.context() as context:
            if resource == "timer":
                context.setattr(timers, "TimerFd", FailAfter(timers.TimerFd, fails))
            else:
                context.setattr(loop, "add_reader", FailAfter(loop.add_reader, fails))
            timer = timers.acquire(loop)
        assert not timer.precise and open_files() == before
        fired = asyncio.Event()
        timer.create_timer(fired.set).set(timer.now() + 0.01)
        await asyncio.wait_for(fired.wait(), 5)
        timers.release(loop)

    asyncio.run(main())


@linux
@pytest.mark.parametrize("resource", ["timer", "reader"])
def test_the_simulators_timer_fires_without_a_kernel_timer_too(monkeypatch: pytest.MonkeyPatch, resource: str) -> None:
    async def main() -> None:
        before, loop, fired = open_files(), asyncio.get_running_loop(), asyncio.Event()
        with monkeypatch.context() as context:
            if resource == "timer":
                context.setattr("drivebus.simulator.timer.TimerFd", FailAfter(TimerFd, 1))
            else:
                context.setattr(loop, "add_reader", FailAfter(loop.add_reader, 1))
            timer_set = LoopTimer(loop, fired.set)
        assert open_files() == before
        timer_set.set(loop.time() + 0.01)
        await asyncio.wait_for(fired.wait(), 5)
        timer_set.close()

    asyncio.run(main())


def test_a_bus_whose_clock_stands_still_does_not_block_the_others() -> None:
    """The bus has its own clock, which stands still for 5 s while that of the loop goes on."""

    async def main() -> None:
        loop, turns = asyncio.get_running_loop(), 0
        assert isinstance(loop, VirtualLoop)

        def clock() -> float:
            nonlocal turns
            turns += 1
            assert turns < 20_000, "the bus reads the clock in a loop and blocks the other tasks"
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


def test_a_timer_never_fires_early_on_a_loop_that_calls_back_early() -> None:
    """asyncio calls back earlier by up to the resolution of its clock, 15.6 ms on Windows: a gap would be short."""

    class EarlyOnce(VirtualLoop):
        early_s = 0.0156

        def call_at(self, when: float, callback: Any, *args: Any, context: Any = None) -> Any:
            early_s, self.early_s = self.early_s, 0.0
            return super().call_at(when - early_s, callback, *args, context=context)

    loop, fired = EarlyOnce(), list[float]()
    timer = timers.EventLoopTimer(loop, lambda: fired.append(loop.time()))  # type: ignore[arg-type]
    timer.set(0.03)
    loop.run_until(1.0)
    assert fired == [0.03]


def test_a_moved_timer_of_a_loop_calls_back_once_at_its_new_time() -> None:
    loop, fired = VirtualLoop(), list[float]()
    timer = timers.EventLoopTimer(loop, lambda: fired.append(loop.time()))  # type: ignore[arg-type]
    for when in (0.5, 0.2, None, 0.3):
        timer.set(when)
    loop.run_until(1.0)
    assert fired == [0.3]
