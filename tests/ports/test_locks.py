"""Exclusive ownership of a port: a second instance gets the pid of the first."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivebus.errors import PortUnavailable
from drivebus.ports import open_port
from drivebus.ports.locks import DeviceBusy, DeviceLock, lock_dir, lock_owner
from fixtures.receiver import FakeReceiver
from ports.conftest import Pty

HOLD = (
    "import asyncio, sys\n"
    "from drivebus.ports import open_port\n"
    "class Nobody:\n"
    "    def data_received(self, data, marks=0): ...\n"
    "    def port_lost(self, error): ...\n"
    "async def main():\n"
    "    await open_port(sys.argv[1]).open(Nobody())\n"
    "    print('open', flush=True)\n"
    "    await asyncio.sleep(60)\n"
    "asyncio.run(main())\n"
)


@pytest.fixture
def first(pty: Pty) -> Iterator[subprocess.Popen[bytes]]:
    """Start another drivebus that has opened the pty."""
    with subprocess.Popen([sys.executable, "-c", HOLD, pty.path], stdout=subprocess.PIPE) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == b"open\n"
        yield child
        child.kill()


async def test_a_second_instance_is_rejected_100_times_of_100_with_the_pid_of_the_first(
    pty: Pty, first: subprocess.Popen[bytes]
) -> None:
    port = open_port(pty.path)
    for _ in range(100):
        with pytest.raises(PortUnavailable) as caught:
            await port.open(FakeReceiver())
        assert (caught.value.key, caught.value.params["pid"]) == ("ports.held_drivebus", first.pid)
    assert str(first.pid) in str(caught.value)
    assert str(first.pid) in caught.value.text("zh")


async def test_the_stale_lock_of_a_killed_instance_is_replaced(pty: Pty, first: subprocess.Popen[bytes]) -> None:
    os.kill(first.pid, signal.SIGKILL)
    first.wait()
    files = list(lock_dir().iterdir())
    assert [file.read_text() for file in files] == [f"{first.pid}\n"]
    assert lock_owner(pty.path) is None
    port = open_port(pty.path)
    await port.open(FakeReceiver())
    assert [file.read_text() for file in files] == [f"{os.getpid()}\n"]
    await port.close()
    assert [file.read_text() for file in files] == [""]


async def test_this_program_can_not_open_a_port_twice(pty: Pty) -> None:
    first, second = open_port(pty.path), open_port(pty.path)
    await first.open(FakeReceiver())
    with pytest.raises(PortUnavailable) as caught:
        await first.open(FakeReceiver())
    assert caught.value.key == "ports.already_open"
    with pytest.raises(PortUnavailable) as caught:
        await second.open(FakeReceiver())
    assert caught.value.key == "ports.already_open"
    await first.close()
    await second.open(FakeReceiver())
    await second.close()


async def test_another_name_of_the_same_device_is_the_same_device(pty: Pty, tmp_path: Path) -> None:
    (tmp_path / "alias").symlink_to(pty.path)
    first, second = open_port(pty.path), open_port(str(tmp_path / "alias"))
    await first.open(FakeReceiver())
    with pytest.raises(PortUnavailable):
        await second.open(FakeReceiver())
    await first.close()


def test_a_program_that_uses_only_flock_is_locked_out_and_locks_out_drivebus(
    pty: Pty, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a common lock file (another user's state directory) the lock on the device still excludes."""
    import fcntl

    other_fd = os.open(pty.path, os.O_RDWR | os.O_NOCTTY)
    ours = os.open(pty.path, os.O_RDWR | os.O_NOCTTY)
    fcntl.flock(other_fd, fcntl.LOCK_EX)
    with pytest.raises(DeviceBusy) as caught:
        DeviceLock(ours, pty.path)
    assert caught.value.pid is None
    fcntl.flock(other_fd, fcntl.LOCK_UN)
    lock = DeviceLock(ours, pty.path, exclusive=False)
    with pytest.raises(BlockingIOError):
        fcntl.flock(other_fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    lock.release()
    lock.release()
    os.close(ours)
    os.close(other_fd)


def test_an_exclusive_lock_sets_the_terminal_flag_and_clears_it(pty: Pty) -> None:
    import fcntl

    TIOCGEXCL = 0x80045440
    fd = os.open(pty.path, os.O_RDWR | os.O_NOCTTY)
    lock = DeviceLock(fd, pty.path)
    assert int.from_bytes(fcntl.ioctl(fd, TIOCGEXCL, bytes(4)), sys.byteorder) == 1
    lock.release()
    assert int.from_bytes(fcntl.ioctl(fd, TIOCGEXCL, bytes(4)), sys.byteorder) == 0
    os.close(fd)


def test_a_state_directory_that_can_not_be_written_leaves_the_lock_on_the_device(
    pty: Pty, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "file"))
    fd = os.open(pty.path, os.O_RDWR | os.O_NOCTTY)
    two = os.open(pty.path, os.O_RDWR | os.O_NOCTTY)
    lock = DeviceLock(fd, pty.path, exclusive=False)
    with pytest.raises(DeviceBusy):
        DeviceLock(two, pty.path, exclusive=False)
    lock.release()
    os.close(fd)
    os.close(two)
