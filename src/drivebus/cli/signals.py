"""How an attached verb learns that it must end: Ctrl-C, a terminal that goes away, or a request to terminate."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from collections.abc import Awaitable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, TypeVar

T = TypeVar("T")

_SIGNAL_NAMES = ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")
"""SIGHUP: the terminal is gone. SIGBREAK: its Windows cousin. What a platform lacks is left out."""


class ShutdownSignal:
    """Set by the first signal; later ones change nothing, so that a second Ctrl-C can't cut a stop short."""

    def __init__(self) -> None:
        self._event = asyncio.Event()
        self.cause: str | None = None

    @property
    def received(self) -> bool:
        return self._event.is_set()

    def request(self, cause: str) -> None:
        """Ask for the end, as a signal would."""
        self.cause = self.cause or cause
        self._event.set()

    async def wait(self, timeout_s: float | None = None) -> bool:
        """Wait for it; True when it has come, False after ``timeout_s``."""
        try:
            await asyncio.wait_for(self._event.wait(), timeout_s)
        except TimeoutError:
            return False
        return True

    async def interruptible(self, work: Awaitable[T]) -> T | None:
        """The result of ``work``; None where the end came first (``work`` is then cancelled)."""
        task = asyncio.ensure_future(work)
        ending = asyncio.ensure_future(self._event.wait())
        try:
            await asyncio.wait({task, ending}, return_when=asyncio.FIRST_COMPLETED)
            if task.done():
                return task.result()
            return None
        finally:
            for each in (task, ending):
                each.cancel()
            await asyncio.gather(task, ending, return_exceptions=True)


@contextmanager
def shutdown_signals() -> Iterator[ShutdownSignal]:
    """An ``Ending`` that the process' signals set; the former handlers are restored afterwards."""
    ending = ShutdownSignal()
    loop = asyncio.get_running_loop()
    former: dict[int, Any] = {}
    for name in _SIGNAL_NAMES:
        number = getattr(signal, name, None)
        if number is None:
            continue
        former[number] = signal.getsignal(number)
        try:
            loop.add_signal_handler(number, _on_signal, ending, name)
        except NotImplementedError:
            signal.signal(number, lambda *_, name=name: loop.call_soon_threadsafe(_on_signal, ending, name))
    try:
        yield ending
    finally:
        for number, handler in former.items():
            with suppress(NotImplementedError):
                loop.remove_signal_handler(number)
            signal.signal(number, handler)


def _on_signal(ending: ShutdownSignal, name: str) -> None:
    if name == "SIGHUP":
        discard_output()
    ending.request(name)


def discard_output() -> None:
    """The terminal is gone: what is still printed goes nowhere, so that no failed write can stop the stop."""
    with suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        for stream in (sys.stdout, sys.stderr):
            os.dup2(nowhere, stream.fileno())
        os.close(nowhere)
