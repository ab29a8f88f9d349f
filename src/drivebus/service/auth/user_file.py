"""``access.json``: the register in a file that only its owner reads (0600), replaced as a whole."""

from __future__ import annotations

import os
from collections.abc import Callable
from fcntl import LOCK_EX, flock
from pathlib import Path
from typing import IO

from pydantic import TypeAdapter, ValidationError

from drivebus import atomic_write
from drivebus.errors import ConfigurationError
from drivebus.service.auth.users import UserDatabase

_USER_DATABASE_ADAPTER = TypeAdapter(UserDatabase)
_PRIVATE_MODE = 0o600


class UserFile:
    """The register; several programs may use one file: each change reads it again under a lock.

    Raises ConfigurationError where it can't be read or written, or is none of ours: nobody starts from nothing. Whoever
    has read it once goes on with what it said then: a slip of an editor takes nobody's stop away.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file_state: tuple[int, int, int] | None = None
        self._database = UserDatabase()

    def read(self) -> UserDatabase:
        """What the file says now; read again only where it changed."""
        try:
            return self._read_if_changed()
        except ConfigurationError:
            if self._file_state is None:
                raise
            return self._database

    def _read_if_changed(self) -> UserDatabase:
        try:
            state = self.path.stat()
        except FileNotFoundError:
            return UserDatabase()
        except OSError as error:
            raise self._unusable_error(str(error)) from error
        seen = (state.st_mtime_ns, state.st_size, state.st_ino)
        if seen != self._file_state:
            self._database, self._file_state = self._load(), seen
        return self._database

    def change(self, change: Callable[[UserDatabase], UserDatabase]) -> UserDatabase:
        """Put what ``change`` makes of it; durable on return. Where ``change`` raises, nothing is put."""
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            with os.fdopen(_open_private(self.path.with_suffix(".lock")), "w") as lock:
                flock(lock, LOCK_EX)
                after = change(self._read_if_changed())
                replace_private(self.path, _USER_DATABASE_ADAPTER.dump_json(after, indent=1))
        except OSError as error:
            raise self._unusable_error(error.strerror or str(error)) from error
        return after

    def _load(self) -> UserDatabase:
        try:
            return _USER_DATABASE_ADAPTER.validate_json(self.path.read_bytes())
        except (OSError, ValidationError) as error:
            raise self._unusable_error(str(error)) from error

    def _unusable_error(self, problem: str) -> ConfigurationError:
        return ConfigurationError("access.store_unusable", file=str(self.path), problem=problem)


def replace_private(path: Path, content: bytes) -> None:
    """Old or new, never half, never readable by others; durable on return."""
    atomic_write.atomic_write(path, content, _create_private)


def _create_private(part: Path) -> IO[bytes]:
    """A file of nobody else's making."""
    part.unlink(missing_ok=True)
    return os.fdopen(_open_private(part, os.O_EXCL), "wb")


def _open_private(path: Path, more: int = 0) -> int:
    return os.open(path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | more, _PRIVATE_MODE)
