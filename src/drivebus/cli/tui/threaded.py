"""A feed in a thread and loop of its own, so that drawing a screen never delays a bus; rows cross as values."""

from __future__ import annotations

import asyncio
import contextvars
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from drivebus.cli.tui.row_source import KeyCommands, RowSource
from drivebus.cli.tui.rows import BusRow, DriveRow

SNAPSHOT_PERIOD_S = 0.2
"""How often the rows are taken; the screen draws no faster."""


@dataclass(frozen=True, slots=True)
class RowSnapshot:
    """Everything that the view shows, taken at one moment of the feed's own time."""

    now: float = 0.0
    drives: Sequence[DriveRow] = ()
    lines: Sequence[BusRow] = ()
    news: Sequence[str] = ()
    over: bool = False


class ThreadedRowSource:
    """A ``Feed`` (and ``Control``) around another one that lives in its own thread."""

    def __init__(self, feed: RowSource, control: KeyCommands | None = None) -> None:
        self.title = feed.title
        self._feed = feed
        self._control = control
        self._snapshot = RowSnapshot()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._end: asyncio.Event | None = None
        self._failure: BaseException | None = None
        self._ready = threading.Event()
        self._thread: threading.Thread | None = None

    async def start(self) -> None:
        """Begin; returns when the feed has started. Raises what its start raised."""
        context = contextvars.copy_context()
        self._thread = threading.Thread(
            target=context.run, args=(asyncio.run, self._run_source()), name="drivebus-feed"
        )
        self._thread.start()
        await asyncio.to_thread(self._ready.wait)
        if self._failure is not None:
            raise self._failure

    async def close(self) -> None:
        """End the feed and wait for it. Idempotent."""
        if self._thread is None:
            return
        if self._loop is not None and self._end is not None and self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._end.set)
        await asyncio.to_thread(self._thread.join)

    async def _run_source(self) -> None:
        self._loop, self._end = asyncio.get_running_loop(), asyncio.Event()
        try:
            await self._feed.start()
        except BaseException as error:
            self._failure = error
            await self._feed.close()
            return
        finally:
            self._ready.set()
        try:
            while not self._end.is_set():
                self._take_snapshot()
                try:
                    await asyncio.wait_for(self._end.wait(), SNAPSHOT_PERIOD_S)
                except TimeoutError:
                    continue
        finally:
            await self._feed.close()

    def _take_snapshot(self) -> None:
        feed = self._feed
        self._snapshot = RowSnapshot(feed.now(), feed.drives(), feed.lines(), tuple(feed.news()), feed.over)

    def now(self) -> float:
        return self._snapshot.now

    def drives(self) -> Sequence[DriveRow]:
        return self._snapshot.drives

    def lines(self) -> Sequence[BusRow]:
        return self._snapshot.lines

    def news(self) -> Sequence[str]:
        return self._snapshot.news

    @property
    def over(self) -> bool:
        return self._snapshot.over

    def _call_in_thread(self, command: Callable[..., None], *arguments: Any) -> None:
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(command, *arguments)

    def run(self, key: str) -> None:
        if self._control is not None:
            self._call_in_thread(self._control.run, key)

    def stop(self, key: str) -> None:
        if self._control is not None:
            self._call_in_thread(self._control.stop, key)

    def change(self, key: str, by_hz: float) -> None:
        if self._control is not None:
            self._call_in_thread(self._control.change, key, by_hz)

    def reset(self, key: str) -> None:
        if self._control is not None:
            self._call_in_thread(self._control.reset, key)

    def stop_all(self) -> None:
        if self._control is not None:
            self._call_in_thread(self._control.stop_all)
