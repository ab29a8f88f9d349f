"""Whether the clock of this computer is synchronized, as the Linux kernel reports it (adjtimex(2), by ctypes)."""

from __future__ import annotations

import ctypes
import sys

UNSYNCHRONIZED_ERROR_US = 16_000_000  # the kernel's limit (NTP_PHASE_LIMIT), reached where nothing sets the clock


class _Timex(ctypes.Structure):
    """Beginning of the C structure ``timex``, with room for its other fields."""

    _fields_ = [
        ("modes", ctypes.c_uint),  # 0: only read
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("others", ctypes.c_long * 32),
    ]


def is_clock_synchronized() -> bool | None:
    """Return whether a program such as systemd-timesyncd or chrony keeps the clock right; None where that is unknown.

    The maximum error decides, as for ``timedatectl``: chrony can leave the flag STA_UNSYNC set.
    """
    if sys.platform != "linux":
        return None
    timex = _Timex()
    if ctypes.CDLL(None).adjtimex(ctypes.byref(timex)) < 0:
        return None  # not permitted, as in some containers
    max_error_us: int = timex.maxerror
    return max_error_us < UNSYNCHRONIZED_ERROR_US
