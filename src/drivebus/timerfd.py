"""Linux timerfd by ctypes: a kernel timer that a selector can watch. OSError on other systems.

An event loop sleeps in whole milliseconds and wakes 0.1 to 0.3 ms late; a timerfd wakes it at the microsecond.
"""

from __future__ import annotations

import ctypes
import os
import sys
from functools import cache
from typing import Any

CLOCK_MONOTONIC = 1  # kernel clock id (time(7)); stands still while the system is suspended
CLOCK_BOOTTIME = 7  # goes on while the system is suspended
_CREATE_FLAGS = 0o2000000 | 0o4000  # TFD_CLOEXEC | TFD_NONBLOCK
_TFD_TIMER_ABSTIME = 1


class _ItimerSpec(ctypes.Structure):
    """C structure ``itimerspec``: interval, then value, each seconds and nanoseconds."""

    _fields_ = [(name, ctypes.c_long) for name in ("every_s", "every_ns", "at_s", "at_ns")]


@cache
def _libc() -> Any:
    libc = ctypes.CDLL(None, use_errno=True)
    libc.timerfd_settime.argtypes = (ctypes.c_int, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)
    return libc


def _os_error() -> OSError:
    code = ctypes.get_errno()
    return OSError(code, os.strerror(code))


class TimerFd:
    """Kernel timer; ``fd`` is readable once it has expired. Raises OSError where the system has none.

    Each timer has its own structure for the kernel: buses of several threads arm theirs at the same time.
    """

    __slots__ = ("_address", "_settime", "_spec", "fd")

    def __init__(self, clock: int = CLOCK_MONOTONIC) -> None:
        if sys.platform != "linux":
            raise OSError("timerfd is Linux only")
        self.fd: int = _libc().timerfd_create(clock, _CREATE_FLAGS)
        if self.fd < 0:
            raise _os_error()
        self._spec = _ItimerSpec()
        self._address = ctypes.byref(self._spec)
        self._settime = _libc().timerfd_settime

    def set_at(self, when: float) -> None:
        """Expire at this second, never before it; 0.0 disarms. An unread expiry is cleared either way."""
        seconds = int(when)
        self._spec.at_s = seconds
        self._spec.at_ns = int((when - seconds) * 1e9) + (1 if when else 0)
        if self._settime(self.fd, _TFD_TIMER_ABSTIME, self._address, None) != 0:
            raise _os_error()

    def consume_expiry(self) -> bool:
        """Return whether the timer has expired since it was set, and clear the expiry."""
        try:
            os.read(self.fd, 8)
        except BlockingIOError:
            return False
        return True

    def close(self) -> None:
        os.close(self.fd)
