"""Ptys for port tests; lock files go to a directory of the test."""

from __future__ import annotations

import contextlib
import os
import tty
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest


@dataclass
class Pty:
    """A pty whose slave is the serial port and whose master plays the bus."""

    master: int
    path: str

    def send(self, data: bytes) -> None:
        os.write(self.master, data)

    def read(self, size: int = 4096) -> bytes:
        try:
            return os.read(self.master, size)
        except OSError:  # nothing there, or the slave is not open
            return b""

    def hang_up(self) -> None:
        master, self.master = self.master, -1
        if master >= 0:
            os.close(master)


def new_pty() -> Pty:
    master, slave = os.openpty()
    tty.setraw(slave)
    path = os.ttyname(slave)
    os.close(slave)
    os.set_blocking(master, False)
    return Pty(master, path)


@pytest.fixture
def pty() -> Iterator[Pty]:
    pty = new_pty()
    yield pty
    pty.hang_up()


@pytest.fixture(autouse=True)
def state_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return tmp_path / "state"


def open_descriptors() -> int:
    with contextlib.suppress(OSError):
        return len(os.listdir("/proc/self/fd"))  # noqa: PTH208
    pytest.skip("needs /proc")
