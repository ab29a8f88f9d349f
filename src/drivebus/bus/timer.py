"""Timers of the buses of an event loop.

An asyncio loop on Linux sleeps in whole milliseconds and wakes 0.1 to 0.3 ms late, at 19,200 baud half a character gap,
so there a timerfd wakes its selector: ``TimerQueue``, shared by all buses of the loop. Elsewhere (Windows, macOS,
virtual loops) the loop's own ``call_at`` and clock serve: ``EventLoopTimers``.
"""

from __future__ import annotations

import asyncio
import contextlib
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import partial
from heapq import heappop, heappush
from math import inf
from weakref import WeakKeyDictionary

from drivebus.timerfd import CLOCK_BOOTTIME, TimerFd

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


class BusTimer(ABC):
    """The next moment of one bus, after which the timer calls back once. ``when``: that moment, inf for none."""

    __slots__ = ("_callback", "when")

    def __init__(self, callback: Callable[[], None]) -> None:
        self._callback = callback
        self.when = inf

    @abstractmethod
    def set(self, when: float | None) -> None:
        """Call back at ``when`` on the clock of its timers (None: not at all), instead of at the moment before."""

    def fire(self, now: float) -> None:
        """Call back now."""
        when, self.when = self.when, inf
        self._callback()
        if self.when == when:  # the bus has a clock of its own, which is behind
            self.set(now + SLOW_CLOCK_RETRY_S)


class QueuedTimer(BusTimer):
    """A timer in the queue of the kernel timers. Moving it later costs nothing."""

    __slots__ = ("_queue", "lead_s", "queued_times")

    def __init__(self, queue: TimerQueue, callback: Callable[[], None], lead_s: float) -> None:
        super().__init__(callback)
        self._queue = queue
        self.lead_s = lead_s
        """The queue wakes so long before ``when``, and waits out the rest in a loop."""
        self.queued_times: list[float] = []
        """The moments at which the queue checks this timer, the next one last."""

    def set(self, when: float | None) -> None:
        self.when = inf if when is None else when
        check_at = self.when - self.lead_s
        if when is not None and (not self.queued_times or check_at < self.queued_times[-1]):
            self._queue.schedule(self, check_at)


class EventLoopTimer(BusTimer):
    """A timer of the event loop itself."""

    __slots__ = ("_handle", "_loop")

    def __init__(self, loop: asyncio.AbstractEventLoop, callback: Callable[[], None]) -> None:
        super().__init__(callback)
        self._loop = loop
        self._handle: asyncio.TimerHandle | None = None

    def set(self, when: float | None) -> None:
        self.when = inf if when is None else when
        if self._handle is not None:
            self._handle.cancel()
        self._handle = None if when is None else self._loop.call_at(when, self._on_expired)

    def _on_expired(self) -> None:
        self._handle = None
        now = self._loop.time()
        if now < self.when:  # a loop calls back earlier by up to the resolution of its clock
            self.set(self.when)
        else:
            self.fire(now)


class EventLoopTimers:
    """Timers of an event loop without kernel timers."""

    precise = False
    user_count = 0
    """Buses that have acquired these timers and not released them."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self.now: Callable[[], float] = loop.time

    def create_timer(self, callback: Callable[[], None], *, hides_wake_up: bool = False) -> BusTimer:
        """Return a timer of this loop. ``hides_wake_up`` has no effect: how late the loop wakes is not known."""
        return EventLoopTimer(self._loop, callback)

    def close(self) -> None:
        """Nothing is left to close: each bus unsets its timer."""


class TimerQueue:
    """All timers of one loop in one heap, and the two kernel timers that wake the loop for them. Linux only."""

    precise = True
    user_count = 0

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        """Raises OSError, NotImplementedError or AttributeError where the system or the loop has no such timer."""
        self._heap: list[tuple[float, int, QueuedTimer]] = []
        self._count = 0
        self._running = False
        self.now: Callable[[], float] = partial(time.clock_gettime, CLOCK_BOOTTIME)
        """It goes on while the system is suspended: a command queued before has expired afterwards."""
        self._near = _KernelTimer(loop, self._run_due)
        try:
            self._far = _KernelTimer(loop, self._run_due)
        except BaseException:
            self._near.close()
            raise

    def create_timer(self, callback: Callable[[], None], *, hides_wake_up: bool = False) -> BusTimer:
        """Return a timer of this queue. ``hides_wake_up``: kernel timers wake ``WAKE_UP_S`` before its moment."""
        return QueuedTimer(self, callback, WAKE_UP_S if hides_wake_up else 0.0)

    def schedule(self, timer: QueuedTimer, check_at: float) -> None:
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
                if at > now and at > (now := self.now()) + TIMER_SLACK_S:
                    break
                heappop(heap)
                timer.queued_times.pop()
                when, check_at = timer.when, timer.when - timer.lead_s
                if check_at <= at:
                    if when > now:
                        busy_wait(self.now, when)
                    timer.fire(now)
                elif when != inf and (not timer.queued_times or check_at < timer.queued_times[-1]):
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
        self.armed_at = inf
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
        self.armed_at = inf
        self._timer.consume_expiry()
        self._callback()

    def close(self) -> None:
        if not self._loop.is_closed():
            self._loop.remove_reader(self._timer.fd)
        self._timer.close()


BusTimers = TimerQueue | EventLoopTimers
_timers: WeakKeyDictionary[asyncio.AbstractEventLoop, BusTimers] = WeakKeyDictionary()


def loop_now(loop: asyncio.AbstractEventLoop) -> float:
    """Return the time on the clock that the timers of this loop use (or would use)."""
    timers = acquire(loop)
    try:
        return timers.now()
    finally:
        release(loop)


def acquire(loop: asyncio.AbstractEventLoop) -> BusTimers:
    """Return the timers of this loop, created for its first bus and closed when the last one releases them."""
    timers = _timers.get(loop)
    if timers is None:
        timers = _timers[loop] = _create_timers(loop)
    timers.user_count += 1
    return timers


def release(loop: asyncio.AbstractEventLoop) -> None:
    """Release the timers of this loop for one bus."""
    timers = _timers[loop]
    timers.user_count -= 1
    if timers.user_count == 0:
        del _timers[loop]
        timers.close()


def _create_timers(loop: asyncio.AbstractEventLoop) -> BusTimers:
    sys.setswitchinterval(min(sys.getswitchinterval(), MAX_SWITCH_INTERVAL_S))
    if sys.platform == "linux":
        with contextlib.suppress(OSError, NotImplementedError, AttributeError):
            return TimerQueue(loop)
    return EventLoopTimers(loop)
