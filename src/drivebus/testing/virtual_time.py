"""Virtual time for asyncio: the loop's clock jumps to the next timer whenever nothing is ready.

A day of bus traffic takes seconds, every duration is exact, and events of one instant come in the order in which they
were scheduled, so that a run repeats to the last event. There is no socket, selector or thread: ``run_in_executor``
calls its function at once, and waiting for something that no timer can bring is an error.
"""

from __future__ import annotations

import asyncio
import logging
import sys
import weakref
from asyncio import events
from collections import deque
from collections.abc import AsyncGenerator, Callable, Coroutine, Iterator
from contextlib import contextmanager
from contextvars import Context
from heapq import heapify, heappop, heappush
from itertools import count
from typing import TYPE_CHECKING, Any, TypeVar

T = TypeVar("T")

MAX_VIRTUAL_S = 30 * 86400.0  # a test still waiting after a virtual month waits for something that never comes
_log = logging.getLogger("asyncio")


class Deadlock(RuntimeError):
    """No task is ready and no timer is set, or the longest virtual time has passed: the test would never end."""


class CallbackError(RuntimeError):
    """A callback raised the exception that is the cause of this one, and the loop has no exception handler."""


class VirtualTimer:
    """A scheduled callback: asyncio's handle."""

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

    def cancelled(self) -> bool:
        return self.callback is None


if TYPE_CHECKING:

    class _EventLoop:
        """Base class for type checkers, without the abstract methods of asyncio that are not used here."""

else:
    _EventLoop = asyncio.AbstractEventLoop


