"""Serial port of a POSIX system, on real ptys."""

from __future__ import annotations

import asyncio
import os
import termios
from pathlib import Path

import pytest

from drivebus.errors import PortLost, PortUnavailable, PortUrlError
from drivebus.ports import Port, discovery, open_port, tty
from drivebus.ports.base import PausableReader
from drivebus.ports.discovery import PortInfo
from drivebus.ports.parmrk import ParityMarkDecoder
from drivebus.ports.serial_posix import SerialPort
from fixtures.receiver import FakeReceiver, wait_until
from ports.conftest import Pty, new_pty, open_descriptors


async def opened(path: str, sink: FakeReceiver, **options: object) -> SerialPort:
    port = open_port(path, **options)
    assert isinstance(port, SerialPort)
    await port.open(sink)
    return port


async def test_bytes_go_both_ways(pty: Pty) -> None:
    sink = FakeReceiver()
    port = await opened(pty.path, sink)
    port.write(b"\x01\xff\x00\x11\x13\x0d\x0a")
    assert pty.read() == b"\x01\xff\x00\x11\x13\x0d\x0a"
    every = bytes(range(256))
    pty.send(every)
    await wait_until(lambda: len(sink.data) == 256)
    assert (bytes(sink.data), sink.line_errors) == (every, 0)
    await port.close()
    assert sink.lost == []


async def test_a_pty_reports_neither_line_timing_nor_parity(pty: Pty) -> None:
    """The missing capability is shown, not fatal."""
    port = await opened(pty.path, FakeReceiver(), baud=19200, format="8E1")
    assert (port.capabilities.has_line_timing, port.capabilities.parity) == (False, False)
    assert (port.settings.baud, port.settings.format) == (19200, "8E1")
    await port.close()


async def test_a_pty_is_opened_again_with_the_same_parity(pty: Pty) -> None:
    """The C library returns EINVAL for parity on a pty when nothing else changes, as for a second program."""
    for _ in range(3):
        port = await opened(pty.path, FakeReceiver(), baud=9600, format="8E1")
        assert port.settings.format == "8E1"
        await port.close()


async def test_the_terminal_is_raw_and_keeps_its_modem_lines_on_close(pty: Pty) -> None:
    port = await opened(pty.path, FakeReceiver(), baud=38400)
    iflag, oflag, cflag, lflag, ispeed, ospeed, _ = termios.tcgetattr(port._fd)
    assert iflag & (termios.ISTRIP | termios.IXON | termios.IXOFF | termios.ICRNL | termios.BRKINT) == 0
    assert oflag & termios.OPOST == 0
    assert lflag & (termios.ICANON | termios.ECHO | termios.ISIG | termios.IEXTEN) == 0
    assert cflag & (termios.HUPCL | termios.CRTSCTS) == 0
    assert (ispeed, ospeed) == (termios.B38400, termios.B38400)
    await port.close()


async def test_an_odd_baud_rate_is_set_and_read_back(pty: Pty) -> None:
    port = await opened(pty.path, FakeReceiver(), baud=31250)
    assert tty._baud(port._fd, 0) == 31250
    await port.close()


async def test_a_good_ff_survives_the_parity_marks_of_the_kernel(pty: Pty) -> None:
    """With PARMRK the kernel doubles FF, whole and byte by byte."""
    sink = FakeReceiver()
    port = await opened(pty.path, sink)
    tty._apply_termios(port._fd, marks_line_errors=True)
    port._mark_decoder = ParityMarkDecoder()
    pty.send(b"\xff\x00\x41\xff\xff")
    await wait_until(lambda: len(sink.data) == 5)
    for byte in b"\xff\x00\xff":
        pty.send(bytes((byte,)))
        await asyncio.sleep(0.002)
    await wait_until(lambda: len(sink.data) == 8)
    assert (bytes(sink.data), sink.line_errors) == (b"\xff\x00\x41\xff\xff\xff\x00\xff", 0)
    await port.close()


