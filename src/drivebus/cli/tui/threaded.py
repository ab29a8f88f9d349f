"""Row source in a thread with its own event loop, so that drawing a screen never delays a bus."""

from __future__ import annotations

import asyncio
import contextvars
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from drivebus.cli.tui.row_source import KeyCommands, RowSource
from drivebus.cli.tui.rows import BusRow, DriveRow

SNAPSHOT_PERIOD_S = 0.2  # the screen draws no faster


@dataclass(frozen=True, slots=True)
class RowSnapshot:
    """Rows and messages of one moment in the time of the source."""

    now: float = 0.0
    drives: Sequence[DriveRow] = ()
    buses: Sequence[BusRow] = ()
    messages: Sequence[str] = ()
    finished: bool = False


class ThreadedRowSource:
    """Row source and key commands that forward to those of another thread."""

    def __init__(self, source: RowSource, commands: KeyCommands | None = None) -> None:
        self.title = source.title
        self._source = source
        self._commands = commands
        self._snapshot = RowSnapshot()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._shutdown: asyncio.Event | None = None
        self._failure: BaseException | None = None
        self._ready = threading.Event()
        self._thread: threading.Thread | None = None

    async def start(self) -> None:
        """Start the source in its thread and wait for it. Raises the error of its start."""
        context = contextvars.copy_context()
        self._thread = threading.Thread(
            target=context.run, args=(asyncio.run, self._run_source()), name="drivebus-rows"
        )
        self._thread.start()
        await asyncio.to_thread(self._ready.wait)
        if self._failure is not None:
            raise self._failure

    async def close(self) -> None:
        """Close the source and wait for its thread. Idempotent."""
        if self._thread is None:
            return
        if self._loop is not None and self._shutdown is not None and self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._shutdown.set)
        await asyncio.to_thread(self._thread.join)

    async def _run_source(self) -> None:
        self._loop, self._shutdown = asyncio.get_running_loop(), asyncio.Event()
        try:
            await self._source.start()
        except BaseException as error:
            self._failure = error
            await self._source.close()
            return
        finally:
            self._ready.set()
        try:
            while not self._shutdown.is_set():
                self._take_snapshot()
                try:
                    await asyncio.wait_for(self._shutdown.wait(), SNAPSHOT_PERIOD_S)
                except TimeoutError:
                    continue
        except Exception as error:
            self._failure = error
        finally:
            await self._source.close()

    def _take_snapshot(self) -> None:
        source = self._source
        self._snapshot = RowSnapshot(
            source.now(), source.drives(), source.buses(), tuple(source.messages()), source.finished
        )

    def now(self) -> float:
        return self._snapshot.now

    def drives(self) -> Sequence[DriveRow]:
        """Return the newest rows. Raises the error that ended the source: its rows would stay, and never grow old."""
        if self._failure is not None:
            raise self._failure
        return self._snapshot.drives

    def buses(self) -> Sequence[BusRow]:
        return self._snapshot.buses

    def messages(self) -> Sequence[str]:
        return self._snapshot.messages

    @property
    def finished(self) -> bool:
        return self._snapshot.finished

    def _call_in_thread(self, command: Callable[..., None], *arguments: Any) -> None:
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(command, *arguments)

    def run(self, key: str) -> None:
        if self._commands is not None:
            self._call_in_thread(self._commands.run, key)

    def stop(self, key: str) -> None:
        if self._commands is not None:
            self._call_in_thread(self._commands.stop, key)

    def change_frequency(self, key: str, by_hz: float) -> None:
        if self._commands is not None:
            self._call_in_thread(self._commands.change_frequency, key, by_hz)

    def reset(self, key: str) -> None:
        if self._commands is not None:
            self._call_in_thread(self._commands.reset, key)

    def stop_all(self) -> None:
        if self._commands is not None:
            self._call_in_thread(self._commands.stop_all)
