"""The kernel timer: never early, cleared when it is set again, independent of others."""

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
    timer = TimerFd()
    yield timer
    timer.close()


def test_a_timer_expires_at_its_second_and_not_before(timer: TimerFd) -> None:
    when = time.monotonic() + 0.02
    timer.set_at(when)
    select.select([timer.fd], [], [], 5.0)
    assert time.monotonic() >= when
    assert timer.consume_expiry() and not timer.consume_expiry()


def test_setting_a_timer_again_clears_an_unread_expiry(timer: TimerFd) -> None:
    timer.set_at(1e-6)
    assert select.select([timer.fd], [], [], 5.0)[0]
    timer.set_at(0.0)
    assert not timer.consume_expiry()


def test_timers_of_several_threads_are_independent(timer: TimerFd) -> None:
    """Threads that shared the structure for the kernel would sometimes set a timer to another's time."""
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
