"""Files that a command writes at a path of the user: complete or not at all."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from drivebus.atomic_write import atomic_write
from drivebus.cli import output
from drivebus.errors import ConfigurationError, SystemReason


@contextmanager
def file_errors(file: str | Path) -> Iterator[None]:
    """Raise ConfigurationError for a file that exists already or can't be written."""
    try:
        yield
    except FileExistsError:
        raise ConfigurationError("cli.file_exists", file=str(file)) from None
    except OSError as error:
        raise ConfigurationError("cli.file_unwritten", file=str(file), reason=SystemReason(error)) from error


def write_file(file: str | Path, content: bytes, *, replace: bool) -> None:
    """Write a new file, or with ``replace`` also in the place of an old one, which stays where the new one fails.

    A link is replaced, not its file; a device or pipe is written to. Raises FileExistsError without ``replace``, and
    OSError.
    """
    path = Path(file)
    if not replace:
        _write_new(path, content)
        return
    mode = path.stat().st_mode if path.exists() else None
    if mode is None or stat.S_ISREG(mode):
        atomic_write(path, content, 0o666 if mode is None else stat.S_IMODE(mode))
    else:
        path.write_bytes(content)


def write_or_print(file: str, text: str, *, replace: bool) -> None:
    """Write a text as ``write_file`` does; print it where that fails, because it may hold the result of a long scan."""
    try:
        write_file(file, text.encode(), replace=replace)
    except OSError:
        output.echo(text, err=output.as_json())
        raise


def check_writable(file: str | Path, *, replace: bool) -> None:
    """Raise the OSError with which ``write_file`` would fail, before the work for it; a full disk shows only then."""
    path = Path(file)
    if replace and path.exists() and not (path.is_file() or path.is_dir()):
        return  # a device or pipe
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(file))
    if not replace and path.exists():
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(file))
    folder = path.parent
    if not folder.is_dir():
        missing = errno.ENOTDIR if folder.exists() else errno.ENOENT
        raise OSError(missing, os.strerror(missing), str(file))
    if not os.access(folder, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(file))


def _write_new(path: Path, content: bytes) -> None:
    """Write a file that does not exist yet; remove it where it can't be completed."""
    with path.open("xb") as stream:
        try:
            stream.write(content)
            stream.flush()
        except BaseException:
            path.unlink()
            raise
