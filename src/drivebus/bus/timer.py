"""Precise timer queue of an event loop, shared by all its buses.

An asyncio loop on Linux sleeps in whole milliseconds and wakes 0.1 to 0.3 ms late, at 19,200 baud half a character gap,
so a timerfd wakes its selector. Where there is none (Windows, macOS, virtual loops) the loop's own ``call_at`` and its
clock serve.
"""

from __future__ import annotations

import asyncio
import contextlib
import sys
import time
from collections.abc import Callable
from functools import partial
from heapq import heappop, heappush
from typing import Protocol
from weakref import WeakKeyDictionary

from drivebus.timerfd import CLOCK_BOOTTIME, TimerFd

NEVER = float("inf")
TIMER_SLACK_S = 20e-6  # a timer due within this time is served now: arming the kernel timer would take as long
WAKE_UP_S = 40e-6  # from the kernel timer's expiry to the first line of its callback, most of the time
SLOW_CLOCK_RETRY_S = 0.001  # call a bus whose own clock is behind again after this: at once would block the loop
NEAR_TIMER_HORIZON_S = 0.01
"""Limit between gaps (near) and deadlines (far), which have a timer each: setting a kernel timer costs as much as a
transaction, so a gap must not replace the setting for the deadline, which is seldom reached."""
MAX_SWITCH_INTERVAL_S = 50e-6
"""Longest time for which a busy thread of the program keeps the interpreter from the loop at each wake-up.

Python's own is 5 ms. A transaction takes several wake-ups: a busy thread cost four buses half of their answers, and
each command tens of milliseconds."""


class TimerBackend(Protocol):
    """Timer that calls back at one moment. ``armed_at``: when, NEVER if not at all (as while it calls back)."""

    armed_at: float

    def arm(self, when: float) -> None: ...
    def close(self) -> None: ...


class BusTimer:
    """The next moment of one bus. ``set`` replaces the moment before."""

    __slots__ = ("_queue", "callback", "lead_s", "queued_times", "when")

    def __init__(self, queue: TimerQueue, callback: Callable[[], None], lead_s: float) -> None:
        self._queue = queue
        self.callback = callback
        self.lead_s = lead_s
        """The queue wakes so long before ``when``, and waits out the rest in a loop."""
        self.when = NEVER
        self.queued_times: list[float] = []
        """The moments at which the queue checks this timer, the next one last."""

    def set(self, when: float | None) -> None:
        """Call back at ``when`` on the queue's clock (None: not at all). Moving it later costs nothing."""
        self.when = NEVER if when is None else when
        check_at = self.when - self.lead_s
        if when is not None and (not self.queued_times or check_at < self.queued_times[-1]):
            self._queue.schedule(self, check_at)


