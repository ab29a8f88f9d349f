"""Files whose n-th call fails: every call of a program to files under one folder is counted, in one row.

``error`` fails one call and leaves the rest to work; ``kill`` ends the program there, a write half done; ``power``
also takes back what was not yet synced. Real files, nothing is simulated but the failure and the loss.
"""

from __future__ import annotations

import builtins
import io
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

REAL_CALLS: dict[str, Any] = {"open": io.open}


class ProgramKilled(BaseException):
    """The program is gone: nothing catches this, and nothing that it still does reaches a file."""


class FaultyDisk:
    """``nth`` 0: nothing fails, calls are only counted. ``error``: what to raise; None: kill.

    ``short``: a write takes half of its bytes, says so, and the program lives.
    """

    def __init__(self, folder: Path, nth: int = 0, error: Exception | None = None, *, short: bool = False) -> None:
        self.folder, self.nth, self.error, self.short_write = folder, nth, error, short
        self.calls = 0
        self.failed = ""
        """The call that failed."""
        self.is_killed = False
        self._synced: dict[Path, bytes | None] = {}
        """Files as they would be after a power cut, where that differs from what is there."""
        self._names: dict[int, Path] = {}

    def contains(self, path: Any) -> bool:
        return isinstance(path, str | os.PathLike) and Path(path).is_relative_to(self.folder)

    def count_call(self, what: str) -> bool:
        """One more call. Raises where it fails; True: it is done half, if at all, and then the program is killed."""
        if self.is_killed:
            raise ProgramKilled
        self.calls += 1
        if self.calls != self.nth:
            return False
        self.failed = what
        if self.error is not None:
            raise self.error
        self.is_killed = not self.short_write
        return self.is_killed or what == "write"

    def cut_power(self) -> None:
        """The power failed: what was not synced is gone."""
        for path, content in self._synced.items():
            if content is None:
                path.unlink(missing_ok=True)
            else:
                path.write_bytes(content)

    # --- what programs call ----------------------------------------------------------------------------------------

    def open_file(self, file: Any, mode: str = "r", *more: Any, **named: Any) -> Any:
        if not self.contains(file):
            return REAL_CALLS["open"](file, mode, *more, **named)
        path = Path(file)
        if self.count_call(f"open {mode}"):
            raise ProgramKilled
        if "w" in mode:
            self._remember_unsynced(path)
        return _FaultyFile(self, path, REAL_CALLS["open"](path, mode.replace("b", "") + "b", 0), "b" in mode)

    def os_open(self, path: Any, flags: int, *more: Any, **named: Any) -> int:
        if not self.contains(path):
            return int(REAL_CALLS["os.open"](path, flags, *more, **named))
        if self.count_call("open"):
            raise ProgramKilled
        if flags & (os.O_EXCL | os.O_TRUNC):
            self._remember_unsynced(Path(path))
        fd = int(REAL_CALLS["os.open"](path, flags, *more, **named))
        self._names[fd] = Path(path)
        return fd

    def os_write(self, fd: int, data: bytes) -> int:
        if fd not in self._names:
            return int(REAL_CALLS["os.write"](fd, data))
        if self.count_call("write"):
            some = int(REAL_CALLS["os.write"](fd, data[: len(data) // 2]))
            if self.short_write:
                return some
            raise ProgramKilled
        return int(REAL_CALLS["os.write"](fd, data))

    def os_close(self, fd: int) -> None:
        known = self._names.pop(fd, None)
        REAL_CALLS["os.close"](fd)
        if known is not None and self.count_call("close"):
            raise ProgramKilled

    def fsync(self, fd: int) -> None:
        """Counted, and remembered: the disk itself is not troubled."""
        path = self._names.get(fd)
        if path is None:
            REAL_CALLS["os.fsync"](fd)
            return
        if self.count_call("fsync"):
            raise ProgramKilled
        if path.is_dir():
            self._synced = {file: kept for file, kept in self._synced.items() if file.parent != path}
        elif path in self._synced:
            self._synced[path] = path.read_bytes()

    def replace(self, old: Any, new: Any, **named: Any) -> None:
        """Until the folder is synced a power cut may find the old name or the new one: each for half of the calls.

        The new one with what was synced of it: nothing, where nobody did.
        """
        if not self.contains(new):
            REAL_CALLS["os.replace"](old, new, **named)
            return
        if self.count_call("replace"):
            raise ProgramKilled
        was = self._synced.pop(Path(old), Path(old).read_bytes()) or b""
        before = Path(new).read_bytes() if Path(new).exists() else None
        REAL_CALLS["os.replace"](old, new, **named)
        self._synced[Path(new)] = was if self.nth % 2 else before

    def unlink(self, path: Any, **named: Any) -> None:
        if self.contains(path):
            self.count_call("unlink")
            self._synced.pop(Path(path), None)
        REAL_CALLS["os.unlink"](path, **named)

    def counted(self, name: str) -> Callable[..., Any]:
        """A call that is only counted: mkdir, scandir, listdir, flock."""

        def done(first: Any = ".", *more: Any, **named: Any) -> Any:
            if (self.contains(first) or first in self._names) and self.count_call(name):
                raise ProgramKilled
            return REAL_CALLS[name](first, *more, **named)

        return done

    def _remember_unsynced(self, path: Path) -> None:
        """Emptied and not synced: after a power cut it may be empty, or never have been there."""
        self._synced.setdefault(path, b"" if path.exists() else None)


class _FaultyFile:
    """An open file: text or bytes, buffered as Python does, until ``flush`` or the end."""

    def __init__(self, disk: FaultyDisk, path: Path, raw: Any, binary: bool) -> None:
        self._disk, self._raw, self._binary, self._buffer = disk, raw, binary, b""
        disk._names[raw.fileno()] = path

    def write(self, text: Any) -> int:
        self._buffer += text if self._binary else text.encode()
        return len(text)

    def flush(self) -> None:
        data, self._buffer = self._buffer, b""
        if self._disk.count_call("write"):
            self._raw.write(data[: len(data) // 2])
            raise ProgramKilled
        self._raw.write(data)

    def read(self, size: int = -1) -> Any:
        if self._disk.count_call("read"):
            raise ProgramKilled
        data = self._raw.read(size)
        return data if self._binary else data.decode()

    def fileno(self) -> int:
        return int(self._raw.fileno())

    def close(self) -> None:
        if self._raw.closed:
            return
        try:
            if self._buffer and not self._disk.is_killed:
                self.flush()
        finally:
            self._disk._names.pop(self._raw.fileno(), None)
            self._raw.close()
        if self._disk.count_call("close"):
            raise ProgramKilled

    def __enter__(self) -> _FaultyFile:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@contextmanager
def installed_disk(disk: FaultyDisk) -> Iterator[FaultyDisk]:
    """While this lasts the files below the disk's folder are reached through it."""
    places: dict[str, tuple[Any, str, Any]] = {
        "open": (builtins, "open", disk.open_file),
        "io.open": (io, "open", disk.open_file),
        "os.open": (os, "open", disk.os_open),
        "os.write": (os, "write", disk.os_write),
        "os.close": (os, "close", disk.os_close),
        "os.fsync": (os, "fsync", disk.fsync),
        "os.replace": (os, "replace", disk.replace),
        "os.unlink": (os, "unlink", disk.unlink),
        "mkdir": (os, "mkdir", disk.counted("mkdir")),
        "scandir": (os, "scandir", disk.counted("scandir")),
        "listdir": (os, "listdir", disk.counted("listdir")),
    }
    if os.name == "posix":
        import fcntl

        places["flock"] = (fcntl, "flock", disk.counted("flock"))
    REAL_CALLS.update((name, getattr(module, attribute)) for name, (module, attribute, _) in places.items())
    for module, attribute, function in places.values():
        setattr(module, attribute, function)
    try:
        yield disk
    finally:
        for name, (module, attribute, _) in places.items():
            setattr(module, attribute, REAL_CALLS[name])
