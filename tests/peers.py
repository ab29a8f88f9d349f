"""Programs and packages of other projects: a missing one skips a test, or fails it with DRIVEBUS_REQUIRE_PEERS=1."""

from __future__ import annotations

import importlib.util
import os
import shutil

import pytest


def skip_missing(name: str, install: str) -> None:
    """Skip the test with the package to install; fail with DRIVEBUS_REQUIRE_PEERS=1."""
    sentence = f"peer {name} is missing: install it with `{install}`"
    if os.environ.get("DRIVEBUS_REQUIRE_PEERS") == "1":
        pytest.fail(sentence)
    pytest.skip(sentence)


def need_program(name: str, package: str) -> str:
    """Return the path of a program of Debian's ``package``; skip without it."""
    found = shutil.which(name) or shutil.which(name, path="/usr/sbin:/sbin")
    if found is None:
        skip_missing(name, f"apt-get install {package}")
    return str(found)


def need_module(name: str, package: str = "") -> None:
    """Skip without a module, which pip installs by the name ``package``."""
    if importlib.util.find_spec(name) is None:
        skip_missing(package or name, f"pip install {package or name}")
