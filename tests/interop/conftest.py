"""Wires between us and programs that nobody here wrote."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from peers import need_program, skip_missing

StartProgram = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture(autouse=True)
def state_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Lock files and EEPROM counts of a test stay in its own directory."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


@pytest.fixture
def started() -> Iterator[StartProgram]:
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
def wire(started: StartProgram, tmp_path: Path) -> Iterator[tuple[str, str]]:
    """A socat pair of ptys: our end, their end. Theirs is held open, so that it outlives a server that is killed."""
    ours, theirs = tmp_path / "ours", tmp_path / "theirs"
    started(need_program("socat", "socat"), f"pty,raw,echo=0,link={ours}", f"pty,raw,echo=0,link={theirs}")
    wait_for(lambda: ours.exists() and theirs.exists(), "the socat pair")
    held = os.open(theirs, os.O_RDWR | os.O_NOCTTY)
    yield str(ours), str(theirs)
    os.close(held)


@pytest.fixture(scope="session")
def libmodbus_server(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """``libmodbus_server.c``, compiled."""
    asked = [need_program("pkg-config", "pkg-config"), "--cflags", "--libs", "libmodbus"]
    found = subprocess.run(asked, capture_output=True, text=True, check=False)
    if found.returncode:
        skip_missing("libmodbus", "apt-get install libmodbus-dev")
    target = tmp_path_factory.mktemp("peers") / "libmodbus_server"
    source = Path(__file__).with_name("libmodbus_server.c")
    subprocess.run([need_program("gcc", "gcc"), "-O1", "-o", target, source, *found.stdout.split()], check=True)
    return target
