"""One precise timer for an event loop, shared by all its buses.

An asyncio loop on Linux sleeps in whole milliseconds and wakes 0.1 to 0.3 ms late; at 19,200 baud that is half a
character gap. A timerfd wakes the loop's selector at the very microsecond. Where there is none (Windows, macOS,
virtual loops) the loop's own ``call_at`` and its clock serve.

The clock of a bus goes on while the system is suspended, which a loop's does not: what was queued before has expired
when the system resumes, and nothing of it is sent hours late (I1, ruling 12).
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
TIMER_SLACK_S = 20e-6
"""An alarm that is due within this time is served now: arming the timer again would take as long."""


SLOW_CLOCK_RETRY_S = 0.001
"""How soon a bus whose own clock is behind this one is called back: without a pause it would hold up the whole loop."""
KERNEL_TIMER_HORIZON_S = 0.01
"""Setting a kernel timer costs as much as a whole transaction. Deadlines are far and seldom reached, gaps are near:
each has a waker of its own, so that a gap does not cost the deadline its setting."""


class TimerBackend(Protocol):
    """Something that calls back at one moment. ``armed``: when, NEVER if not at all (as while it calls back)."""

    armed_at: float

    def arm(self, when: float) -> None: ...
    def close(self) -> None: ...


class BusTimer:
    """One bus's next moment. ``set`` replaces the moment before."""

    __slots__ = ("_queue", "callback", "queued_times", "when")

    def __init__(self, queue: TimerQueue, callback: Callable[[], None]) -> None:
        self._queue = queue
        self.callback = callback
        self.when = NEVER
        self.queued_times: list[float] = []
        """The moments at which the timer looks at this alarm, the next one last."""

    def set(self, when: float | None) -> None:
        """Call back at ``when`` on the timer's clock (None: not at all). Moving it later costs nothing."""
        self.when = NEVER if when is None else when
        if when is not None and (not self.queued_times or when < self.queued_times[-1]):
            self._queue.schedule(self, when)


class TimerQueue:
    """All alarms of one loop in one heap, and what wakes the loop for them."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._heap: list[tuple[float, int, BusTimer]] = []
        self._count = 0
        self._running = False
        self.precise = False
        self.now: Callable[[], float] = loop.time
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
                self.now = partial(time.clock_gettime, CLOCK_BOOTTIME)
                return near, far
        waker = _LoopTimer(loop, self._run_due)
        return waker, waker

    def create_timer(self, callback: Callable[[], None]) -> BusTimer:
        return BusTimer(self, callback)

    def schedule(self, alarm: BusTimer, when: float) -> None:
        """Look at this alarm at that moment: it is earlier than any moment at which that would be done anyway."""
        alarm.queued_times.append(when)
        self._count += 1
        heappush(self._heap, (when, self._count, alarm))
        if not self._running:
            self._arm(when)

    def close(self) -> None:
        self._near.close()
        self._far.close()
        self._heap.clear()

    def _arm(self, when: float) -> None:
        """Wake at ``when`` or before."""
        if when < self._near.armed_at and when < self._far.armed_at:
            near = when < self.now() + KERNEL_TIMER_HORIZON_S
            (self._near if near else self._far).arm(when)

    def _run_due(self) -> None:
        """Call whoever is due, then arm for the next one. An alarm that was moved since is looked at again then."""
        heap = self._heap
        self._running = True
        now = self.now()
        try:
            while heap:
                at, _, alarm = heap[0]
                if at > now and not (self.precise and at <= (now := self.now()) + TIMER_SLACK_S):
                    break
                heappop(heap)
                alarm.queued_times.pop()
                when = alarm.when
                if when <= at:
                    alarm.when = NEVER
                    if when > now:
                        busy_wait(self.now, when)
                    alarm.callback()
                    if alarm.when == when:  # its bus's own clock has not come so far
                        alarm.when = now + SLOW_CLOCK_RETRY_S
                elif when != NEVER and (not alarm.queued_times or when < alarm.queued_times[-1]):
                    self.schedule(alarm, when)
        finally:
            self._running = False
            if heap:
                self._arm(heap[0][0])


def busy_wait(now: Callable[[], float], when: float) -> None:
    """The last microseconds: never early, so that no gap is ever short."""
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


_timers: WeakKeyDictionary[asyncio.AbstractEventLoop, tuple[TimerQueue, list[int]]] = WeakKeyDictionary()


def loop_now(loop: asyncio.AbstractEventLoop) -> float:
    """Now, on the clock that the loop's timer uses (or would use)."""
    timer = acquire(loop)
    try:
        return timer.now()
    finally:
        release(loop)


def acquire(loop: asyncio.AbstractEventLoop) -> TimerQueue:
    """The loop's timer; made by its first bus, closed when the last one lets go of it."""
    timer, users = _timers.get(loop) or (TimerQueue(loop), [0])
    _timers[loop] = (timer, users)
    users[0] += 1
    return timer


def release(loop: asyncio.AbstractEventLoop) -> None:
    """One bus less."""
    timer, users = _timers[loop]
    users[0] -= 1
    if users[0] == 0:
        del _timers[loop]
        timer.close()