async def test_bad_bytes_are_counted(pty: Pty) -> None:
    """The parity marks are written by the test, because a pty has no parity errors."""
    sink = FakeReceiver()
    port = await opened(pty.path, sink)
    port._mark_decoder = ParityMarkDecoder()
    pty.send(b"\x01\xff\x00\x55\xff\xff\xff\x00")
    await wait_until(lambda: len(sink.data) == 3)
    pty.send(b"\x00")
    await wait_until(lambda: len(sink.data) == 4)
    assert (bytes(sink.data), sink.line_errors) == (b"\x01\x55\xff\x00", 2)
    await port.close()


def test_settings_that_the_driver_did_not_take_are_rejected_with_both(pty: Pty) -> None:
    """The kernel drops parity on a pty, like a driver without parity."""
    from drivebus.ports import serialx_adapter
    from drivebus.serial_settings import SerialSettings

    fd = os.open(pty.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        wanted = SerialSettings(9600, 8, "E", 1)
        serialx_adapter.configure(fd, pty.path, wanted)
        tty._apply_termios(fd, marks_line_errors=True)
        with pytest.raises(PortUnavailable) as caught:
            tty._verify_termios(fd, pty.path, wanted)
        assert (caught.value.key, caught.value.params["expected"]) == ("ports.format_readback", "8E1")
        assert caught.value.params["found"] == "8N1"
        with pytest.raises(PortUnavailable) as caught:
            tty._verify_termios(fd, pty.path, SerialSettings(19200))
        assert caught.value.key == "ports.baud_readback"
        assert (caught.value.params["expected"], caught.value.params["found"]) == (19200, 9600)
        tty._verify_termios(fd, pty.path, SerialSettings(9600))
        tty._apply_termios(fd, marks_line_errors=False)
        with pytest.raises(PortUnavailable) as caught:
            tty._verify_termios(fd, pty.path, SerialSettings(9600))
        assert caught.value.key == "ports.flags"
    finally:
        os.close(fd)


async def test_kernel_rs485_that_the_driver_lacks_is_rejected(pty: Pty) -> None:
    before = open_descriptors()
    with pytest.raises(PortUnavailable) as caught:
        await opened(pty.path + "?rs485=on", FakeReceiver())
    assert caught.value.key == "ports.rs485"
    assert open_descriptors() == before


async def test_an_option_of_no_port_is_rejected() -> None:
    with pytest.raises(PortUrlError):
        open_port("/dev/ttyUSB0?rs422=on")
    with pytest.raises(PortUrlError):
        open_port("/dev/ttyUSB0?echo=perhaps")
    assert open_port("/dev/ttyUSB0?echo=ON").echo == "on"


async def test_a_hang_up_is_reported_exactly_once(pty: Pty) -> None:
    sink = FakeReceiver()
    port = await opened(pty.path, sink)
    pty.hang_up()
    await wait_until(lambda: sink.lost)
    with pytest.raises(PortLost):
        port.write(b"x")
    await asyncio.sleep(0.02)
    await port.close()
    assert [error.key for error in sink.lost] == ["ports.lost"]


async def test_a_write_into_a_hang_up_raises_and_is_reported_once_and_later(pty: Pty) -> None:
    sink = FakeReceiver()
    port = await opened(pty.path, sink)
    pty.hang_up()
    with pytest.raises(PortLost):
        port.write(b"x")
    assert sink.lost == []
    await wait_until(lambda: sink.lost)
    await asyncio.sleep(0.02)
    assert len(sink.lost) == 1


async def test_bytes_before_the_hang_up_are_delivered(pty: Pty) -> None:
    sink = FakeReceiver()
    port = await opened(pty.path, sink)
    pty.send(b"last words")
    await wait_until(lambda: bytes(sink.data) == b"last words")  # the kernel drops what it has not passed on
    pty.hang_up()
    await wait_until(lambda: sink.lost)
    assert bytes(sink.data) == b"last words"
    await port.close()


async def test_a_write_that_the_kernel_does_not_take_whole_goes_on_in_order(pty: Pty) -> None:
    port = await opened(pty.path, FakeReceiver())
    sent = os.urandom(200_000)
    port.write(sent[:150_000])
    assert port._unsent
    port.write(sent[150_000:])
    got = b""
    async with asyncio.timeout(60):
        while len(got) < len(sent):
            got += pty.read(65536)
            await asyncio.sleep(0)
    assert got == sent
    await wait_until(lambda: port._stall is None)
    await port.close()


async def test_a_stalled_write_loses_the_port_and_never_blocks(pty: Pty, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivebus.ports.serial_posix.WRITE_STALL_TIMEOUT_S", 0.02)
    sink = FakeReceiver()
    port = await opened(pty.path, sink)
    port.write(bytes(200_000))
    await wait_until(lambda: sink.lost)
    assert [str(error.params["reason"]) for error in sink.lost] == ["it takes no more data"]
    with pytest.raises(PortLost):
        port.write(b"x")
    await port.close()


async def test_a_paused_reader_leaves_bytes_in_the_kernel_until_they_are_read(pty: Pty) -> None:
    sink = FakeReceiver()
    port = await opened(pty.path, sink)
    assert isinstance(port, PausableReader)
    port.pause_reading()
    port.pause_reading()
    for byte in b"reply":
        pty.send(bytes((byte,)))
        await asyncio.sleep(0.001)
    await asyncio.sleep(0.01)
    assert sink.data == b""
    port.read_pending()
    assert [data for _, data in sink.chunks] == [b"reply"]
    pty.send(b"a")
    await asyncio.sleep(0.01)
    assert bytes(sink.data) == b"reply"  # still paused
    port.resume_reading()
    port.resume_reading()
    await wait_until(lambda: bytes(sink.data) == b"replya")
    await port.close()


async def test_bytes_waiting_in_the_kernel_are_delivered_on_request(pty: Pty) -> None:
    """The bus reads waiting bytes before it continues, within the same loop iteration."""
    sink = FakeReceiver()
    port = await opened(pty.path, sink)
    port.read_pending()
    assert sink.data == b""
    pty.send(b"abc")
    port.read_pending()
    assert bytes(sink.data) == b"abc"
    await port.close()


async def test_a_closed_port_delivers_nothing_and_is_not_read_again(pty: Pty) -> None:
    sink = FakeReceiver()
    port = await opened(pty.path, sink)
    pty.send(b"a")
    await port.close()
    port.read_pending()
    port.pause_reading()
    port.resume_reading()
    await asyncio.sleep(0.01)
    assert sink.data == b""


async def test_a_port_that_was_closed_in_a_pause_is_read_after_the_next_opening(pty: Pty) -> None:
    sink = FakeReceiver()
    port = await opened(pty.path, sink)
    port.pause_reading()
    await port.close()
    await port.open(sink)
    pty.send(b"a")
    await wait_until(lambda: bytes(sink.data) == b"a")
    await port.close()


async def test_a_hang_up_during_a_pause_is_detected_by_the_next_read(pty: Pty) -> None:
    sink = FakeReceiver()
    port = await opened(pty.path, sink)
    port.pause_reading()
    pty.hang_up()
    await asyncio.sleep(0.02)
    assert not sink.lost
    port.read_pending()
    assert len(sink.lost) == 1
    await port.close()


async def test_a_moved_link_is_followed_a_thousand_times_with_no_descriptor_lost(tmp_path: Path) -> None:
    """The adapter comes back under another number; nothing of the old one stays open."""
    link = tmp_path / "inverters"
    sink, before = FakeReceiver(), 0
    port: Port | None = None
    for cycle in range(1000):
        pty = new_pty()
        link.unlink(missing_ok=True)
        link.symlink_to(pty.path)
        port = port or open_port(str(link))
        await port.open(sink)
        port.write(b"%d" % cycle)
        assert pty.read() == b"%d" % cycle
        pty.hang_up()
        await wait_until(lambda: len(sink.lost) > cycle)  # noqa: B023  # awaited here
        if cycle == 10:
            await port.close()
            before = open_descriptors()
    assert port is not None
    await port.close()
    assert len(sink.lost) == 1000
    assert open_descriptors() <= before


async def test_the_same_adapter_is_found_under_its_new_name_and_another_one_is_rejected(
    pty: Pty, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The adapter ttyUSB0 came back as ttyUSB1, and ttyUSB0 is another adapter now."""
    other = new_pty()
    plugged = {"usb:0403:6001:A1:0": pty.path}
    monkeypatch.setattr(
        "drivebus.ports.tty.discover_ports",
        lambda: [
            PortInfo(device=device, description="", identity=identity, url=device)
            for identity, device in plugged.items()
        ],
    )
    sink = FakeReceiver()
    port = await opened(pty.path, sink)
    assert port.identity == "usb:0403:6001:A1:0"
    await port.close()
    plugged.clear()
    plugged["usb:0403:6001:B2:0"] = pty.path
    with pytest.raises(PortUnavailable) as caught:
        await port.open(sink)
    assert (caught.value.key, caught.value.params["identity"]) == ("ports.unplugged", "usb:0403:6001:A1:0")
    plugged["usb:0403:6001:A1:0"] = other.path
    await port.open(sink)
    port.write(b"found")
    assert other.read() == b"found"
    await port.close()
    other.hang_up()


async def test_a_cancelled_opening_leaves_nothing_open(pty: Pty) -> None:
    port = open_port(pty.path)
    await port.open(FakeReceiver())
    await port.close()
    before = open_descriptors()
    task = asyncio.create_task(port.open(FakeReceiver()))
    await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    await port.open(FakeReceiver())
    await port.close()
    assert open_descriptors() == before


def device(name: str, **facts: object) -> discovery.serialx_adapter.Device:
    blank = dict.fromkeys(
        [
            "vid",
            "pid",
            "serial_number",
            "manufacturer",
            "product",
            "bcd_device",
            "interface_description",
            "interface_num",
        ]
    )
    return discovery.serialx_adapter.Device(**{"device": name, "resolved_device": name, **blank, **facts})  # type: ignore[arg-type]


def test_an_adapter_is_identified_by_its_serial_number_or_else_by_its_usb_socket() -> None:
    found = discovery.describe(
        [
            device("/dev/ttyUSB10", vid=0x1A86, pid=0x7523, product="USB Serial", interface_num=0),
            device("/dev/ttyUSB2", vid=0x0403, pid=0x6001, serial_number="A9XK21QZ", product="FT232R", interface_num=0),
            device("/dev/ttyUSB3", vid=0x0403, pid=0x6011, serial_number="FT7", interface_num=1, port_number=0),
            device("/dev/ttyS0"),
        ],
        {"/dev/ttyUSB2": "/dev/serial/by-id/usb-FTDI", "/dev/ttyUSB10": "/dev/serial/by-id/usb-1a86"},
        {"/dev/ttyUSB10": "/dev/serial/by-path/pci-0:3", "/dev/ttyUSB2": "/dev/serial/by-path/pci-0:4"},
    )
    assert [(port.device, port.identity, port.url) for port in found] == [
        ("/dev/ttyS0", "device:/dev/ttyS0", "/dev/ttyS0"),
        ("/dev/ttyUSB2", "usb:0403:6001:A9XK21QZ:0", "/dev/serial/by-id/usb-FTDI"),
        ("/dev/ttyUSB3", "usb:0403:6011:FT7:1", "/dev/ttyUSB3"),
        ("/dev/ttyUSB10", "path:pci-0:3", "/dev/serial/by-path/pci-0:3"),
    ]
    assert [port.description for port in found] == ["ttyS0", "FT232R", "ttyUSB3", "USB Serial"]


def test_adapters_with_the_same_serial_number_are_distinguished_by_their_usb_sockets() -> None:
    """Cloned adapters have the same serial number, by which the wrong bus would be opened."""
    twins = [device(f"/dev/ttyUSB{n}", vid=1, pid=2, serial_number="XYZ123", interface_num=0) for n in (0, 1)]
    found = discovery.describe(twins, {}, {"/dev/ttyUSB0": "/by-path/a", "/dev/ttyUSB1": "/by-path/b"})
    assert [port.identity for port in found] == ["path:a", "path:b"]
    assert {port.identity for port in discovery.describe(twins, {}, {})} == {
        "device:/dev/ttyUSB0",
        "device:/dev/ttyUSB1",
    }


def test_this_machine_is_listed_without_an_error() -> None:
    assert all(port.device and port.identity for port in discovery.list_ports())
