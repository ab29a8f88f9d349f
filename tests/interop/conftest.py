"""Wires between us and programs that nobody here wrote."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from peers import need_program


@pytest.fixture
def started() -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Start a program and end it with the test."""
    running: list[subprocess.Popen[str]] = []

    def start(*command: object) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [str(part) for part in command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        running.append(process)
        return process

    yield start
    for process in running:
        process.terminate()
        process.wait(5)
        assert process.stdout is not None
        process.stdout.close()


def wait_for(there: Callable[[], bool], what: str, seconds: float = 10.0) -> None:
    """Wait for something outside this process, with a name for when it does not come."""
    until = time.monotonic() + seconds
    while not there():
        assert time.monotonic() < until, f"{what} did not come in {seconds} s"
        time.sleep(0.02)


@pytest.fixture
def wire(started: Callable[..., subprocess.Popen[str]], tmp_path: Path) -> tuple[str, str]:
    """A socat pair of ptys: our end, their end."""
    ours, theirs = tmp_path / "ours", tmp_path / "theirs"
    started(need_program("socat", "socat"), f"pty,raw,echo=0,link={ours}", f"pty,raw,echo=0,link={theirs}")
    wait_for(lambda: ours.exists() and theirs.exists(), "the socat pair")
    return str(ours), str(theirs)
