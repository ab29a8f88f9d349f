"""A thread of the program that computes must not keep the interpreter from the loop of a bus."""

from __future__ import annotations

import asyncio
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from drivebus.bus import timer

PYTHON_SWITCH_INTERVAL_S = 0.005
ROUNDS = 20


@pytest.fixture
def python_switch_interval() -> Iterator[None]:
    """Python's own switch interval at the begin of the test; the one before it afterwards."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(PYTHON_SWITCH_INTERVAL_S)
    yield
    sys.setswitchinterval(before)


@contextmanager
def busy_thread() -> Iterator[None]:
    """Run a thread that computes without a pause."""
    ended = threading.Event()

    def compute() -> None:
        while not ended.is_set():
            sum(range(1000))

    thread = threading.Thread(target=compute)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def seconds_of_waits() -> float:
    """Return how long a loop takes that waits as often as in some transactions, each time for no longer than 0.1 ms."""
    begun = time.monotonic()
    for _ in range(ROUNDS):
        time.sleep(0.0001)
    return time.monotonic() - begun


@pytest.mark.usefixtures("python_switch_interval")
def test_a_busy_thread_does_not_delay_each_wake_up_of_the_loop_by_five_milliseconds() -> None:
    async def is_quick_once() -> bool:
        loop = asyncio.get_running_loop()
        timer.acquire(loop)
        try:
            return any(seconds_of_waits() < ROUNDS * PYTHON_SWITCH_INTERVAL_S / 5 for _ in range(200))
        finally:
            timer.release(loop)

    with busy_thread():
        assert asyncio.run(is_quick_once()), "a busy machine may delay many of them, but not every one"


@pytest.mark.usefixtures("python_switch_interval")
def test_a_shorter_switch_interval_of_the_program_is_kept() -> None:
    sys.setswitchinterval(10e-6)

    async def use_timers() -> None:
        loop = asyncio.get_running_loop()
        timer.acquire(loop)
        timer.release(loop)

    asyncio.run(use_timers())
    assert sys.getswitchinterval() == pytest.approx(10e-6)
