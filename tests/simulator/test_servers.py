"""Simulated buses behind ptys and TCP ports, used by programs of other projects in real time."""

from __future__ import annotations

import asyncio
import sys
import time
from pathlib import Path

import pytest

import peers
from drivebus.protocols import modbus
from drivebus.serial_settings import SerialSettings
from drivebus.simulator.bus import SimulatedBus
from drivebus.simulator.models.catalog import make_stations
from drivebus.simulator.tcp_server import serve_tcp

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="Linux ptys")

STATUS = modbus.ModbusRtuCodec().encode_request(modbus.ReadRegisters(1, 0x3000, 4))
LINE = SerialSettings(19200)


def make_bus(text: str = "vc660@1,2", line_quality: str = "clean") -> SimulatedBus:
    return SimulatedBus(make_stations(text), LINE, line_quality=line_quality)


async def test_pymodbus_runs_a_drive_over_tcp() -> None:
    peers.need_module("pymodbus")
    from pymodbus import FramerType
    from pymodbus.client import AsyncModbusTcpClient

    simulated_bus = make_bus()
    server = await serve_tcp(simulated_bus)
    client = AsyncModbusTcpClient(server.host, port=server.port, framer=FramerType.RTU, retries=0)
    try:
        assert await client.connect()
        await client.write_register(0x2001, 3000, device_id=1)
        await client.write_register(0x2000, 1, device_id=1)
        found = await client.read_holding_registers(0x3000, count=4, device_id=1)
        assert found.registers[0] == 0b1001
        assert simulated_bus.station(1).motor.starts == 1
        rejected = await client.read_holding_registers(0x200B, count=3, device_id=1)
        assert rejected.exception_code == 2
    finally:
        client.close()
        await server.close()


async def test_pymodbus_runs_a_drive_over_a_pty(tmp_path: Path) -> None:
    peers.need_module("pymodbus")
    from pymodbus.client import AsyncModbusSerialClient

    from drivebus.simulator.pty_server import serve_pty

    server = await serve_pty(make_bus(), tmp_path / "drive")
    client = AsyncModbusSerialClient(server.path, baudrate=19200, retries=0)
    try:
        assert await client.connect()
        found = await client.read_holding_registers(0x3000, count=4, device_id=2)
        assert found.registers[0] == 1
    finally:
        client.close()
        await server.close()
    assert not (tmp_path / "drive").is_symlink()


async def test_pymodbus_runs_a_df800_in_ascii_over_tcp() -> None:
    peers.need_module("pymodbus")
    from pymodbus import FramerType
    from pymodbus.client import AsyncModbusTcpClient

    simulated_bus = SimulatedBus(make_stations("df800@1", {"encoding": "ascii"}), LINE)
    server = await serve_tcp(simulated_bus)
    client = AsyncModbusTcpClient(server.host, port=server.port, framer=FramerType.ASCII, retries=0)
    try:
        assert await client.connect()
        assert (await client.read_holding_registers(100, count=2, device_id=1)).registers == [5000, 5]
    finally:
        client.close()
        await server.close()


def request_with_pyserial(path: str, baud: int, frame: bytes = STATUS) -> tuple[bytes, float]:
    """Return the reply and its duration in seconds."""
    import serial

    with serial.Serial(path, baud, timeout=0.4) as port:
        started_at = time.monotonic()
        port.write(frame)
        data = port.read(13)
        return data, time.monotonic() - started_at


async def test_a_pty_takes_the_time_of_the_simulated_line() -> None:
    peers.need_module("serial", "pyserial")
    from drivebus.simulator.pty_server import serve_pty

    server = await serve_pty(make_bus(line_quality="bytes"))
    data, took_s = await asyncio.to_thread(request_with_pyserial, server.path, 19200)
    await server.close()
    assert len(data) == 13
    assert took_s >= (8 + 13) * 10 / 19200 + 0.004  # never faster than the wire


async def test_a_master_at_another_baud_rate_gets_no_reply() -> None:
    peers.need_module("serial", "pyserial")
    from drivebus.simulator.pty_server import serve_pty

    server = await serve_pty(make_bus())
    data, _ = await asyncio.to_thread(request_with_pyserial, server.path, 9600)
    again, _ = await asyncio.to_thread(request_with_pyserial, server.path, 19200)
    await server.close()
    assert (data, len(again)) == (b"", 13)


async def test_unplugging_hangs_the_pty_up_and_replugging_links_a_new_pty(tmp_path: Path) -> None:
    peers.need_module("serial", "pyserial")
    from drivebus.simulator.pty_server import serve_pty

    simulated_bus, link = make_bus(), tmp_path / "drive"
    server = await serve_pty(simulated_bus, link)
    with link.open("rb", buffering=0) as opened:
        simulated_bus.unplug()
        assert not link.is_symlink()
        assert await asyncio.to_thread(hung_up, opened.fileno())
    simulated_bus.replug()
    data, _ = await asyncio.to_thread(request_with_pyserial, server.path, 19200)
    await server.close()
    assert len(data) == 13


async def test_the_link_is_gone_when_the_pty_hangs_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A program that opens its port again at once would get the next pty of that number, of another plant."""
    import os

    from drivebus.simulator.pty_server import serve_pty

    simulated_bus, link = make_bus(), tmp_path / "drive"
    server = await serve_pty(simulated_bus, link)
    links, close = list[bool](), os.close
    with monkeypatch.context() as patched:
        patched.setattr(os, "close", lambda end: (links.append(link.is_symlink()), close(end)))
        simulated_bus.unplug()
    await server.close()
    assert links == [False, False]


def hung_up(descriptor: int) -> bool:
    import os

    try:
        return os.read(descriptor, 1) == b""
    except OSError:
        return True


async def test_a_link_never_replaces_a_file(tmp_path: Path) -> None:
    from drivebus.simulator.pty_server import serve_pty

    (tmp_path / "mine").write_text("mine")
    with pytest.raises(FileExistsError):
        await serve_pty(make_bus(), tmp_path / "mine")
    assert (tmp_path / "mine").read_text() == "mine"


async def test_unplugging_closes_tcp_connections_and_rejects_new_ones() -> None:
    simulated_bus = make_bus()
    server = await serve_tcp(simulated_bus)
    reader, writer = await asyncio.open_connection(server.host, server.port)
    writer.write(STATUS)
    assert len(await reader.readexactly(13)) == 13
    simulated_bus.unplug()
    with pytest.raises((ConnectionError, asyncio.IncompleteReadError)):
        await reader.readexactly(1)
    writer.close()
    second_reader, second_writer = await asyncio.open_connection(server.host, server.port)
    with pytest.raises((ConnectionError, asyncio.IncompleteReadError)):
        await second_reader.readexactly(1)
    second_writer.close()
    await server.close()
