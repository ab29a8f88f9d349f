"""``OneAtATime``: work that requests do one after another, with a limit of requests that wait."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

from drivebus.errors import ServiceUnavailable
from drivebus.service.user_quota import UserQuota

MAX_WAITING = 20
T = TypeVar("T")


class OneAtATime:
    """Does one work after another, so that many requests delay no bus.

    The limit is for work that takes long, on a hung disk or a slow bus: waiting requests would pile up behind it.
    """

    def __init__(self) -> None:
        self._lock = asyncio.Lock()
        self._waiting = UserQuota(MAX_WAITING)

    async def run(self, work: Callable[[], Coroutine[Any, Any, T]], *, user: str | None = None) -> T:
        """Return the result of a work. Raises ServiceUnavailable where too many are waiting, also of a ``user``.

        If the caller is cancelled, the work is cancelled too, and the next one begins when it has really ended.
        """
        if not self._waiting.has_place(user):
            raise ServiceUnavailable("plant.too_busy")
        with self._waiting.place(user):
            await self._lock.acquire()
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
