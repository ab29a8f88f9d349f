"""Many tasks hand something over; one thread keeps it, all that waits at a time (group commit)."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Generic, TypeVar

T = TypeVar("T")
R = TypeVar("R")
V = TypeVar("V")

MAX_UNATTENDED_ITEMS = 10_000
"""So much is kept for a disk that has failed; then the oldest are dropped and counted (I12)."""


@dataclass(frozen=True, slots=True, eq=False)
class _PendingItem(Generic[T, R]):
    item: T
    result: asyncio.Future[R] | None
    """None: nobody waits; it is tried again until it is kept."""


class BatchWriter(Generic[T, R]):
    """``keep`` runs in a thread, with one batch at a time; it keeps all of it or raises.

    ``put`` returns when its item is kept, or raises what ``keep`` raised. ``post`` never waits and never raises:
    after a failure its item is tried again with the next batch, in order, before everything newer.
    """

    def __init__(self, name: str, write_batch: Callable[[Sequence[T]], Sequence[R]]) -> None:
        self._write_batch = write_batch
        self._queue: deque[_PendingItem[T, R]] = deque()
        self._thread = ThreadPoolExecutor(1, thread_name_prefix=name)
        self._task: asyncio.Task[None] | None = None
        self.error: Exception | None = None
        """Why the last batch was not kept; None while all is well."""
        self.dropped = 0

    async def write(self, item: T) -> R:
        """Kept when it returns."""
        told: asyncio.Future[R] = asyncio.get_running_loop().create_future()
        self._queue.append(_PendingItem(item, told))
        self.retry()
        return await told

    def write_nowait(self, item: T) -> None:
        """Kept soon, or when the disk works again."""
        if len(self._queue) >= MAX_UNATTENDED_ITEMS:
            self._drop_oldest()
        self._queue.append(_PendingItem(item, None))
        self.retry()

    def retry(self) -> None:
        """Try what waits; called again and again by somebody's timer, it ends a failure that is over."""
        if self._queue and (self._task is None or self._task.done()):
            self._task = asyncio.get_running_loop().create_task(self._write_pending(), name="keep what waits")

    async def flush(self) -> None:
        """Keep what waits, once more; what then still waits is on no disk."""
        self.retry()
        while self._task is not None and not self._task.done():
            await asyncio.wait([self._task])

    async def close(self) -> None:
        """``drain``, and end the thread. Nothing may be put in afterwards."""
        await self.flush()
        self._thread.shutdown(wait=False)

    async def _write_pending(self) -> None:
        while self._queue:
            batch = [*self._queue]
            self._queue.clear()
            try:
                kept = await self.run_in_thread(partial(self._write_batch, [one.item for one in batch]))
            except Exception as error:  # whatever it is, whoever waits is told, and what was posted is not lost
                self._on_failure(batch, error)
                if all(one.result is None for one in self._queue):
                    return
                continue
            self.error = None
            for one, result in zip(batch, kept, strict=True):
                if one.result is not None and not one.result.done():
                    one.result.set_result(result)

    async def run_in_thread(self, function: Callable[[], V]) -> V:
        """In the same thread, between two batches."""
        return await asyncio.get_running_loop().run_in_executor(self._thread, function)

    def _on_failure(self, batch: list[_PendingItem[T, R]], error: Exception) -> None:
        """Who waited for it is refused; what was posted stays first in the row."""
        self.error = error
        self._queue.extendleft(one for one in reversed(batch) if one.result is None)
        for one in batch:
            if one.result is not None and not one.result.done():
                one.result.set_exception(error)

    def _drop_oldest(self) -> None:
        oldest = next((one for one in self._queue if one.result is None), None)
        if oldest is not None:
            self._queue.remove(oldest)
            self.dropped += 1
