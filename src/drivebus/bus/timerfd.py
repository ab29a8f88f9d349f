"""The door to Linux' timerfd: from ``os`` where Python has it (3.13), else from libc. Raises OSError elsewhere."""

from __future__ import annotations

import ctypes
import os
import sys
from typing import Any

_CLOCK_MONOTONIC = 1
_FLAGS = 0o2000000 | 0o4000
"""TFD_CLOEXEC | TFD_NONBLOCK."""
_ABSOLUTE = 1


class _Spec(ctypes.Structure):
    """struct itimerspec: interval, then value, each seconds and nanoseconds."""

    _fields_ = [(name, ctypes.c_long) for name in ("every_s", "every_ns", "at_s", "at_ns")]


_spec = _Spec()
_spec_address = ctypes.byref(_spec)
_libc: Any = None


def create() -> int:
    """A timer file descriptor, disarmed."""
    global _libc
    if sys.platform != "linux":
        raise OSError("timerfd is Linux only")
    if _libc is None:
        _libc = ctypes.CDLL(None, use_errno=True)
        _libc.timerfd_settime.argtypes = (ctypes.c_int, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)
    fd: int = _libc.timerfd_create(_CLOCK_MONOTONIC, _FLAGS)
    if fd < 0:
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code))
    return fd


def set_at(fd: int, when: float) -> None:
    """Expire at this second of CLOCK_MONOTONIC; 0.0 disarms. An unread expiry is taken back either way."""
    seconds = int(when)
    _spec.at_s = seconds
    _spec.at_ns = int((when - seconds) * 1e9) + (1 if when else 0)
    if _libc.timerfd_settime(fd, _ABSOLUTE, _spec_address, None) != 0:
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code))
