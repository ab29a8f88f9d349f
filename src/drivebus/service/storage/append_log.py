"""Append-only file: a record survives a power cut once ``append`` has returned, and is absent where it raised."""

from __future__ import annotations

import errno
import os
from pathlib import Path

from drivebus.atomic_write import fsync_directory

TAIL_BYTES = 1 << 20
"""No line is longer, so that the last one can be found from the end."""
PRIVATE_FILE_MODE = 0o600


class AppendLog:
    """``path`` is created with its folder when it is first written; readable by its owner only."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.size = 0
        """Octets that are safe."""
        self._fd = -1
        self._write_failed = False
        """A write has failed: what is behind ``size`` counts for nothing."""

    def open(self) -> None:
        """Idempotent. Raises OSError."""
        if self._fd >= 0:
            return
        self.path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        new = not self.path.exists()
        fd = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_APPEND, PRIVATE_FILE_MODE)
        try:
            if new:
                fsync_directory(self.path.parent)
            self.size, self._write_failed = os.fstat(fd).st_size, False
        except BaseException:
            os.close(fd)
            raise
        self._fd = fd

    def append(self, data: bytes) -> None:
        """Durable when it returns. Raises OSError, and then nothing of it will be there."""
        self._reopen_if_replaced()
        self.open()
        if self._write_failed:
            os.ftruncate(self._fd, self.size)
        apart = self._separator()
        self._write_failed = True
        _write_all(self._fd, apart + data)
        os.fsync(self._fd)
        self.size, self._write_failed = self.size + len(apart + data), False

    def truncate(self, size: int) -> None:
        """Take away everything from octet ``size`` on. Raises OSError."""
        self.open()
        os.ftruncate(self._fd, size)
        os.fsync(self._fd)
        self.size, self._write_failed = size, False

    def close(self) -> None:
        """Idempotent. What is in doubt is taken away, as well as the disk lets us."""
        fd, self._fd = self._fd, -1
        if fd < 0:
            return
        try:
            if self._write_failed:
                os.ftruncate(fd, self.size)
        except OSError:
            pass
        finally:
            os.close(fd)

    def _reopen_if_replaced(self) -> None:
        """Open the file again where it was removed, moved or replaced."""
        if self._fd < 0:
            return
        mine = os.fstat(self._fd)
        try:
            there = self.path.stat()
        except FileNotFoundError:
            self.close()
            return
        if (mine.st_dev, mine.st_ino) != (there.st_dev, there.st_ino):
            self.close()

    def _separator(self) -> bytes:
        """Return a line break where another process has written to the file: our records start on a new line."""
        size = os.fstat(self._fd).st_size
        written, self.size = size > self.size, size
        return b"\n" if written else b""


def _write_all(fd: int, data: bytes) -> None:
    while data:
        written = os.write(fd, data)
        if written == 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        data = data[written:]


def read_tail(path: Path) -> bytes:
    """The last ``TAIL`` octets of a file, b"" where there is none. Raises OSError."""
    try:
        with path.open("rb") as file:
            file.seek(max(0, path.stat().st_size - TAIL_BYTES))
            return file.read()
    except FileNotFoundError:
        return b""


def write_durably(path: Path, data: bytes, mode: int = PRIVATE_FILE_MODE) -> None:
    """A file that is there whole and durable, or is as it was. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    part = path.with_name(f".{path.name}.part")
    fd = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, mode)
    try:
        _write_all(fd, data)
        os.fsync(fd)
    finally:
        os.close(fd)
    part.replace(path)
    fsync_directory(path.parent)
