"""Precise timer for an asyncio loop.

On Linux selector loops it is a timerfd, because the loop's own timer rounds up to milliseconds; on other loops, virtual
time among them, it is the loop's own timer.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable

from drivebus.timerfd import TimerFd


class LoopTimer:
    """Timer that calls ``callback`` once at the time that was set last."""

    def __init__(self, loop: asyncio.AbstractEventLoop, callback: Callable[[], None]) -> None:
        self._loop = loop
        self._callback = callback
        self._at: float | None = None
        self._handle: asyncio.TimerHandle | None = None
        self._timer: TimerFd | None = None
        if isinstance(loop, asyncio.SelectorEventLoop):
            with contextlib.suppress(OSError):
                self._timer = self._open_timerfd(loop)

    def _open_timerfd(self, loop: asyncio.AbstractEventLoop) -> TimerFd:
        """Return a timerfd registered with the loop. Raises OSError where the system or the selector refuses it."""
        timer = TimerFd()
        try:
            loop.add_reader(timer.fd, self._on_readable)
        except BaseException:
            timer.close()
            raise
        return timer

    def set(self, when: float | None) -> None:
        """Set the timer to ``when`` (loop time; the past fires at the next turn), or to None."""
        if when == self._at:
            return
        self._at = when
        if self._timer is not None:
            self._timer.set_at(0.0 if when is None else max(when, 1e-6))
            return
        if self._handle is not None:
            self._handle.cancel()
        self._handle = None if when is None else self._loop.call_at(when, self._fire)

    def close(self) -> None:
        self.set(None)
        if self._timer is not None:
            if not self._loop.is_closed():
                self._loop.remove_reader(self._timer.fd)
            self._timer.close()
            self._timer = None

    def _on_readable(self) -> None:
        if self._timer is not None and self._timer.consume_expiry() and self._at is not None:
            self._fire()

    def _fire(self) -> None:
        self._at = self._handle = None
        self._callback()
