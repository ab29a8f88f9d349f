"""Replacing a file as a whole, so that a power cut leaves the old one or the new one."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import IO


def atomic_write(path: Path, content: bytes, open_file: Callable[[Path], IO[bytes]]) -> None:
    """Old or new, never half; durable on return. ``make`` opens the new file, which lies beside the old one.

    Raises OSError; then the old one is as it was and no other is left. One writer at a time: what a killed one left is
    written over.
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
    """Names in it survive a power cut. Raises OSError."""
    if os.name != "posix":
        return
    fd = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
