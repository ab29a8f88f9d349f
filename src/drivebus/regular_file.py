"""Opening of regular files only: a FIFO in the place of a file would block its reader for good."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

_NEW_FILE_MODE = 0o600
_FLAGS = getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)


def read_regular_file(path: Path) -> bytes:
    """Return the content of a file. Raises OSError as ``open_regular_file``."""
    with os.fdopen(open_regular_file(path, os.O_RDONLY), "rb") as file:
        return file.read()


def open_regular_file(path: Path, flags: int) -> int:
    """Open a regular file; a new one is private.

    Raises OSError for anything else, and for a symbolic link that belongs to another user: in a folder that others can
    write, it could lead to any file of this user.
    """
    flags |= _FLAGS
    try:
        fd = os.open(path, flags | getattr(os, "O_NOFOLLOW", 0), _NEW_FILE_MODE)
    except OSError as error:
        if error.errno != errno.ELOOP:
            raise
        if path.lstat().st_uid not in (os.geteuid(), 0):
            raise PermissionError(errno.EPERM, os.strerror(errno.EPERM), str(path)) from error
        fd = os.open(path, flags, _NEW_FILE_MODE)
    mode = os.fstat(fd).st_mode
    if not stat.S_ISREG(mode):
        os.close(fd)
        number = errno.EISDIR if stat.S_ISDIR(mode) else errno.EINVAL
        raise OSError(number, os.strerror(number), str(path))
    return fd
