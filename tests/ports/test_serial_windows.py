"""COM port of Windows with a fake transport, because that of serialx runs on Windows only."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace

import pytest

from drivebus.errors import PortLost, PortUnavailable
from drivebus.ports import open_errors, serialx_adapter
from drivebus.ports.serial_windows import MAX_UNSENT_BYTES, WindowsPort
from drivebus.ports.url import parse_port_url
from drivebus.serial_settings import SerialSettings
from fixtures.receiver import FakeReceiver


class Transport(asyncio.Transport):
    def __init__(self) -> None:
        super().__init__()
        self.sent = b""
        self.unsent = 0
        self.ended = ""

    def write(self, data: bytes | bytearray | memoryview) -> None:
        self.sent += bytes(data)

    def get_write_buffer_size(self) -> int:
        return self.unsent

    def close(self) -> None:
        self.ended = "closed"

    def abort(self) -> None:
        self.ended = "aborted"


@pytest.fixture
def transport(monkeypatch: pytest.MonkeyPatch) -> Transport:
    transport = Transport()

    async def connect(path: str, settings: SerialSettings, protocol: asyncio.Protocol) -> Transport:
        return transport

    monkeypatch.setattr(serialx_adapter, "connect_windows", connect)
    return transport


@pytest.mark.parametrize(
    ("error", "is_busy"), [(PermissionError(13, "Access is denied"), True), (FileNotFoundError(2, "no COM3"), False)]
)
async def test_only_a_port_that_windows_denies_is_called_in_use(
    monkeypatch: pytest.MonkeyPatch, error: OSError, is_busy: bool
) -> None:
    """Windows opens a COM port for one program, and denies it to any other without naming the first."""

    async def connect(*_: object) -> Transport:
        raise error

    monkeypatch.setattr(serialx_adapter, "connect_windows", connect)
    monkeypatch.setattr(open_errors, "sys", SimpleNamespace(platform="win32"))
    with pytest.raises(PortUnavailable) as caught:
        await WindowsPort(parse_port_url("com3")).open(FakeReceiver())
    assert (caught.value.key == "ports.busy_windows") is is_busy


async def test_a_com_port_sends_receives_and_is_lost_once(transport: Transport) -> None:
    port, sink = WindowsPort(parse_port_url("com3?baud=19200&format=8E1")), FakeReceiver()
    assert port.identity == "device:COM3"
    assert WindowsPort(parse_port_url(r"\\.\COM12")).identity == "device:COM12"
    with pytest.raises(PortLost) as caught:
        port.write(b"x")
    assert caught.value.key == "ports.not_open"
    await port.open(sink)
    assert (port.capabilities.has_line_timing, port.capabilities.parity) == (True, False)
    with pytest.raises(PortUnavailable):
        await port.open(sink)
    port.write(b"ask")
    port.data_received(b"reply")
    assert (transport.sent, bytes(sink.data)) == (b"ask", b"reply")
    port.connection_lost(OSError("removed"))
    port.connection_lost(None)
    assert [str(error.params["reason"]) for error in sink.lost] == ["removed"]


async def test_a_com_port_that_sends_nothing_is_lost_after_the_timeout(transport: Transport) -> None:
    port, sink = WindowsPort(parse_port_url("COM3")), FakeReceiver()
    await port.open(sink)
    transport.unsent = MAX_UNSENT_BYTES + 1
    with pytest.raises(PortLost):
        port.write(b"x")
    assert (transport.sent, transport.ended) == (b"", "aborted")
    port.connection_lost(None)
    assert [error.params["reason"].key for error in sink.lost] == ["ports.closed"]


async def test_a_closed_com_port_delivers_nothing(transport: Transport) -> None:
    port, sink = WindowsPort(parse_port_url("COM3")), FakeReceiver()
    await port.open(sink)
    await port.close()
    port.data_received(b"late")
    port.connection_lost(None)
    assert (transport.ended, sink.data, sink.lost) == ("closed", b"", [])


async def test_a_com_port_that_cannot_be_opened_reports_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    async def missing(*_: object) -> Transport:
        raise FileNotFoundError(2, "not found")

    monkeypatch.setattr(serialx_adapter, "connect_windows", missing)
    monkeypatch.setattr("drivebus.ports.open_errors.discover_ports", list)
    monkeypatch.setattr("drivebus.ports.open_errors._in_wsl", lambda: False)
    with pytest.raises(PortUnavailable) as caught:
        await WindowsPort(parse_port_url("COM9")).open(FakeReceiver())
    assert caught.value.key == "ports.missing_none"