class VirtualLoop(_EventLoop):
    """An asyncio loop whose ``time()`` is virtual seconds from ``start``. It has no sockets, pipes or signals."""

    def __init__(self, start: float = 0.0, max_s: float = MAX_VIRTUAL_S, *, raises_errors: bool = False) -> None:
        """``raises_errors``: an exception of a callback ends the run, where there is no exception handler."""
        self._now = start
        self._end = start + max_s
        self._heap: list[tuple[float, int, VirtualTimer]] = []
        self._ready: deque[VirtualTimer] = deque()
        self._numbers = count()
        self._closed = False
        self._generators: weakref.WeakSet[AsyncGenerator[Any, Any]] = weakref.WeakSet()
        self._exception_handler: Callable[[Any, dict[str, Any]], object] | None = None
        self._raises_errors = raises_errors
        self.tasks: dict[asyncio.Task[Any], None] = {}
        """Unfinished tasks in the order of their creation."""
        self.failed: list[dict[str, Any]] = []
        """Contexts given to the exception handler."""

    # --- asyncio's interface ---------------------------------------------------------------------------------------

    def time(self) -> float:
        return self._now

    def call_soon(self, callback: Callable[..., object], *args: Any, context: Context | None = None) -> Any:
        if context is not None:
            callback, args = context.run, (callback, *args)
        timer = VirtualTimer(callback, args, self._now)
        self._ready.append(timer)
        return timer

    call_soon_threadsafe = call_soon

    def call_at(self, when: float, callback: Callable[..., object], *args: Any, context: Context | None = None) -> Any:
        if context is not None:
            callback, args = context.run, (callback, *args)
        timer = VirtualTimer(callback, args, when)
        heappush(self._heap, (when, next(self._numbers), timer))
        return timer

    def call_later(
        self, delay: float, callback: Callable[..., object], *args: Any, context: Context | None = None
    ) -> Any:
        return self.call_at(self._now + delay, callback, *args, context=context)

    def create_future(self) -> asyncio.Future[Any]:
        return asyncio.Future(loop=self)  # type: ignore[arg-type]

    def create_task(self, coro: Any, *, name: Any = None, context: Any = None) -> Any:
        task = asyncio.Task(coro, loop=self, name=name, context=context)  # type: ignore[arg-type]
        self.tasks[task] = None
        task.add_done_callback(self.tasks.pop)
        return task

    def run_in_executor(self, executor: Any, func: Callable[..., T], *args: Any) -> Any:
        """Call the function at once: threads have no place in virtual time."""
        future = self.create_future()
        try:
            future.set_result(func(*args))
        except Exception as error:
            future.set_exception(error)
        return future

    def call_exception_handler(self, context: dict[str, Any]) -> None:
        self.failed.append(context)
        if self._exception_handler is not None:
            self._exception_handler(self, context)
        else:
            _log.error(context.get("message"), exc_info=context.get("exception"))

    def set_exception_handler(self, handler: Callable[[Any, dict[str, Any]], object] | None) -> None:
        self._exception_handler = handler

    def get_exception_handler(self) -> Callable[[Any, dict[str, Any]], object] | None:
        return self._exception_handler

    def get_task_factory(self) -> None:
        return None

    def get_debug(self) -> bool:
        return False

    def set_debug(self, enabled: bool) -> None:
        pass

    def is_running(self) -> bool:
        return not self._closed

    def is_closed(self) -> bool:
        return self._closed

    def close(self) -> None:
        self._closed = True
        self._ready.clear()
        self._heap.clear()

    async def shutdown_asyncgens(self) -> None:
        for generator in list(self._generators):
            await generator.aclose()

    async def shutdown_default_executor(self, timeout: float | None = None) -> None:
        pass

    # --- running ---------------------------------------------------------------------------------------------------

    def run_until_complete(self, future: Any) -> Any:
        """Run a coroutine or future to its end. Raises Deadlock where it waits for something that can't come.

        Raises CallbackError for an exception of a callback, where the loop raises errors.
        """
        with running(self), self._track_generators():
            task = asyncio.ensure_future(future, loop=self)  # type: ignore[call-overload]
            task.add_done_callback(_make_ready)
            while not task.done():
                if not self._step(self._end):
                    raise Deadlock(f"at {self._now:.6f} s: {self._describe_waiting()}")
            if self._ready:
                self._step(self._now)
        return task.result()

    def run_until(self, when: float) -> None:
        """Run everything up to and at that second."""
        with running(self):
            while self._step(when):
                pass
        self._now = max(self._now, when)

    def next_at(self) -> float | None:
        """Return the time of the next timer."""
        return self._heap[0][0] if self._heap else None

    def suspend(
        self,
        seconds: float,
        goes_on: Callable[[VirtualTimer], bool],
        stands_still: Callable[[VirtualTimer], bool],
    ) -> None:
        """Suspend the program: only timers that go on are served in time, the others come late.

        A timer whose clock stands still meanwhile is moved by as much.
        """
        end = self._now + seconds
        late = [entry for entry in self._heap if not goes_on(entry[2])]
        self._heap[:] = [entry for entry in self._heap if goes_on(entry[2])]
        heapify(self._heap)
        self.run_until(end)
        for when, number, timer in late:
            heappush(self._heap, (when + seconds if stands_still(timer) else when, number, timer))

    def _step(self, until: float) -> bool:
        """Run all that is ready, or timers until something is ready; False where there is neither by ``until``."""
        ready, heap = self._ready, self._heap
        while not ready:
            if not heap or heap[0][0] > until:
                return False
            when, _, timer = heappop(heap)
            callback = timer.callback
            if callback is None:  # cancelled
                continue
            if when > self._now:
                self._now = when
            if heap and heap[0][0] <= self._now:
                ready.append(timer)
                break
            try:  # nearly always one timer alone, which needs no queue
                callback(*timer.args)
            except Exception as error:
                self._report(callback, error)
        while heap and heap[0][0] <= self._now:
            ready.append(heappop(heap)[2])
        for _ in range(len(ready)):
            timer = ready.popleft()
            if (callback := timer.callback) is None:
                continue
            try:
                callback(*timer.args)
            except Exception as error:
                self._report(callback, error)
        return True

    def _report(self, callback: Callable[..., object], error: Exception) -> None:
        message = f"Exception in callback {callback!r}"
        if self._raises_errors and self._exception_handler is None:
            raise CallbackError(message) from error
        self.call_exception_handler({"message": message, "exception": error})

    def _describe_waiting(self) -> str:
        names = sorted(task.get_name() for task in self.tasks)
        late = bool(self._heap)
        reason = "; the longest virtual time has passed" if late else " and no timer is set, so nothing can ever happen"
        return f"{len(names)} task(s) wait ({', '.join(names[:8])}){reason}"

    @contextmanager
    def _track_generators(self) -> Iterator[None]:
        """Close asynchronous generators that are dropped unfinished, as asyncio's own loops do."""
        before = sys.get_asyncgen_hooks()
        sys.set_asyncgen_hooks(
            firstiter=self._generators.add,
            finalizer=lambda generator: self.call_soon(self.create_task, generator.aclose()),
        )
        try:
            yield
        finally:
            sys.set_asyncgen_hooks(*before)


class running:
    """Make ``loop`` the running loop of the ``with`` block, for calls from outside its callbacks."""

    def __init__(self, loop: VirtualLoop) -> None:
        self._loop = loop

    def __enter__(self) -> None:
        self._outer = events._get_running_loop()
        events._set_running_loop(self._loop)  # type: ignore[arg-type]

    def __exit__(self, *_: object) -> None:
        events._set_running_loop(self._outer)


def _make_ready(_: object) -> None:
    """Make the loop check whether its future is done: a callback is ready then."""


def run(coroutine: Coroutine[Any, Any, T], *, start: float = 0.0, max_s: float = MAX_VIRTUAL_S) -> T:
    """Run a coroutine to its end in virtual time that begins at ``start`` seconds; returns its result.

    Raises Deadlock where it waits for something that no timer can bring, and CallbackError where a callback raises an
    exception and the loop has no exception handler. Tasks left over are cancelled.
    """

    def new_loop() -> Any:
        return VirtualLoop(start, max_s, raises_errors=True)

    with asyncio.Runner(loop_factory=new_loop) as runner:
        return runner.run(coroutine)
