"""Fixtures of tests with other projects' programs: virtual wires and processes."""

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
    """Keep lock files and EEPROM counts of a test in its own directory."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


@pytest.fixture
def started() -> Iterator[StartProgram]:
    """Return a function that starts a program, which ends with the test."""
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
        process.wait(60)
        assert process.stdout is not None
        process.stdout.close()


def wait_for(condition: Callable[[], bool], what: str, seconds: float = 60.0) -> None:
    """Wait for a condition outside this process; ``what`` names it in the failure."""
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until, f"{what} did not come in {seconds} s"
        time.sleep(0.02)


@pytest.fixture
def wire(started: StartProgram, tmp_path: Path) -> Iterator[tuple[str, str]]:
    """Run a socat pair of ptys: our end, the peer's end, which stays open when a server is killed."""
    our_end, peer_end = tmp_path / "our_end", tmp_path / "peer_end"
    started(need_program("socat", "socat"), f"pty,raw,echo=0,link={our_end}", f"pty,raw,echo=0,link={peer_end}")
    wait_for(lambda: our_end.exists() and peer_end.exists(), "the socat pair")
    peer_fd = os.open(peer_end, os.O_RDWR | os.O_NOCTTY)
    yield str(our_end), str(peer_end)
    os.close(peer_fd)


@pytest.fixture(scope="session")
def libmodbus_server(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return ``libmodbus_server.c``, compiled."""
    command = [need_program("pkg-config", "pkg-config"), "--cflags", "--libs", "libmodbus"]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    if found.returncode:
        skip_missing("libmodbus", "apt-get install libmodbus-dev")
    target = tmp_path_factory.mktemp("peers") / "libmodbus_server"
    source = Path(__file__).with_name("libmodbus_server.c")
    subprocess.run([need_program("gcc", "gcc"), "-O1", "-o", target, source, *found.stdout.split()], check=True)
    return target
