"""The terminal of this process: whether it was closed, and the output after that."""

from __future__ import annotations

import errno
import os
import stat
import sys
from contextlib import suppress


def terminal_is_closed() -> bool:
    """Return whether the terminal was closed, so that no Ctrl-C can come."""
    try:
        os.tcgetpgrp(0)
    except OSError as error:
        return error.errno == errno.EIO  # another error: there never was one, as in a systemd unit
    return False


def discard_output(*, redirected: bool = True) -> None:
    """Discard all further output, which would fail: at the end of the process too, with exit code 120.

    ``redirected`` False: only that to a terminal; files and pipes still get theirs.
    """
    with suppress(OSError, ValueError):
        devnull = os.open(os.devnull, os.O_WRONLY)
        for stream in (sys.stdout, sys.stderr):
            if redirected or stat.S_ISCHR(os.fstat(stream.fileno()).st_mode):
                os.dup2(devnull, stream.fileno())
        os.close(devnull)
