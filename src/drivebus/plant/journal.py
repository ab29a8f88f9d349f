"""An append-only file: what ``append`` returned from survives a power cut, what it raised from leaves no trace.

No thread and no clock lives here.
"""

from __future__ import annotations

import errno
import os
from pathlib import Path

from drivebus.files import sync_folder

TAIL = 1 << 20
"""No line is longer, so that the last one can be found from the end."""
PRIVATE = 0o600


class Journal:
    """``path`` is created with its folder when it is first written; readable by its owner only."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.size = 0
        """Octets that are safe."""
        self._fd = -1
        self._doubt = False
        """A write has failed: what is behind ``size`` counts for nothing."""

    def open(self) -> None:
        """Idempotent. Raises OSError."""
        if self._fd >= 0:
            return
        self.path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        new = not self.path.exists()
        fd = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_APPEND, PRIVATE)
        try:
            if new:
                sync_folder(self.path.parent)
            self.size, self._doubt = os.fstat(fd).st_size, False
        except BaseException:
            os.close(fd)
            raise
        self._fd = fd

    def append(self, data: bytes) -> None:
        """Durable when it returns. Raises OSError, and then nothing of it will be there."""
        self._still_there()
        self.open()
        if self._doubt:
            os.ftruncate(self._fd, self.size)
        apart = self._apart()
        self._doubt = True
        _write(self._fd, apart + data)
        os.fsync(self._fd)
        self.size, self._doubt = self.size + len(apart + data), False

    def cut(self, size: int) -> None:
        """Take away everything from octet ``size`` on. Raises OSError."""
        self.open()
        os.ftruncate(self._fd, size)
        os.fsync(self._fd)
        self.size, self._doubt = size, False

    def close(self) -> None:
        """Idempotent. What is in doubt is taken away, as well as the disk lets us."""
        fd, self._fd = self._fd, -1
        if fd < 0:
            return
        try:
            if self._doubt:
                os.ftruncate(fd, self.size)
        except OSError:
            pass
        finally:
            os.close(fd)

    def _still_there(self) -> None:
        """A file that somebody has removed, moved or replaced is opened again under its name."""
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

    def _apart(self) -> bytes:
        """Somebody else has written to the file, or cut it: what is ours begins on a line of its own."""
        size = os.fstat(self._fd).st_size
        written, self.size = size > self.size, size
        return b"\n" if written else b""


def _write(fd: int, data: bytes) -> None:
    while data:
        written = os.write(fd, data)
        if written == 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        data = data[written:]


def tail(path: Path) -> bytes:
    """The last ``TAIL`` octets of a file, b"" where there is none. Raises OSError."""
    try:
        with path.open("rb") as file:
            file.seek(max(0, path.stat().st_size - TAIL))
            return file.read()
    except FileNotFoundError:
        return b""


def write_whole(path: Path, data: bytes, mode: int = PRIVATE) -> None:
    """A file that is there whole and durable, or is as it was. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    part = path.with_name(f".{path.name}.part")
    fd = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, mode)
    try:
        _write(fd, data)
        os.fsync(fd)
    finally:
        os.close(fd)
    part.replace(path)
    sync_folder(path.parent)
