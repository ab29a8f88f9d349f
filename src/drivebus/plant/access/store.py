"""``access.json``: the register in a file that only its owner reads (0600), replaced as a whole."""

from __future__ import annotations

import os
from collections.abc import Callable
from fcntl import LOCK_EX, flock
from pathlib import Path
from typing import IO

from pydantic import TypeAdapter, ValidationError

from drivebus import files
from drivebus.errors import ConfigurationError
from drivebus.plant.access.register import Register

_FORM = TypeAdapter(Register)
_PRIVATE = 0o600


class AccessFile:
    """The register; several programs may use one file: each change reads it again under a lock.

    Raises ConfigurationError where it can't be read or written, or is none of ours: nobody starts from nothing. Whoever
    has read it once goes on with what it said then: a slip of an editor takes nobody's stop away.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._seen: tuple[int, int, int] | None = None
        self._register = Register()

    def read(self) -> Register:
        """What the file says now; read again only where it changed."""
        try:
            return self._current()
        except ConfigurationError:
            if self._seen is None:
                raise
            return self._register

    def _current(self) -> Register:
        try:
            state = self.path.stat()
        except FileNotFoundError:
            return Register()
        except OSError as error:
            raise self._unusable(str(error)) from error
        seen = (state.st_mtime_ns, state.st_size, state.st_ino)
        if seen != self._seen:
            self._register, self._seen = self._load(), seen
        return self._register

    def change(self, change: Callable[[Register], Register]) -> Register:
        """Put what ``change`` makes of it; durable on return. Where ``change`` raises, nothing is put."""
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            with os.fdopen(_private(self.path.with_suffix(".lock")), "w") as lock:
                flock(lock, LOCK_EX)
                after = change(self._current())
                replace_private(self.path, _FORM.dump_json(after, indent=1))
        except OSError as error:
            raise self._unusable(error.strerror or str(error)) from error
        return after

    def _load(self) -> Register:
        try:
            return _FORM.validate_json(self.path.read_bytes())
        except (OSError, ValidationError) as error:
            raise self._unusable(str(error)) from error

    def _unusable(self, problem: str) -> ConfigurationError:
        return ConfigurationError("access.store_unusable", file=str(self.path), problem=problem)


def replace_private(path: Path, content: bytes) -> None:
    """Old or new, never half, never readable by others; durable on return."""
    files.replace(path, content, _new)


def _new(part: Path) -> IO[bytes]:
    """A file of nobody else's making."""
    part.unlink(missing_ok=True)
    return os.fdopen(_private(part, os.O_EXCL), "wb")


def _private(path: Path, more: int = 0) -> int:
    return os.open(path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | more, _PRIVATE)
