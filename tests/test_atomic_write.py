"""Replacement of a file: after an error the old content is there, and no other file."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Any

import pytest

from drivebus.atomic_write import atomic_write


@pytest.mark.skipif(os.name != "posix", reason="directories are opened on POSIX only")
@pytest.mark.parametrize("number", [errno.EMFILE, errno.EACCES])
def test_a_folder_that_can_not_be_opened_leaves_the_old_content(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    """It was opened after the replacement: the caller was told of a failure, and the new content was in force."""
    path = tmp_path / "users.json"
    atomic_write(path, b"old")
    real_open = os.open

    def fail_for_the_folder(name: Any, *arguments: Any, **options: Any) -> int:
        if Path(name) == tmp_path:
            raise OSError(number, os.strerror(number))
        return real_open(name, *arguments, **options)

    monkeypatch.setattr(os, "open", fail_for_the_folder)
    with pytest.raises(OSError, match=os.strerror(number)):
        atomic_write(path, b"new")
    assert path.read_bytes() == b"old"
    assert [*tmp_path.iterdir()] == [path]


def test_a_disk_that_fails_after_the_replacement_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The new content is complete, but a power cut may bring the old one back."""
    path = tmp_path / "users.json"
    atomic_write(path, b"old")
    real_fsync = os.fsync

    def fail_after_the_replacement(fd: int) -> None:
        if path.read_bytes() == b"new":
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        real_fsync(fd)

    monkeypatch.setattr(os, "fsync", fail_after_the_replacement)
    with pytest.raises(OSError, match=os.strerror(errno.EIO)):
        atomic_write(path, b"new")
    assert path.read_bytes() == b"new"
    assert [*tmp_path.iterdir()] == [path]
