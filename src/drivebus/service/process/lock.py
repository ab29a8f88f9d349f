"""Lock on a state directory: one service at a time. The system releases it however the process ends."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from drivebus.errors import ConfigurationError

PRIVATE_DIRECTORY_MODE = 0o700


@contextmanager
def single_instance(directory: Path) -> Iterator[None]:
    """Hold the lock while the block lasts. Raises ConfigurationError where another service holds it."""
    from fcntl import LOCK_EX, LOCK_NB, flock

    try:
        directory.mkdir(mode=PRIVATE_DIRECTORY_MODE, parents=True, exist_ok=True)
        file = (directory / "service.lock").open("w")
    except OSError as error:
        reason = error.strerror or str(error)
        raise ConfigurationError("plant.directory", directory=str(directory), reason=reason) from error
    with file:
        try:
            flock(file, LOCK_EX | LOCK_NB)
        except OSError:
            raise ConfigurationError("plant.runs_already", directory=str(directory)) from None
        with suppress(OSError):  # a full disk; the number is for people, the lock holds without it
            os.write(file.fileno(), f"{os.getpid()}\n".encode())
        yield
