"""Programs and packages nobody here wrote. Missing ones skip a test by name, or fail it where they are required."""

from __future__ import annotations

import importlib.util
import os
import shutil

import pytest


def skip_missing(name: str, install: str) -> None:
    """Skip with the package to install; fail where DRIVEBUS_REQUIRE_PEERS=1."""
    sentence = f"peer {name} is missing: install it with `{install}`"
    if os.environ.get("DRIVEBUS_REQUIRE_PEERS") == "1":
        pytest.fail(sentence)
    pytest.skip(sentence)


def need_program(name: str, package: str) -> str:
    """The path of a program from Debian's ``package``."""
    found = shutil.which(name) or shutil.which(name, path="/usr/sbin:/sbin")
    if found is None:
        skip_missing(name, f"apt-get install {package}")
    return str(found)


def need_module(name: str, package: str = "") -> None:
    """A module that a test compares us with, from the index's ``package`` where that has another name."""
    if importlib.util.find_spec(name) is None:
        skip_missing(package or name, f"pip install {package or name}")
