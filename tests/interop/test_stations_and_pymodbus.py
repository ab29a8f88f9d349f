"""Our simulated VC660 and DF800 answer pymodbus: its asyncio and its synchronous client, RTU and ASCII, pty and TCP."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from drivebus.serial_settings import SerialSettings
from drivebus.simulator.bus import SimulatedBus
from fixtures.station_bench import quick_bench, serve_on_pty, serve_on_tcp, wait_until
from peers import need_module

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="ptys as Linux has them")

COMMAND, SETPOINT, STATUS = 0x2000, 0x2001, 0x3000
START = {"vc660": 1, "df800": 2}
STOP = {"vc660": 2, "df800": 1}
"""Stop commands: the same word means the opposite to the other model."""
WAYS = [
    ("vc660", "rtu", "pty"),
    ("vc660", "rtu", "tcp"),
    ("df800", "rtu", "pty"),
    ("df800", "rtu", "tcp"),
    ("df800", "ascii", "pty"),
    ("df800", "ascii", "tcp"),
]


@asynccontextmanager
async def client(
    made: SimulatedBus, encoding: str = "rtu", way: str = "pty", timeout_s: float = 3.0
) -> AsyncIterator[Any]:
    """Connect pymodbus' asyncio client; over TCP with the framer of the serial line, not Modbus TCP."""
    need_module("pymodbus")
    from pymodbus import FramerType
    from pymodbus.client import AsyncModbusSerialClient, AsyncModbusTcpClient

    framer = FramerType(encoding)
    if way == "pty":
        async with serve_on_pty(made) as path:
            serial = AsyncModbusSerialClient(
                path, framer=framer, baudrate=made.settings.baud, retries=0, timeout=timeout_s, reconnect_delay=0
            )
            async with _connected(serial):
                yield serial
    else:
        async with (
            serve_on_tcp(made) as server,
            _connected(
                AsyncModbusTcpClient(
                    server.host, port=server.port, framer=framer, retries=0, timeout=timeout_s, reconnect_delay=0
                )
            ) as tcp,
        ):
            yield tcp


@asynccontextmanager
async def _connected(peer: Any) -> AsyncIterator[Any]:
    assert await peer.connect()
    try:
        yield peer
    finally:
        peer.close()


@pytest.mark.parametrize(("model", "encoding", "way"), WAYS)
async def test_pymodbus_starts_and_stops_a_drive(model: str, encoding: str, way: str) -> None:
    made = quick_bench(f"{model}@7", encoding)
    async with client(made, encoding, way) as peer:
        set_hz = await peer.write_register(SETPOINT, 2000, device_id=7)
        assert (set_hz.isError(), set_hz.address, set_hz.registers) == (False, SETPOINT, [2000])
        assert not made.station(7).running, "a set frequency alone starts nothing"
        assert not (await peer.write_register(COMMAND, START[model], device_id=7)).isError()
        await wait_until(lambda: made.station(7).motor.output_hz == pytest.approx(20.0, abs=0.004), "20 Hz")
        assert made.station(7).motor.starts == 1
        assert not (await peer.write_register(COMMAND, STOP[model], device_id=7)).isError()
        await wait_until(lambda: not made.station(7).running, "standstill")


async def test_every_parameter_that_pymodbus_reads_is_the_value_of_the_vc660s_table() -> None:
    made = quick_bench("vc660@1", line=SerialSettings(38400))
    memory = made.station(1).memory
    for place, key in enumerate(memory.ram):
        memory.ram[key] = (7919 * place + 13) & 0xFFFF
    memory.ram[6 + sum((30, 40, 60, 60, 50, 60))] = 0  # F06.06, the reply delay
    found: dict[int, int] = {}
    async with client(made) as peer:
        for first in range(0, 451, 4):
            count = min(4, 451 - first)
            answer = await peer.read_holding_registers(first, count=count, device_id=1)
            found |= dict(zip(range(first, first + count), answer.registers, strict=True))
    assert found == memory.ram


async def test_the_status_that_pymodbus_reads_of_a_running_vc660_is_that_of_its_motor() -> None:
    made = quick_bench("vc660@1")
    async with client(made) as peer:
        made.station(1).keypad_run(40.0, reverse=True)
        await wait_until(lambda: made.station(1).motor.output_hz == pytest.approx(-40.0, abs=0.004), "40 Hz backwards")
        first = (await peer.read_holding_registers(STATUS, count=4, device_id=1)).registers
        second = (await peer.read_holding_registers(STATUS + 4, count=4, device_id=1)).registers
        motor = made.station(1).motor
    assert first[0] & 0x8009 == 0x8009  # output reversed, running, ready
    assert first[2] == 4000
    assert first[3] == pytest.approx(motor.current_a * 10, abs=2)
    assert second[0] == pytest.approx(motor.voltage_v * 10, abs=10)
    assert second[1] == pytest.approx(motor.power_kw * 100, abs=3)
    assert second[2] == pytest.approx(motor.bus_v, abs=3)


