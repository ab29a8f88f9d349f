"""``OneAtATime``: work that requests do one after another, with a limit of requests that wait."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

from drivebus.errors import ServiceUnavailable

MAX_WAITING = 20
MAX_WAITING_OF_USER = 10  # one user leaves places to the others
T = TypeVar("T")


class OneAtATime:
    """Does one work after another, so that many requests delay no bus.

    The limit is for work that takes long, on a hung disk or a slow bus: waiting requests would pile up behind it.
    """

    def __init__(self) -> None:
        self._lock = asyncio.Lock()
        self._waiting_by_user: Counter[str | None] = Counter()

    async def run(self, work: Callable[[], Coroutine[Any, Any, T]], *, user: str | None = None) -> T:
        """Return the result of a work. Raises ServiceUnavailable where too many are waiting, in all or of a ``user``.

        If the caller is cancelled, the work is cancelled too, and the next one begins when it has really ended.
        """
        waiting = self._waiting_by_user
        if waiting.total() >= MAX_WAITING or (user is not None and waiting[user] >= MAX_WAITING_OF_USER):
            raise ServiceUnavailable("plant.too_busy")
        waiting[user] += 1
        try:
            await self._lock.acquire()
        finally:
            self._waiting_by_user -= Counter({user: 1})  # without users of whom none is waiting
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
