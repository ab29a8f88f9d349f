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

_NAMES = ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")
"""SIGHUP: the terminal is gone. SIGBREAK: its Windows cousin. What a platform lacks is left out."""


class Ending:
    """Set by the first signal; later ones change nothing, so that a second Ctrl-C can't cut a stop short."""

    def __init__(self) -> None:
        self._event = asyncio.Event()
        self.cause: str | None = None

    @property
    def come(self) -> bool:
        return self._event.is_set()

    def end(self, cause: str) -> None:
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

    async def race(self, work: Awaitable[T]) -> T | None:
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
def listening() -> Iterator[Ending]:
    """An ``Ending`` that the process' signals set; the former handlers are restored afterwards."""
    ending = Ending()
    loop = asyncio.get_running_loop()
    former: dict[int, Any] = {}
    for name in _NAMES:
        number = getattr(signal, name, None)
        if number is None:
            continue
        former[number] = signal.getsignal(number)
        try:
            loop.add_signal_handler(number, _heed, ending, name)
        except NotImplementedError:
            signal.signal(number, lambda *_, name=name: loop.call_soon_threadsafe(_heed, ending, name))
    try:
        yield ending
    finally:
        for number, handler in former.items():
            with suppress(NotImplementedError):
                loop.remove_signal_handler(number)
            signal.signal(number, handler)


def _heed(ending: Ending, name: str) -> None:
    if name == "SIGHUP":
        mute()
    ending.end(name)


def mute() -> None:
    """The terminal is gone: what is still printed goes nowhere, so that no failed write can stop the stop."""
    with suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        for stream in (sys.stdout, sys.stderr):
            os.dup2(nowhere, stream.fileno())
        os.close(nowhere)
