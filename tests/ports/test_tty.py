"""Opening of a real port, on a pty that is taken for one, and failures that only real devices have."""

from __future__ import annotations

import asyncio
import errno
import fcntl
import os
import subprocess
import sys
import termios
from pathlib import Path

import pytest

from drivebus.errors import PortLost, PortUnavailable
from drivebus.ports import latency_timer, open_port, serialx_adapter, tty
from drivebus.ports.base import PausableReader, port_notes
from drivebus.ports.recording import RecordingPort
from drivebus.ports.serial_posix import SerialPort
from drivebus.serial_settings import SerialSettings
from fixtures.receiver import FakeReceiver, wait_until
from ports.conftest import Pty, open_descriptors


@pytest.fixture
def real(monkeypatch: pytest.MonkeyPatch) -> None:
    """Declare ptys real ports, without the check for other users."""
    monkeypatch.setattr(tty, "is_pty", lambda _: False)
    monkeypatch.setattr("drivebus.ports.tty.device_users", lambda paths: {path: [] for path in paths})


async def opened(pty: Pty, sink: FakeReceiver, **options: object) -> SerialPort:
    port = open_port(pty.path, **options)
    assert isinstance(port, SerialPort)
    await port.open(sink)
    return port


@pytest.mark.usefixtures("real")
async def test_a_real_port_has_line_timing_parity_marks_and_an_exclusive_lock(pty: Pty) -> None:
    sink = FakeReceiver()
    port = await opened(pty, sink, baud=19200)
    assert port.capabilities.has_line_timing
    assert termios.tcgetattr(port._fd)[0] == termios.INPCK | termios.PARMRK
    assert int.from_bytes(fcntl.ioctl(port._fd, 0x80045440, bytes(4)), sys.byteorder) == 1
    pty.send(b"\x01\xff\x00\xff\xff")
    await wait_until(lambda: len(sink.data) == 5)
    assert (bytes(sink.data), sink.line_errors) == (b"\x01\xff\x00\xff\xff", 0)
    await port.close()


@pytest.mark.usefixtures("real")
async def test_a_driver_that_ignores_parity_is_rejected_and_nothing_stays_open(pty: Pty) -> None:
    """Parity is the only check of a DZB100; the driver of a pty ignores PARENB."""
    await (await opened(pty, FakeReceiver())).close()
    before = open_descriptors()
    with pytest.raises(PortUnavailable) as caught:
        await opened(pty, FakeReceiver(), format="8E1")
    assert (caught.value.key, caught.value.params["expected"], caught.value.params["found"]) == (
        "ports.format_readback",
        "8E1",
        "8N1",
    )
    assert open_descriptors() == before
    await (await opened(pty, FakeReceiver())).close()


@pytest.mark.usefixtures("real")
async def test_parity_is_reported_only_where_it_was_tested(pty: Pty, monkeypatch: pytest.MonkeyPatch) -> None:
    proved = []
    monkeypatch.setattr(tty, "_verify_termios", lambda fd, path, settings: proved.append(settings.format))
    port = await opened(pty, FakeReceiver(), format="8E1")
    assert (port.capabilities.parity, proved) == (True, ["8E1"])
    await port.close()
    port = await opened(pty, FakeReceiver(), format="8N1")
    assert port.capabilities.parity is False
    await port.close()


async def test_a_pty_notes_that_its_parity_is_not_checked(pty: Pty) -> None:
    port = await opened(pty, FakeReceiver(), format="8E1")
    assert [note.key for note in port_notes(port)] == ["ports.note_parity"]
    assert "8E1" in port_notes(port)[0].text("zh")
    await port.close()


