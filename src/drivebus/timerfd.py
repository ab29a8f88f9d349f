"""The door to Linux' timerfd, a kernel timer that a selector can watch. Other systems: OSError, nothing is imported.

An event loop sleeps in whole milliseconds and wakes 0.1 to 0.3 ms late; this wakes it at the microsecond.
"""

from __future__ import annotations

import ctypes
import os
import sys
from functools import cache
from typing import Any

MONOTONIC, BOOTTIME = 1, 7
"""Kernel clock ids (time(7)). BOOTTIME goes on while the system is suspended, MONOTONIC stands still."""
_FLAGS = 0o2000000 | 0o4000
"""TFD_CLOEXEC | TFD_NONBLOCK."""
_ABSOLUTE = 1


class _Spec(ctypes.Structure):
    """struct itimerspec: interval, then value, each seconds and nanoseconds."""

    _fields_ = [(name, ctypes.c_long) for name in ("every_s", "every_ns", "at_s", "at_ns")]


@cache
def _libc() -> Any:
    libc = ctypes.CDLL(None, use_errno=True)
    libc.timerfd_settime.argtypes = (ctypes.c_int, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)
    return libc


def _failed() -> OSError:
    code = ctypes.get_errno()
    return OSError(code, os.strerror(code))


class TimerFd:
    """One timer on that clock; ``fd`` is readable once it has expired. Raises OSError where there is none.

    Each has its own structure for the kernel: buses of several threads arm theirs at the same time.
    """

    __slots__ = ("_address", "_settime", "_spec", "fd")

    def __init__(self, clock: int = MONOTONIC) -> None:
        if sys.platform != "linux":
            raise OSError("timerfd is Linux only")
        self.fd: int = _libc().timerfd_create(clock, _FLAGS)
        if self.fd < 0:
            raise _failed()
        self._spec = _Spec()
        self._address = ctypes.byref(self._spec)
        self._settime = _libc().timerfd_settime

    def set_at(self, when: float) -> None:
        """Expire at this second, never before it; 0.0 disarms. An unread expiry is taken back either way."""
        seconds = int(when)
        self._spec.at_s = seconds
        self._spec.at_ns = int((when - seconds) * 1e9) + (1 if when else 0)
        if self._settime(self.fd, _ABSOLUTE, self._address, None) != 0:
            raise _failed()

    def expired(self) -> bool:
        """Has it expired since it was set? Asking takes the expiry back."""
        try:
            os.read(self.fd, 8)
        except BlockingIOError:
            return False
        return True

    def close(self) -> None:
        os.close(self.fd)
