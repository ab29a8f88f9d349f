"""A precise alarm for an asyncio loop.

On Linux' selector loops a timerfd (the loop's own timer rounds up to milliseconds); on every other loop, virtual ones
among them, the loop's own timer.
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import os
import sys
from collections.abc import Callable

_CLOCK_MONOTONIC = 1
_NONBLOCK_CLOEXEC = 0o2004000
_ABSOLUTE = 1


class _Spec(ctypes.Structure):
    """struct itimerspec: interval, then value; seconds and nanoseconds each."""

    _fields_ = [(name, ctypes.c_long) for name in ("every_s", "every_ns", "s", "ns")]


class Alarm:
    """Calls ``ring`` once when the loop's time reaches what was ``set`` last; an earlier ``set`` is forgotten."""

    def __init__(self, loop: asyncio.AbstractEventLoop, ring: Callable[[], None]) -> None:
        self._loop = loop
        self._ring = ring
        self._at: float | None = None
        self._handle: asyncio.TimerHandle | None = None
        self._fd: int | None = None
        self._libc: ctypes.CDLL | None = None
        if sys.platform == "linux" and isinstance(loop, asyncio.SelectorEventLoop):
            self._open()

    def set(self, when: float | None) -> None:
        """Ring at ``when`` (loop time; the past rings at the next turn), or not at all."""
        if when == self._at:
            return
        self._at = when
        if self._fd is not None:
            self._arm(0.0 if when is None else max(when, 1e-6))
            return
        if self._handle is not None:
            self._handle.cancel()
        self._handle = None if when is None else self._loop.call_at(when, self._due)

    def close(self) -> None:
        self.set(None)
        if self._fd is not None:
            if not self._loop.is_closed():
                self._loop.remove_reader(self._fd)
            os.close(self._fd)
            self._fd = None

    def _open(self) -> None:
        libc = ctypes.CDLL(None, use_errno=True)
        fd = libc.timerfd_create(_CLOCK_MONOTONIC, _NONBLOCK_CLOEXEC)
        if fd < 0:
            return
        self._fd, self._libc = fd, libc
        self._loop.add_reader(fd, self._fired, fd)

    def _arm(self, when: float) -> None:
        assert self._libc is not None
        seconds = int(when)
        spec = _Spec(0, 0, seconds, int((when - seconds) * 1e9))
        self._libc.timerfd_settime(self._fd, _ABSOLUTE, ctypes.byref(spec), None)

    def _fired(self, fd: int) -> None:
        with contextlib.suppress(OSError):
            os.read(fd, 8)
        if self._at is not None and self._loop.time() >= self._at - 1e-9:
            self._due()

    def _due(self) -> None:
        self._at = self._handle = None
        self._ring()
