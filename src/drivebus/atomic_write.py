"""Atomic replacement of files: a power cut leaves the old content or the new, never a part."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import IO


def atomic_write(path: Path, content: bytes, open_file: Callable[[Path], IO[bytes]]) -> None:
    """Replace a file; durable on return. ``open_file`` creates the new file, which lies beside the old one.

    Raises OSError; then the old file is unchanged and no other is left. One writer at a time: the remains of a killed
    writer are overwritten.
    """
    part = path.with_name(f".{path.name}.new")
    try:
        with open_file(part) as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    fsync_directory(path.parent)


def fsync_directory(folder: Path) -> None:
    """Make the names in a directory durable. Raises OSError."""
    if os.name != "posix":
        return
    fd = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
