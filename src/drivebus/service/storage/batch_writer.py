"""Group commit: items of many tasks are written by one thread, all waiting ones in one batch."""

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
"""Items without a waiting task that are queued while the disk fails; then the oldest are dropped and counted."""


@dataclass(frozen=True, slots=True, eq=False)
class _PendingItem(Generic[T, R]):
    item: T
    result: asyncio.Future[R] | None
    """None: no task waits; it is tried again until it is written."""


class BatchWriter(Generic[T, R]):
    """Writer of batches: ``write_batch`` runs in a thread with one batch at a time and writes all of it or raises.

    ``write`` returns when its item is written, or raises what ``write_batch`` raised. ``write_nowait`` never waits and
    never raises: after a failure its item is tried again with the next batch, in order, before everything newer.
    """

    def __init__(self, name: str, write_batch: Callable[[Sequence[T]], Sequence[R]]) -> None:
        self._write_batch = write_batch
        self._queue: deque[_PendingItem[T, R]] = deque()
        self._thread = ThreadPoolExecutor(1, thread_name_prefix=name)
        self._task: asyncio.Task[None] | None = None
        self.error: Exception | None = None
        """Error of the last batch, None where it was written."""
        self.dropped = 0

    async def write(self, item: T) -> R:
        """Write an item; it is durable on return."""
        result: asyncio.Future[R] = asyncio.get_running_loop().create_future()
        self._queue.append(_PendingItem(item, result))
        self.retry()
        return await result

    def write_nowait(self, item: T) -> None:
        """Queue an item; it is written soon, or when the disk works again."""
        if len(self._queue) >= MAX_UNATTENDED_ITEMS:
            self._drop_oldest()
        self._queue.append(_PendingItem(item, None))
        self.retry()

    def retry(self) -> None:
        """Write the queued items; called by a timer, it ends a failure of the disk."""
        if self._queue and (self._task is None or self._task.done()):
            self._task = asyncio.get_running_loop().create_task(self._write_pending(), name="write batch")

    async def flush(self) -> None:
        """Try once to write the queued items."""
        self.retry()
        while self._task is not None and not self._task.done():
            await asyncio.wait([self._task])

    async def close(self) -> None:
        """Write the queued items once more and end the thread. Nothing may be written afterwards."""
        await self.flush()
        self._thread.shutdown(wait=False)

    async def _write_pending(self) -> None:
        while self._queue:
            batch = [*self._queue]
            self._queue.clear()
            try:
                results = await self.run_in_thread(partial(self._write_batch, [pending.item for pending in batch]))
            except Exception as error:  # any error goes to the waiting tasks; the other items stay queued
                self._on_failure(batch, error)
                if all(pending.result is None for pending in self._queue):
                    return
                continue
            self.error = None
            for pending, result in zip(batch, results, strict=True):
                if pending.result is not None and not pending.result.done():
                    pending.result.set_result(result)

    async def run_in_thread(self, function: Callable[[], V]) -> V:
        """Run a function in the thread, between two batches."""
        return await asyncio.get_running_loop().run_in_executor(self._thread, function)

    def _on_failure(self, batch: list[_PendingItem[T, R]], error: Exception) -> None:
        """Pass an error to the waiting tasks; the other items stay first in the queue."""
        self.error = error
        self._queue.extendleft(pending for pending in reversed(batch) if pending.result is None)
        for pending in batch:
            if pending.result is not None and not pending.result.done():
                pending.result.set_exception(error)

    def _drop_oldest(self) -> None:
        oldest = next((pending for pending in self._queue if pending.result is None), None)
        if oldest is not None:
            self._queue.remove(oldest)
            self.dropped += 1
