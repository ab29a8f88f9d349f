"""Exclusive ownership of a serial device: a lock file of our own, and flock and TIOCEXCL on the device.

The lock file gives a second drivebus the pid of the first one; flock excludes every program that checks it (serialx,
picocom, minicom, drivebus); TIOCEXCL excludes all others without root. The kernel drops both locks when their process
ends, so a file left by a killed drivebus is stale by itself: the flock on it is the lock, not its pid.
"""

# ruff: noqa: E402  # the assertion below must come first: type checkers stop there on Windows

from __future__ import annotations

import contextlib
import errno
import os
import re
import sys
from pathlib import Path

assert sys.platform != "win32"  # Windows opens COM ports exclusively by itself

import fcntl
import termios

from drivebus.user_directories import user_state_directory


class DeviceBusy(OSError):
    """The device has another owner; ``pid`` where it is a drivebus."""

    def __init__(self, pid: int | None = None) -> None:
        super().__init__(errno.EBUSY, os.strerror(errno.EBUSY))
        self.pid = pid


def lock_dir() -> Path:
    """Return the directory of lock files."""
    return user_state_directory() / "locks"


def lock_owner(device: str) -> int | None:
    """Return the pid of the running drivebus that owns ``device``, from its lock file."""
    try:
        file = os.open(_lock_path(device), os.O_RDWR | os.O_CLOEXEC)
    except OSError:
        return None
    try:
        _flock(file)
    except DeviceBusy:
        return _pid(file)
    finally:
        os.close(file)
    return None


class DeviceLock:
    """Ownership of a device from construction to ``release``. Raises DeviceBusy, or OSError: the device is gone."""

    def __init__(self, fd: int, device: str, *, exclusive: bool = True) -> None:
        """``exclusive``: TIOCEXCL too. Not for a pty, where its flag would last as long as the peer."""
        self._fd = fd
        self._exclusive = exclusive
        self._lock_file = _take_lock_file(device)
        try:
            _flock(fd)
            if exclusive:
                fcntl.ioctl(fd, termios.TIOCEXCL)
        except BaseException:
            self._release_lock_file()
            raise

    def release(self) -> None:
        """Release the device; call before closing its descriptor. Idempotent."""
        if self._exclusive:
            self._exclusive = False
            with contextlib.suppress(OSError):
                fcntl.ioctl(self._fd, termios.TIOCNXCL)
        self._release_lock_file()

    def _release_lock_file(self) -> None:
        file, self._lock_file = self._lock_file, -1
        if file >= 0:
            with contextlib.suppress(OSError):
                os.ftruncate(file, 0)
            os.close(file)


def _take_lock_file(device: str) -> int:
    """Return our lock file, locked and with our pid; -1 where the directory can't be written (flock remains)."""
    path = _lock_path(device)
    try:
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    except OSError:
        return -1
    try:
        _flock(file)
        os.ftruncate(file, 0)
        os.pwrite(file, f"{os.getpid()}\n".encode(), 0)
    except DeviceBusy:
        pid = _pid(file)
        os.close(file)
        raise DeviceBusy(pid) from None
    except OSError:
        os.close(file)
        return -1
    return file


def _flock(fd: int) -> None:
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise DeviceBusy from None


def _pid(file: int) -> int | None:
    text = os.pread(file, 32, 0).strip()
    return int(text) if text.isdigit() else None


def _lock_path(device: str) -> Path:
    return lock_dir() / (re.sub(r"[^A-Za-z0-9._-]", "-", device.strip("/")) + ".lock")
