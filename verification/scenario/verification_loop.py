"""The laboratory's own virtual-time loop: one heap of callbacks, one clock that jumps, nothing else.

It speaks as much of asyncio's interface as the real bus, the real drives and the simulated bench ask for, so that
they run on it unchanged, several times faster than on an asyncio loop whose clock is faked: no selector, no context
switch, no wake-up pipe. Ties in time go in the order in which they were asked for, so that a run is repeatable to the
last event.
"""

from __future__ import annotations

import asyncio
from asyncio import events
from collections import deque
from collections.abc import Callable, Coroutine
from heapq import heapify, heappop, heappush
from typing import TYPE_CHECKING, Any, TypeVar

T = TypeVar("T")


class Stuck(RuntimeError):
    """Nothing is ready and no timer is set: what is waited for can never come."""


class VerificationTimer:
    """A callback in the heap, or one that is ready."""

    __slots__ = ("_when", "args", "callback")

    def __init__(self, callback: Callable[..., object], args: tuple[Any, ...], when: float) -> None:
        self.callback: Callable[..., object] | None = callback
        self.args = args
        self._when = when

    def when(self) -> float:
        return self._when

    def cancel(self) -> None:
        self.callback = None
        self.args = ()


if TYPE_CHECKING:

    class _Interface:
        """The loop gives what is asked of it; asyncio's interface has forty more methods."""

else:
    _Interface = asyncio.AbstractEventLoop


class VerificationLoop(_Interface):
    """Virtual seconds from ``start``. One thread; no sockets, signals or processes."""

    def __init__(self, start: float = 0.0) -> None:
        self._now = start
        self._heap: list[tuple[float, int, VerificationTimer]] = []
        self._ready: deque[VerificationTimer] = deque()
        self._count = 0
        self.tasks: dict[asyncio.Task[Any], None] = {}
        """In the order in which they began, so that they are also ended in one order."""
        self.failed: list[dict[str, Any]] = []
        """What was given to the exception handler: every one of them is a finding (I8)."""

    # --- what asyncio asks ---------------------------------------------------------------------------------------

    def time(self) -> float:
        return self._now

    def call_soon(self, callback: Callable[..., object], *args: Any, context: Any = None) -> Any:
        timer = (
            VerificationTimer(callback, args, self._now)
            if context is None
            else VerificationTimer(context.run, (callback, *args), 0.0)
        )
        self._ready.append(timer)
        return timer

    call_soon_threadsafe = call_soon

    def call_at(self, when: float, callback: Callable[..., object], *args: Any, context: Any = None) -> Any:
        timer = VerificationTimer(callback, args, when)
        self._count += 1
        heappush(self._heap, (when, self._count, timer))
        return timer

    def call_later(self, delay: float, callback: Callable[..., object], *args: Any, context: Any = None) -> Any:
        return self.call_at(self._now + delay, callback, *args)

    def create_future(self) -> asyncio.Future[Any]:
        return asyncio.Future(loop=self)  # type: ignore[arg-type]

    def create_task(self, coro: Any, *, name: Any = None, context: Any = None) -> Any:
        task = asyncio.Task(coro, loop=self, name=name)  # type: ignore[arg-type]
        self.tasks[task] = None
        task.add_done_callback(self.tasks.pop)
        return task

    def run_in_executor(self, executor: Any, func: Callable[..., T], *args: Any) -> Any:
        """At once: threads have no place in virtual time."""
        future = self.create_future()
        try:
            future.set_result(func(*args))
        except Exception as error:
            future.set_exception(error)
        return future

    def call_exception_handler(self, context: dict[str, Any]) -> None:
        self.failed.append(context)

    def get_debug(self) -> bool:
        return False

    def is_running(self) -> bool:
        return True

    def is_closed(self) -> bool:
        return False

    def next_at(self) -> float | None:
        """When the next timer is set for."""
        return self._heap[0][0] if self._heap else None

    # --- running -------------------------------------------------------------------------------------------------

    def run_until(self, when: float) -> None:
        """Everything up to and at that second."""
        with running(self):
            while self._step(when):
                pass
        self._now = max(self._now, when)

    def suspend(
        self,
        seconds: float,
        goes_on: Callable[[VerificationTimer], bool],
        stands_still: Callable[[VerificationTimer], bool],
    ) -> None:
        """The program is not run for so long; only timers that go on are served in time, the others come late.

        A timer whose clock stands still meanwhile is moved by as much.
        """
        end = self._now + seconds
        held = [entry for entry in self._heap if not goes_on(entry[2])]
        self._heap = [entry for entry in self._heap if goes_on(entry[2])]
        heapify(self._heap)
        self.run_until(end)
        for when, number, timer in held:
            heappush(self._heap, (when + seconds if stands_still(timer) else when, number, timer))

    def run(self, coroutine: Coroutine[Any, Any, T]) -> T:
        """A coroutine to its end; its result or its error. Raises Stuck where it waits for what can't come."""
        with running(self):
            task = self.create_task(coroutine)
            while not task.done():
                if not self._step(float("inf")):
                    raise Stuck(f"at {self._now:.6f} s: {len(self.tasks)} task(s) wait and no timer is set")
        result: T = task.result()
        return result

    def _step(self, until: float) -> bool:
        """All that is ready, or the next timer; False where there is neither by ``until``."""
        ready, heap = self._ready, self._heap
        if ready:
            for _ in range(len(ready)):
                timer = ready.popleft()
                if timer.callback is not None:
                    timer.callback(*timer.args)
            return True
        while heap and heap[0][0] <= until:
            when, _, timer = heappop(heap)
            if timer.callback is not None:
                if when > self._now:
                    self._now = when
                timer.callback(*timer.args)
                return True
        return False


class running:
    """``with running(loop):`` this loop is the running one: for calls from outside its callbacks."""

    def __init__(self, loop: VerificationLoop) -> None:
        self._loop = loop

    def __enter__(self) -> None:
        self._outer = events._get_running_loop()
        events._set_running_loop(self._loop)  # type: ignore[arg-type]

    def __exit__(self, *_: object) -> None:
        events._set_running_loop(self._outer)
