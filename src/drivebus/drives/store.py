"""Small persistent mappings: one JSON file, replaced as a whole so that a power cut leaves the old or the new one."""

from __future__ import annotations

import contextlib
import errno
import json
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Protocol, TextIO

from drivebus import atomic_write
from drivebus.errors import ConfigurationError, SystemReason
from drivebus.regular_file import open_regular_file, read_regular_file
from drivebus.user_directories import user_state_directory

STORE_FORMAT = 1


class Store(Protocol):
    """A small persistent mapping (EEPROM budget, calibration); durable when ``put`` and ``update`` return."""

    def get(self, key: str) -> str | None:
        """Return the value of a key, None where it has none."""
        ...

    def put(self, key: str, value: str) -> None:
        """Set the value of a key."""
        ...

    def update(self, key: str, change: Callable[[str | None], str]) -> None:
        """Replace a value by the result of ``change``, with no other writer in between; unchanged if it raises."""
        ...


class MemoryStore:
    """Store in memory, for simulated drives, which have no EEPROM that wears."""

    def __init__(self) -> None:
        self._values: dict[str, str] = {}

    def get(self, key: str) -> str | None:
        return self._values.get(key)

    def put(self, key: str, value: str) -> None:
        self._values[key] = value

    def update(self, key: str, change: Callable[[str | None], str]) -> None:
        self._values[key] = change(self._values.get(key))


class FileStore:
    """Store in a file; ``put`` and ``update`` return when the value would survive a power cut.

    Its owner alone has access; programs that share it read it again under a lock for each change. Raises
    ConfigurationError where it has another format, or can't be read or written: counters never start again from 0.
    ``may_vanish``: a missing file reads as empty; otherwise its lock shows that it existed, and reading it raises too.
    """

    def __init__(self, path: Path | str, *, may_vanish: bool = True) -> None:
        self.path = Path(path)
        self._may_vanish = may_vanish
        self._lock_path = self.path.with_suffix(".lock")

    def get(self, key: str) -> str | None:
        return self._read().get(key)

    def put(self, key: str, value: str) -> None:
        self.update(key, lambda _: value)

    def update(self, key: str, change: Callable[[str | None], str]) -> None:
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True, mode=atomic_write.PRIVATE_FOLDER_MODE)
            is_new = not self._lock_path.exists()
            try:
                with _locked(self._lock_path):
                    values = {} if is_new and not self.path.exists() else self._read()
                    values[key] = change(values.get(key))
                    _replace(self.path, _encode(values))
            finally:
                if is_new and not self._may_vanish and not self.path.exists():
                    self._lock_path.unlink(missing_ok=True)  # the lock would show a file that never existed
        except OSError as error:
            problem = SystemReason(error)
            raise ConfigurationError("drives.store_unwritable", file=str(self.path), problem=problem) from error

    def put_aside(self, values: Mapping[str, str], suffix: str) -> Path | None:
        """Keep a file that can't be read under its name with ``suffix``, replace it by a new one, return the new path.

        None: it is missing. Raises ConfigurationError. The file that can't be read stays until it is replaced: no file
        would read as empty.
        """
        aside = self.path.with_name(self.path.name + suffix)
        try:
            with _locked(self._lock_path):
                if found := self.path.exists():
                    atomic_write.link_or_copy(self.path, aside)
                _replace(self.path, _encode(values))
        except OSError as error:
            problem = SystemReason(error)
            raise ConfigurationError("drives.store_unwritable", file=str(self.path), problem=problem) from error
        return aside if found else None

    def _read(self) -> dict[str, str]:
        try:
            document: Any = json.loads(read_regular_file(self.path).decode())
        except FileNotFoundError:
            if self._may_vanish or not self._lock_path.exists():
                return {}
            raise ConfigurationError("drives.store_missing", file=str(self.path), lock=self._lock_path.name) from None
        except (OSError, ValueError, RecursionError) as error:  # not UTF-8 is a ValueError too
            raise ConfigurationError(
                "drives.store_unreadable", file=str(self.path), problem=SystemReason(error)
            ) from error
        values = (
            document.get("values") if isinstance(document, dict) and document.get("format") == STORE_FORMAT else None
        )
        if not isinstance(values, dict) or not all(isinstance(v, str) for v in values.values()):
            problem = ConfigurationError("drives.store_format", format=STORE_FORMAT)
            raise ConfigurationError("drives.store_unreadable", file=str(self.path), problem=problem)
        return values


def value_if_readable(store: Store, key: str) -> str | None:
    """Return the value of a key, None also where the store can't be read: that must prevent no stop."""
    try:
        return store.get(key)
    except ConfigurationError:
        return None


def drive_key(port_identity: str, address: int) -> str:
    """Return the key of one drive's records: these drives have no serial number that could be read."""
    return f"{port_identity}/{address}"


def default_path() -> Path:
    """Return the file of the store in the user's state directory."""
    return user_state_directory() / "store.json"


def _encode(values: Mapping[str, str]) -> str:
    return json.dumps({"format": STORE_FORMAT, "values": values}, indent=1, sort_keys=True)


def _replace(path: Path, text: str) -> None:
    atomic_write.atomic_write(path, text.encode(), atomic_write.PRIVATE_FILE_MODE)


@contextlib.contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold an exclusive lock of a file, also among programs and threads."""
    try:
        from fcntl import LOCK_EX, flock
    except ImportError:  # Windows
        with _open_lock_file(path) as file, _locked_by_msvcrt(file.fileno()):
            yield
        return
    with _open_lock_file(path) as file:
        flock(file, LOCK_EX)
        yield


def _open_lock_file(path: Path) -> TextIO:
    return os.fdopen(open_regular_file(path, os.O_WRONLY | os.O_CREAT), "w")


@contextlib.contextmanager
def _locked_by_msvcrt(fd: int) -> Iterator[None]:
    """Lock the first byte of a file. ``LK_LOCK`` gives up after ten seconds with EDEADLK and is then repeated."""
    import msvcrt

    windows: Any = msvcrt
    while True:
        try:
            windows.locking(fd, windows.LK_LOCK, 1)
            break
        except OSError as error:
            if error.errno != errno.EDEADLK:
                raise
    try:
        yield
    finally:
        windows.locking(fd, windows.LK_UNLCK, 1)
