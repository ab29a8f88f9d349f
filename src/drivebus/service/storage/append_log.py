"""Append-only file: a record survives a power cut once ``append`` has returned, and is absent where it raised."""

from __future__ import annotations

import os
from pathlib import Path
from typing import BinaryIO

from drivebus.atomic_write import PRIVATE_FOLDER_MODE, fsync_directory, write_all
from drivebus.regular_file import open_regular_file

TAIL_BYTES = 1 << 20
"""No line is longer, so that the last one can be found from the end."""


class AppendLog:
    """Append-only file, created with its folder at the first write; only its owner can read it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.size = 0
        """Bytes that are durable."""
        self._fd = -1
        self._write_failed = False
        """A write has failed: bytes beyond ``size`` are cut off before the next one."""

    def open(self) -> None:
        """Open or create the file. Idempotent.

        Raises OSError, also for no regular file, and for a symbolic link that belongs to another user.
        """
        if self._fd >= 0:
            return
        self.path.parent.mkdir(parents=True, exist_ok=True, mode=PRIVATE_FOLDER_MODE)
        new = not self.path.exists()
        fd = open_regular_file(self.path, os.O_RDWR | os.O_CREAT | os.O_APPEND)
        try:
            if new:
                fsync_directory(self.path.parent)
            self.size, self._write_failed = os.fstat(fd).st_size, False
        except BaseException:
            os.close(fd)
            raise
        self._fd = fd

    def append(self, data: bytes) -> None:
        """Append data; durable on return. Raises OSError; then none of it stays in the file."""
        self._reopen_if_replaced()
        self.open()
        if self._write_failed:
            os.ftruncate(self._fd, self.size)
        record = self._separator() + data
        self._write_failed = True
        write_all(self._fd, record)
        os.fsync(self._fd)
        self.size, self._write_failed = self.size + len(record), False

    def truncate(self, size: int) -> None:
        """Cut the file off after ``size`` bytes, durably. Raises OSError."""
        self.open()
        os.ftruncate(self._fd, size)
        os.fsync(self._fd)
        self.size, self._write_failed = size, False

    def close(self) -> None:
        """Close the file, without the bytes of a failed write as far as the disk permits. Idempotent."""
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
        opened = os.fstat(self._fd)
        try:
            current = self.path.stat()
        except FileNotFoundError:
            self.close()
            return
        if (opened.st_dev, opened.st_ino) != (current.st_dev, current.st_ino):
            self.close()

    def _separator(self) -> bytes:
        """Return a line break where another process has written to the file: our records start on a new line."""
        size = os.fstat(self._fd).st_size
        written, self.size = size > self.size, size
        return b"\n" if written else b""


def open_to_read(path: Path) -> BinaryIO:
    """Open a file that others may have put there. Raises OSError as ``AppendLog.open``."""
    return os.fdopen(open_regular_file(path, os.O_RDONLY), "rb")


def read_tail(path: Path) -> bytes:
    """Return the last ``TAIL_BYTES`` of a file, b"" where there is none. Raises OSError."""
    try:
        with open_to_read(path) as file:
            file.seek(max(0, path.stat().st_size - TAIL_BYTES))
            return file.read()
    except FileNotFoundError:
        return b""
