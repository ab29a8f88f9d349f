"""Lock on a state directory: one service at a time. The system releases it however the process ends."""

from __future__ import annotations

import errno
import logging
import os
import shlex
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from drivebus import i18n
from drivebus.atomic_write import PRIVATE_FILE_MODE
from drivebus.errors import ConfigurationError, SystemReason
from drivebus.service.process.permissions import ROOT, check_trusted

LOG = logging.getLogger("drivebus.service")
PRIVATE_DIRECTORY_MODE = 0o700
_LOCK_FLAGS = os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
_LOCK_FILE = "service.lock"
_UNWRITABLE = frozenset({errno.EROFS, errno.EACCES, errno.ENOSPC, errno.EDQUOT, errno.EIO})


@contextmanager
def single_instance(directory: Path) -> Iterator[None]:
    """Hold the lock while the block lasts.

    The directory itself is locked beside its ``service.lock``, which cannot be created where the directory cannot be
    written, or a folder has its name. Raises ConfigurationError where another service holds it, or where others could
    write the directory.
    """
    with ExitStack() as stack:
        try:
            directory.mkdir(mode=PRIVATE_DIRECTORY_MODE, parents=True, exist_ok=True)
            check_trusted(directory, root_may_own=False)
            itself = os.open(directory, os.O_RDONLY | os.O_CLOEXEC)
            stack.callback(os.close, itself)
            file = _open_lock_file(directory / _LOCK_FILE)
        except OSError as error:
            raise ConfigurationError("plant.directory", directory=str(directory), reason=SystemReason(error)) from error
        if file is not None:
            stack.callback(os.close, file)
        if not all(_lock(fd) for fd in (file, itself) if fd is not None):
            raise ConfigurationError("plant.runs_already", directory=str(directory))
        if file is not None:
            with suppress(OSError):  # a full disk; the number is for people, the lock holds without it
                os.ftruncate(file, 0)
                os.write(file, f"{os.getpid()}\n".encode())
        yield


def _open_lock_file(path: Path) -> int | None:
    """Open or create the lock file; return None where the directory cannot be written. Raises OSError."""
    try:
        return os.open(path, _LOCK_FLAGS, PRIVATE_FILE_MODE)
    except IsADirectoryError:
        LOG.error(i18n.preferred_text("plant.lock_is_folder", path=path))
        return None
    except OSError as error:
        if error.errno not in _UNWRITABLE:
            raise
        reason = SystemReason(error)
        LOG.error(i18n.preferred_text("log.directory_unwritable", directory=path.parent, reason=reason))
        return None


def directory_problems(directory: Path) -> Iterator[ConfigurationError]:
    """Yield why a service could not write its state directory, or lock it with its file; one that is missing is made.

    The service runs as the owner of the directory, so that user's rights count, not those of the caller.
    """
    with suppress(OSError):  # a directory that this user may not enter is not known
        status = directory.stat()
        root_owns, is_owner = status.st_uid == ROOT, status.st_uid == os.geteuid()
        by_mode = status.st_mode & PRIVATE_DIRECTORY_MODE == PRIVATE_DIRECTORY_MODE
        if os.statvfs(directory).f_flag & os.ST_RDONLY:
            yield ConfigurationError("plant.directory_read_only", directory=str(directory))
        elif not (by_mode or root_owns) or (is_owner and not os.access(directory, os.W_OK | os.X_OK)):
            yield ConfigurationError(
                "plant.directory_unwritable", directory=str(directory), quoted=shlex.quote(str(directory))
            )
        if (directory / _LOCK_FILE).is_dir():
            yield ConfigurationError("plant.lock_is_folder", path=str(directory / _LOCK_FILE))


def _lock(fd: int) -> bool:
    """Lock a file; return False where another process holds it. A file system may have no locks of directories."""
    from fcntl import LOCK_EX, LOCK_NB, flock

    try:
        flock(fd, LOCK_EX | LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True
