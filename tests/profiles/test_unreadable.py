"""Folders of profiles that can't be read just now: reported, and read again the next time."""

from __future__ import annotations

import os
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from drivebus import profiles
from drivebus.errors import ProfileError

LOAD: Any = import_module("drivebus.profiles.load")


@pytest.fixture(autouse=True)
def _forgotten() -> Iterator[None]:
    LOAD._builtin_files.cache_clear()
    yield
    LOAD._builtin_files.cache_clear()


def refuse(monkeypatch: pytest.MonkeyPatch, folder: Path, error: OSError) -> None:
    plain = os.listdir

    def listdir(path: Any = ".") -> list[str]:
        if Path(path) == folder:
            raise error
        return plain(path)

    monkeypatch.setattr(os, "listdir", listdir)


@pytest.mark.parametrize("folder", [LOAD.DATA_DIRECTORY, LOAD.DATA_DIRECTORY / "sunfar"])
@pytest.mark.parametrize("error", [PermissionError(13, "Permission denied"), OSError(24, "Too many open files")])
def test_a_folder_that_can_not_be_read_is_no_folder_without_models(
    monkeypatch: pytest.MonkeyPatch, folder: Path, error: OSError
) -> None:
    with monkeypatch.context() as context:
        refuse(context, folder, error)
        with pytest.raises(ProfileError) as caught:
            profiles.load("c320")
        assert caught.value.params["file"] == str(folder) and str(error.strerror) in str(caught.value)
    assert profiles.load("c320").model == "c320"


def test_a_users_own_folder_that_can_not_be_read_does_not_hide_the_built_in_models(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A service may run under a home that is not its own."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    own = LOAD.user_directory()
    own.mkdir(parents=True)
    refuse(monkeypatch, own, PermissionError(13, "Permission denied"))
    assert profiles.load("c320").model == "c320" and "c320" in profiles.models()
    with pytest.raises(ProfileError) as caught:
        profiles.load("mine")
    assert 'a file that can\'t be read: "Permission denied" found' in caught.value.text("en")
    assert '文件无法读取：实际为 "权限不足"' in caught.value.text("zh")