async def test_an_adapter_with_high_latency_is_set_to_low_latency_or_noted(
    pty: Pty, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An FTDI adapter delays bytes by up to 16 ms unless it is configured."""
    folder = tmp_path / os.path.basename(pty.path)  # noqa: PTH119
    folder.mkdir(parents=True)
    timer = folder / "latency_timer"
    timer.write_text("16\n")
    monkeypatch.setattr(latency_timer, "USB_SERIAL_DEVICES", tmp_path)
    port = await opened(pty, FakeReceiver())
    assert (timer.read_text(), port_notes(port)) == ("1", ())
    await port.close()
    timer.write_text("16\n")
    monkeypatch.setattr(Path, "write_text", lambda *_: (_ for _ in ()).throw(PermissionError()))
    port = await opened(pty, FakeReceiver())
    assert [note.key for note in port_notes(port)] == ["ports.note_latency"]
    await port.close()


async def test_kernel_rs485_is_set_and_read_back(pty: Pty, monkeypatch: pytest.MonkeyPatch) -> None:
    requests = []

    class Kernel:
        """An fcntl of a driver that can switch the direction."""

        @staticmethod
        def ioctl(fd: int, request: int, data: bytes) -> bytes:
            requests.append((request, data))
            return data if request != tty._TIOCGRS485 else requests[0][1]

    fd = os.open(pty.path, os.O_RDWR | os.O_NOCTTY)
    monkeypatch.setattr(tty, "fcntl", Kernel)
    tty._enable_rs485(fd, pty.path)
    assert requests[0] == (0x542F, (3).to_bytes(4, sys.byteorder) + bytes(28))
    monkeypatch.setattr(Kernel, "ioctl", staticmethod(lambda fd, request, data: bytes(32)))
    with pytest.raises(PortUnavailable) as caught:
        tty._enable_rs485(fd, pty.path)
    assert caught.value.key == "ports.rs485"
    os.close(fd)


async def test_a_driver_that_rejects_low_latency_is_used_without_it(pty: Pty, monkeypatch: pytest.MonkeyPatch) -> None:
    tries = []

    def set_up(fd: int, path: str, settings: SerialSettings, **latency: bool) -> None:
        tries.append(latency)
        if not latency:
            raise OSError(errno.EINVAL, "Invalid argument")

    monkeypatch.setattr(serialx_adapter, "_configure", set_up)
    serialx_adapter.configure(0, pty.path, SerialSettings())
    assert tries == [{}, {"low_latency": False}]


def failing(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """Let os.read or os.write of the port module fail as an unplugged USB adapter does."""

    def fails(*_: object) -> bytes:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr("drivebus.ports.serial_posix.os." + name, fails)


async def test_an_adapter_unplugged_while_a_frame_is_half_sent_is_reported_once(
    pty: Pty, monkeypatch: pytest.MonkeyPatch
) -> None:
    sink = FakeReceiver()
    port = await opened(pty, sink)
    port.write(bytes(200_000))
    with monkeypatch.context() as patch:
        failing(patch, "write")
        port._writable()
    assert [str(error.params["reason"]) for error in sink.lost] == ["Input/output error"]
    assert "输入输出错误" in sink.lost[0].text("zh")
    with pytest.raises(PortLost):
        port.write(b"x")
    await port.close()


async def test_an_empty_read_is_a_hang_up(pty: Pty, monkeypatch: pytest.MonkeyPatch) -> None:
    """A hung-up terminal of the kernel reads as end of file."""
    sink = FakeReceiver()
    port = await opened(pty, sink)
    with monkeypatch.context() as patch:
        patch.setattr("drivebus.ports.serial_posix.os.read", lambda *_: b"")
        port._readable()
    assert [error.params["reason"].key for error in sink.lost] == ["ports.hang_up"]
    await port.close()


async def test_a_full_kernel_buffer_is_no_error(pty: Pty, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> int:
        raise BlockingIOError

    port = await opened(pty, FakeReceiver())
    with monkeypatch.context() as patch:
        patch.setattr("drivebus.ports.serial_posix.os.write", full)
        port.write(b"abc")
        port._writable()
    await wait_until(lambda: not port._unsent)
    assert pty.read() == b"abc"
    await port.close()


async def test_a_recorded_serial_port_can_still_be_paused(pty: Pty, tmp_path: Path) -> None:
    port, sink = RecordingPort(open_port(pty.path), tmp_path / "a.dbcap"), FakeReceiver()
    assert isinstance(port, PausableReader)
    await port.open(sink)
    port.pause_reading()
    pty.send(b"a")
    await asyncio.sleep(0.01)
    assert not sink.data
    port.read_pending()
    assert bytes(sink.data) == b"a"
    pty.send(b"b")
    port.resume_reading()
    await wait_until(lambda: bytes(sink.data) == b"ab")
    assert (port.identity, port.url, port.echo, port.notes, port.error) == (
        f"device:{pty.path}",
        pty.path,
        "detect",
        (),
        None,
    )
    await port.close()
    port.end_capture()


def test_nothing_that_windows_lacks_is_imported_before_a_port_of_its_kind_is_opened() -> None:
    program = (
        "import sys\n"
        "for name in ('termios', 'fcntl', 'tty', 'pty', 'grp', 'pwd', 'serialx'): sys.modules[name] = None\n"
        "import drivebus.ports, drivebus.capture.dbcap\n"
        "from drivebus.ports import tcp, rfc2217, memory, replay, recording, open_port\n"
        "for url in ('tcp://h:1', 'rfc2217://h:1', 'memory://m'): open_port(url)\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
