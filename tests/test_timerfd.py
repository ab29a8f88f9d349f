"""The kernel timer: never early, taken back when set again, and each for itself."""

from __future__ import annotations

import select
import sys
import threading
import time
from collections.abc import Iterator

import pytest

from drivebus.timerfd import TimerFd

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="timerfd is Linux only")


@pytest.fixture
def timer() -> Iterator[TimerFd]:
    made = TimerFd()
    yield made
    made.close()


def test_it_expires_at_its_second_and_never_before(timer: TimerFd) -> None:
    when = time.monotonic() + 0.02
    timer.set_at(when)
    select.select([timer.fd], [], [], 5.0)
    assert time.monotonic() >= when
    assert timer.consume_expiry() and not timer.consume_expiry()


def test_setting_it_again_takes_an_unread_expiry_back(timer: TimerFd) -> None:
    timer.set_at(1e-6)
    assert select.select([timer.fd], [], [], 5.0)[0]
    timer.set_at(0.0)
    assert not timer.consume_expiry()


def test_buses_of_several_threads_do_not_set_each_others_timer(timer: TimerFd) -> None:
    """Threads that share the structure handed to the kernel now and then arm a timer with another's second."""
    far, other = time.monotonic() + 3600.0, TimerFd()
    ends = time.monotonic() + 0.3

    def set_past() -> None:
        while time.monotonic() < ends:
            other.set_at(1e-6)

    threads = [threading.Thread(target=set_past) for _ in range(3)]
    interval, _ = sys.getswitchinterval(), sys.setswitchinterval(1e-6)
    try:
        for thread in threads:
            thread.start()
        while time.monotonic() < ends:
            timer.set_at(far)
            assert not timer.consume_expiry()
    finally:
        sys.setswitchinterval(interval)
        for thread in threads:
            thread.join()
        other.close()
