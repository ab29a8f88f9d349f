"""Signals that end an attached command: Ctrl-C, Ctrl-\\, Ctrl-Z, a closed terminal, a request to terminate."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Awaitable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, TypeVar

from drivebus.terminal import discard_terminal_output

T = TypeVar("T")

_SIGNAL_NAMES = ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK", "SIGQUIT")
"""SIGHUP: terminal closed; SIGBREAK: the same on Windows; SIGQUIT: Ctrl-\\, which would leave the motor on."""
_SUSPEND_SIGNAL = "SIGTSTP"
"""Ctrl-Z, which would suspend the command while its motor turns on unwatched."""


class ShutdownSignal:
    """Request to shut down, set by the first signal.

    Later signals change nothing: a second Ctrl-C must not interrupt a stop.
    """

    def __init__(self) -> None:
        self._event = asyncio.Event()
        self.cause: str | None = None

    @property
    def received(self) -> bool:
        return self._event.is_set()

    def request(self, cause: str) -> None:
        """Request the shutdown, as a signal does."""
        self.cause = self.cause or cause
        self._event.set()

    async def wait(self, timeout_s: float | None = None) -> bool:
        """Wait for the request; return False after ``timeout_s`` seconds without one."""
        try:
            await asyncio.wait_for(self._event.wait(), timeout_s)
        except TimeoutError:
            return False
        return True

    async def interruptible(self, work: Awaitable[T]) -> T | None:
        """Return the result of ``work``; None if the shutdown was requested first (``work`` is then cancelled)."""
        task = asyncio.ensure_future(work)
        shutdown = asyncio.ensure_future(self._event.wait())
        try:
            await asyncio.wait({task, shutdown}, return_when=asyncio.FIRST_COMPLETED)
            if task.done():
                return task.result()
            return None
        finally:
            for each in (task, shutdown):
                each.cancel()
            await asyncio.gather(task, shutdown, return_exceptions=True)


@contextmanager
def shutdown_signals(*, may_suspend: bool = True) -> Iterator[ShutdownSignal]:
    """Provide a ``ShutdownSignal`` set by the signals of the process; restore the former handlers at the end.

    ``may_suspend`` False: the command has a motor run, and Ctrl-Z is a request to shut down too.
    """
    shutdown = ShutdownSignal()
    loop = asyncio.get_running_loop()
    former: dict[int, Any] = {}
    for name in _SIGNAL_NAMES if may_suspend else (*_SIGNAL_NAMES, _SUSPEND_SIGNAL):
        number = getattr(signal, name, None)
        if number is None:
            continue
        former[number] = signal.getsignal(number)
        try:
            loop.add_signal_handler(number, _on_signal, shutdown, name)
        except NotImplementedError:
            signal.signal(number, lambda *_, name=name: loop.call_soon_threadsafe(_on_signal, shutdown, name))
    try:
        yield shutdown
    finally:
        for number, handler in former.items():
            with suppress(NotImplementedError):
                loop.remove_signal_handler(number)
            signal.signal(number, handler)


def _on_signal(shutdown: ShutdownSignal, name: str) -> None:
    shutdown.request(name)
    if name == "SIGHUP":
        discard_terminal_output()  # a failed write must not interrupt a stop
