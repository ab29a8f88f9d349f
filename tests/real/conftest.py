"""Fixtures of tests on real file descriptors: hosts and drives in separate processes of the operating system."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from fixtures.child_process import COMMAND, ENVIRONMENT
from real.recorded_bench import RecordedPlant, recorded_plant

HERE = Path(__file__).parent
Start = Callable[..., "subprocess.Popen[str]"]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    if sys.platform != "linux":
        for item in items:
            if HERE in item.path.parents:
                item.add_marker(pytest.mark.skip(reason="ptys, signals and locks as Linux has them"))


@pytest.fixture(autouse=True)
def state_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Keep lock files and EEPROM counts of a test in its own directory."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return tmp_path / "state"


@pytest.fixture
def plants(tmp_path: Path) -> Iterator[Callable[..., RecordedPlant]]:
    """Return a function that starts a plant of these lines; it ends with the test."""
    with ExitStack() as made:
        count = 0

        def make(*lines: dict[str, Any], adapters: int = 1) -> RecordedPlant:
            nonlocal count
            count += 1
            folder = tmp_path / f"plant{count}"
            folder.mkdir()
            return made.enter_context(recorded_plant(folder, *lines, adapters=adapters))

        yield make


@pytest.fixture
def started() -> Iterator[Start]:
    """Return a function that starts a program of this folder or a drivebus command; it ends with the test."""
    running: list[subprocess.Popen[str]] = []

    def start(*words: object, env: Mapping[str, str] = {}) -> subprocess.Popen[str]:
        ours = str(words[0]).endswith(".py")
        program = [sys.executable, str(HERE / str(words[0]))] if ours else [*COMMAND, str(words[0])]
        process = subprocess.Popen(
            [*program, *(str(word) for word in words[1:])],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | ENVIRONMENT | env,
        )
        running.append(process)
        return process

    yield start
    for process in running:
        process.kill()
        process.communicate()
