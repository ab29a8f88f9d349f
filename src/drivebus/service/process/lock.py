"""Lock on a state directory: one service at a time. The system releases it however the process ends."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from drivebus.atomic_write import PRIVATE_FILE_MODE
from drivebus.errors import ConfigurationError
from drivebus.service.process.permissions import check_trusted

PRIVATE_DIRECTORY_MODE = 0o700
_LOCK_FLAGS = os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW


@contextmanager
def single_instance(directory: Path) -> Iterator[None]:
    """Hold the lock while the block lasts.

    Raises ConfigurationError where another service holds it, or where others could write the directory.
    """
    from fcntl import LOCK_EX, LOCK_NB, flock

    try:
        directory.mkdir(mode=PRIVATE_DIRECTORY_MODE, parents=True, exist_ok=True)
        check_trusted(directory)
        fd = os.open(directory / "service.lock", _LOCK_FLAGS, PRIVATE_FILE_MODE)
    except OSError as error:
        reason = error.strerror or str(error)
        raise ConfigurationError("plant.directory", directory=str(directory), reason=reason) from error
    with os.fdopen(fd, "w") as file:
        try:
            flock(file, LOCK_EX | LOCK_NB)
        except OSError:
            raise ConfigurationError("plant.runs_already", directory=str(directory)) from None
        with suppress(OSError):  # a full disk; the number is for people, the lock holds without it
            os.ftruncate(fd, 0)
            os.write(fd, f"{os.getpid()}\n".encode())
        yield
