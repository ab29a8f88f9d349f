"""Virtual time for asyncio: the loop's clock jumps to the next timer whenever nothing is ready.

A day of bus traffic takes seconds and every duration is exact. There are no sockets and no threads:
``run_in_executor`` calls its function at once, and waiting for something that no timer can bring is an error.
"""

from __future__ import annotations

import asyncio
from asyncio import base_events
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

T = TypeVar("T")

MAX_VIRTUAL_S = 30 * 86400.0  # a test still waiting after a virtual month waits for something that never comes


class Deadlock(RuntimeError):
    """Nothing is ready and no timer is set, or the longest virtual time has passed: the test would hang for ever."""


class _JumpingSelector:
    """Replacement of a selector: instead of sleeping until the next timer, moves the clock to it."""

    def __init__(self, loop: VirtualLoop) -> None:
        self._loop = loop

    def select(self, timeout: float | None) -> list[Any]:
        if timeout is None or timeout > 0:
            self._loop.advance()
        return []


class VirtualLoop(base_events.BaseEventLoop):
    """An asyncio loop whose ``time()`` is virtual seconds. Sockets, pipes and signals raise NotImplementedError."""

    def __init__(self, start: float = 0.0, max_s: float = MAX_VIRTUAL_S) -> None:
        super().__init__()
        self._now = start
        self._end = start + max_s
        self._selector = _JumpingSelector(self)

    def time(self) -> float:
        return self._now

    def advance(self) -> None:
        """Move the clock to the next timer. Raises Deadlock where there is none."""
        scheduled: list[asyncio.TimerHandle] = self._scheduled  # type: ignore[attr-defined]
        if not scheduled:
            raise Deadlock(f"at {self._now:.6f} s: {self._waiting()} and no timer is set, so nothing can ever happen")
        when = scheduled[0].when()
        if when > self._end:
            raise Deadlock(f"at {self._now:.6f} s: {self._waiting()}; the longest virtual time has passed")
        self._now = max(self._now, when)

    def run_in_executor(self, executor: Any, func: Callable[..., T], *args: Any) -> asyncio.Future[T]:  # type: ignore[override]
        """Call the function at once, without a thread."""
        future: asyncio.Future[T] = self.create_future()
        try:
            future.set_result(func(*args))
        except Exception as error:
            future.set_exception(error)
        return future

    def _waiting(self) -> str:
        tasks = sorted(task.get_name() for task in asyncio.all_tasks(self))
        return f"{len(tasks)} task(s) wait ({', '.join(tasks[:8])})"

    def _process_events(self, event_list: list[Any]) -> None:
        """Do nothing: there are only timers and callbacks."""

    def _write_to_self(self) -> None:
        """Do nothing: the loop never sleeps."""


def run(coroutine: Coroutine[Any, Any, T], *, start: float = 0.0, max_s: float = MAX_VIRTUAL_S) -> T:
    """Run a coroutine to its end in virtual time that begins at ``start`` seconds; returns its result.

    Raises Deadlock where it waits for something that no timer can bring. Tasks left over are cancelled.
    """
    with asyncio.Runner(loop_factory=lambda: VirtualLoop(start, max_s)) as runner:
        return runner.run(coroutine)