@pytest.mark.parametrize("encoding", ["rtu", "ascii"])
async def test_every_value_that_pymodbus_reads_of_a_df800_is_the_value_of_its_table(encoding: str) -> None:
    made = quick_bench("df800@1", encoding)
    memory = made.station(1).memory
    async with client(made, encoding) as peer:
        for first, count in ((100, 3), (107, 2), (700, 3)):
            answer = await peer.read_holding_registers(first, count=count, device_id=1)
            assert answer.registers == [memory[key] for key in range(first, first + count)]
        written = await peer.write_register(107, 200, device_id=1)
        assert (written.address, written.registers) == (107, [200])
    assert memory.eeprom[107] == 200


async def test_pymodbus_receives_the_four_exceptions_of_a_vc660() -> None:
    made = quick_bench("vc660@1")
    async with client(made) as peer:
        made.station(1).keypad_run(10.0)
        refused = [
            await peer.read_input_registers(STATUS, count=1, device_id=1),
            await peer.read_coils(0, count=1, device_id=1),
            await peer.write_registers(SETPOINT, [1, 2], device_id=1),
            await peer.read_holding_registers(0x200B, count=1, device_id=1),
            await peer.read_holding_registers(STATUS, count=5, device_id=1),
            await peer.write_register(SETPOINT, 40001, device_id=1),
            await peer.write_register(0, 100, device_id=1),
        ]
    assert all(answer.isError() for answer in refused)
    assert [answer.exception_code for answer in refused] == [1, 1, 1, 2, 3, 3, 4]
    assert [answer.function_code & 0x7F for answer in refused] == [4, 1, 16, 3, 3, 6, 6]


async def test_a_vc660_returns_the_word_of_pymodbus_loop_back_test() -> None:
    async with client(quick_bench("vc660@1")) as peer:
        for word in (b"\x00\x00", b"\xa5\x5a", b"\xff\xff"):
            assert (await peer.diag_query_data(word, device_id=1)).message == word


@pytest.mark.parametrize("encoding", ["rtu", "ascii"])
async def test_pymodbus_decodes_the_df800s_short_error_as_a_reply_without_registers(encoding: str) -> None:
    """T15: the short error is no Modbus exception, so pymodbus reports success without values."""
    async with client(quick_bench("df800@1", encoding), encoding) as peer:
        refused = await peer.read_holding_registers(100, count=5, device_id=1)
        assert not refused.isError() and refused.registers == []
        again = await peer.read_holding_registers(100, count=1, device_id=1)
        assert again.registers == [5000], "and the line is in order afterwards"


async def test_pymodbus_gets_no_reply_from_an_unused_address() -> None:
    need_module("pymodbus")
    from pymodbus.exceptions import ModbusIOException

    async with client(quick_bench("vc660@1,3"), timeout_s=0.2) as peer:
        with pytest.raises(ModbusIOException):
            await peer.read_holding_registers(STATUS, count=1, device_id=2)
        assert (await peer.read_holding_registers(STATUS, count=1, device_id=3)).registers == [1]


async def test_a_broadcast_stop_of_pymodbus_stops_every_vc660_and_none_answers() -> None:
    made = quick_bench("vc660@1-3")
    async with client(made) as peer:
        for station in made.stations:
            station.keypad_run(10.0)
        await peer.write_register(COMMAND, STOP["vc660"], device_id=0, no_response_expected=True)
        await wait_until(lambda: not any(made.station(address).running for address in (1, 2, 3)), "three standstills")
        assert [station.reply_count for station in made.stations] == [0, 0, 0]
        assert (await peer.read_holding_registers(STATUS, count=1, device_id=2)).registers == [1]


@pytest.mark.parametrize("encoding", ["rtu", "ascii"])
async def test_pymodbus_synchronous_client_reads_and_runs_a_df800(encoding: str) -> None:
    need_module("pymodbus")
    made = quick_bench("df800@1", encoding)
    async with serve_on_pty(made) as path:
        assert await asyncio.to_thread(run_with_the_synchronous_client, path, encoding) == [5000, 5, 2]
        await wait_until(lambda: made.station(1).motor.output_hz == pytest.approx(15.0, abs=0.004), "15 Hz")


def run_with_the_synchronous_client(path: str, encoding: str) -> list[int]:
    from pymodbus import FramerType
    from pymodbus.client import ModbusSerialClient

    peer = ModbusSerialClient(path, framer=FramerType(encoding), baudrate=19200, retries=0)
    assert peer.connect()
    try:
        found = peer.read_holding_registers(100, count=3, device_id=1).registers
        for register, word in ((SETPOINT, 1500), (COMMAND, START["df800"])):
            assert not peer.write_register(register, word, device_id=1).isError()
        return list(found)
    finally:
        peer.close()
