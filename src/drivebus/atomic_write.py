"""Durable files: atomic replacement, and the system calls that make a name or its content durable."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

PRIVATE_FILE_MODE = 0o600
PRIVATE_FOLDER_MODE = 0o700
_CREATE_FLAGS = (
    os.O_WRONLY
    | os.O_CREAT
    | os.O_EXCL
    | getattr(os, "O_BINARY", 0)
    | getattr(os, "O_CLOEXEC", 0)
    | getattr(os, "O_NOFOLLOW", 0)
)


def atomic_write(path: Path, content: bytes, mode: int = 0o666) -> None:
    """Replace a file; durable on return: a power cut leaves the old content or the new, never a part.

    Raises OSError; then the old file is unchanged and no other is left, unless the disk fails after the replacement.
    One writer at a time: the remains of a killed writer are removed.
    """
    part = path.with_name(f".{path.name}.new")
    with durable_names(path.parent):
        try:
            fd = os.open(part, _CREATE_FLAGS, mode)
        except FileExistsError:
            part.unlink()
            fd = os.open(part, _CREATE_FLAGS, mode)
        try:
            try:
                write_all(fd, content)
                os.fsync(fd)
            finally:
                os.close(fd)
            part.replace(path)
        except BaseException:
            part.unlink(missing_ok=True)
            raise


def atomic_write_private(path: Path, content: bytes) -> None:
    """Replace a file that only its owner can read, as ``atomic_write`` does; create its folder where there is none."""
    path.parent.mkdir(parents=True, exist_ok=True, mode=PRIVATE_FOLDER_MODE)
    atomic_write(path, content, PRIVATE_FILE_MODE)


def link_or_copy(path: Path, other: Path) -> None:
    """Give a file a second name; copy it on a file system without hard links. Durable on return. Raises OSError."""
    try:
        os.link(path, other)
    except FileExistsError:
        raise
    except OSError:
        atomic_write(other, path.read_bytes())
    fsync_directory(path.parent)


def write_all(fd: int, data: bytes) -> None:
    """Write all bytes, however few the system takes at a time. Raises OSError, also for a disk that takes none."""
    while data:
        written = os.write(fd, data)
        if written == 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        data = data[written:]


def fsync_directory(folder: Path) -> None:
    """Make the names in a directory durable. Raises OSError."""
    with durable_names(folder):
        pass


@contextmanager
def durable_names(folder: Path) -> Iterator[None]:
    """Make the names that the block changes in a directory durable.

    Raises OSError, before the block where the directory can't be read or no descriptor is left.
    """
    if os.name != "posix":
        yield
        return
    fd = os.open(folder, os.O_RDONLY)
    try:
        yield
        os.fsync(fd)
    finally:
        os.close(fd)
