"""``OneAtATime``: work that is done one after another, with a limit of those that wait."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

from drivebus.errors import ServiceUnavailable

MAX_WAITING = 20
T = TypeVar("T")


class OneAtATime:
    """Does one work after another, so that many requests delay no bus.

    A hung disk leaves waiting requests behind: without a limit they would take the place of all others.
    """

    def __init__(self) -> None:
        self._lock = asyncio.Lock()
        self._waiting = 0

    async def run(self, work: Callable[[], Coroutine[Any, Any, T]]) -> T:
        """Return the result of a work. Raises ServiceUnavailable where ``MAX_WAITING`` are waiting already.

        If the caller is cancelled, the work is cancelled too, and the next one begins when it has really ended.
        """
        if self._waiting >= MAX_WAITING:
            raise ServiceUnavailable("plant.too_busy")
        self._waiting += 1
        try:
            await self._lock.acquire()
        finally:
            self._waiting -= 1
        task = asyncio.create_task(work())
        task.add_done_callback(lambda _: self._lock.release())
        try:
            return await asyncio.shield(task)
        finally:
            task.cancel()


async def run_to_end_in_thread(function: Callable[[], T]) -> T:
    """Return the result of a function that a thread calls; where cancelled, end when the thread has."""
    call = asyncio.ensure_future(asyncio.to_thread(function))
    try:
        return await asyncio.shield(call)
    finally:
        await asyncio.wait([call])