class TimerQueue:
    """All timers of one loop in one heap, and the backends that wake the loop for them."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._heap: list[tuple[float, int, BusTimer]] = []
        self._count = 0
        self._running = False
        self.user_count = 0
        """Buses that have acquired this queue and not released it."""
        self.precise = False
        """Whether kernel timers are in use."""
        self.now: Callable[[], float] = loop.time
        sys.setswitchinterval(min(sys.getswitchinterval(), MAX_SWITCH_INTERVAL_S))
        self._near, self._far = self._create_backends(loop)

    def _create_backends(self, loop: asyncio.AbstractEventLoop) -> tuple[TimerBackend, TimerBackend]:
        if sys.platform == "linux":
            with contextlib.suppress(OSError, NotImplementedError, AttributeError):
                near = _KernelTimer(loop, self._run_due)
                try:
                    far = _KernelTimer(loop, self._run_due)
                except BaseException:
                    near.close()
                    raise
                self.precise = True
                # This clock goes on while the system is suspended: a command queued before has expired afterwards.
                self.now = partial(time.clock_gettime, CLOCK_BOOTTIME)
                return near, far
        return _LoopTimer(loop, self._run_due), _LoopTimer(loop, self._run_due)

    def create_timer(self, callback: Callable[[], None], *, hides_wake_up: bool = False) -> BusTimer:
        """Return a timer of this queue. ``hides_wake_up``: kernel timers wake ``WAKE_UP_S`` before its moment."""
        return BusTimer(self, callback, WAKE_UP_S if hides_wake_up and self.precise else 0.0)

    def schedule(self, timer: BusTimer, check_at: float) -> None:
        """Check a timer at ``check_at``, which is earlier than any moment at which it would be checked anyway."""
        timer.queued_times.append(check_at)
        self._count += 1
        heappush(self._heap, (check_at, self._count, timer))
        if not self._running:
            self._arm(check_at)

    def close(self) -> None:
        self._near.close()
        self._far.close()
        self._heap.clear()

    def _arm(self, when: float) -> None:
        """Wake the loop at ``when`` or before."""
        if when < self._near.armed_at and when < self._far.armed_at:
            near = when < self.now() + NEAR_TIMER_HORIZON_S
            (self._near if near else self._far).arm(when)

    def _run_due(self) -> None:
        """Call the timers that are due, then arm for the next one. A timer that was moved is checked again then."""
        heap = self._heap
        self._running = True
        now = self.now()
        try:
            while heap:
                at, _, timer = heap[0]
                if at > now and not (self.precise and at <= (now := self.now()) + TIMER_SLACK_S):
                    break
                heappop(heap)
                timer.queued_times.pop()
                when, check_at = timer.when, timer.when - timer.lead_s
                if check_at <= at:
                    timer.when = NEVER
                    if when > now:
                        busy_wait(self.now, when)
                    timer.callback()
                    if timer.when == when:  # the bus has a clock of its own, which is behind
                        timer.when = now + SLOW_CLOCK_RETRY_S
                elif when != NEVER and (not timer.queued_times or check_at < timer.queued_times[-1]):
                    self.schedule(timer, check_at)
        finally:
            self._running = False
            if heap:
                self._arm(heap[0][0])


def busy_wait(now: Callable[[], float], when: float) -> None:
    """Wait the last microseconds in a loop: never early, so that no gap is too short."""
    while now() < when:
        pass


class _KernelTimer:
    """A kernel timer on CLOCK_BOOTTIME, watched by the loop's selector."""

    __slots__ = ("_callback", "_loop", "_timer", "armed_at")

    def __init__(self, loop: asyncio.AbstractEventLoop, callback: Callable[[], None]) -> None:
        self.armed_at = NEVER
        self._callback = callback
        self._timer = TimerFd(CLOCK_BOOTTIME)
        self._loop = loop
        try:
            loop.add_reader(self._timer.fd, self._on_expired)
        except BaseException:
            self._timer.close()
            raise

    def arm(self, when: float) -> None:
        self.armed_at = when
        self._timer.set_at(when)

    def _on_expired(self) -> None:
        self.armed_at = NEVER
        self._timer.consume_expiry()
        self._callback()

    def close(self) -> None:
        if not self._loop.is_closed():
            self._loop.remove_reader(self._timer.fd)
        self._timer.close()


class _LoopTimer:
    """The loop's own timer."""

    __slots__ = ("_callback", "_handle", "_loop", "armed_at")

    def __init__(self, loop: asyncio.AbstractEventLoop, callback: Callable[[], None]) -> None:
        self.armed_at = NEVER
        self._loop = loop
        self._callback = callback
        self._handle: asyncio.TimerHandle | None = None

    def arm(self, when: float) -> None:
        self.close()
        self.armed_at = when
        self._handle = self._loop.call_at(when, self._on_expired)

    def _on_expired(self) -> None:
        self.armed_at = NEVER
        self._handle = None
        self._callback()

    def close(self) -> None:
        self.armed_at = NEVER
        if self._handle is not None:
            self._handle.cancel()
            self._handle = None


_queues: WeakKeyDictionary[asyncio.AbstractEventLoop, TimerQueue] = WeakKeyDictionary()


def loop_now(loop: asyncio.AbstractEventLoop) -> float:
    """Return the time on the clock that the loop's timer queue uses (or would use)."""
    queue = acquire(loop)
    try:
        return queue.now()
    finally:
        release(loop)


def acquire(loop: asyncio.AbstractEventLoop) -> TimerQueue:
    """Return the loop's timer queue, created for its first bus and closed when the last one releases it."""
    queue = _queues.get(loop)
    if queue is None:
        queue = _queues[loop] = TimerQueue(loop)
    queue.user_count += 1
    return queue


def release(loop: asyncio.AbstractEventLoop) -> None:
    """Release the loop's timer queue for one bus."""
    queue = _queues[loop]
    queue.user_count -= 1
    if queue.user_count == 0:
        del _queues[loop]
        queue.close()
