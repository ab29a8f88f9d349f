"""The simulated DF800 replies, rejects and moves as described in the supplement of its manual, in both variants."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from drivebus.protocols import modbus
from drivebus.simulator.motor import Trip
from fixtures.drives import run_virtual
from fixtures.simulator import SimulatorClient

ASCII = modbus.ModbusAsciiCodec("short")


def write(register: int, value: int) -> modbus.WriteRegister:
    return modbus.WriteRegister(1, register, value)


async def running(client: SimulatorClient, word: int = 0b10) -> None:
    await client.request(write(0x2001, 3000))
    await client.request(write(0x2000, word))
    await asyncio.sleep(12.0)


@pytest.mark.parametrize(
    "frame",
    [
        "3A 30 31 30 36 32 30 30 31 31 33 38 38 33 44 0D 0A",
        "3A 30 31 30 36 32 30 30 30 30 30 30 32 44 37 0D 0A",
        "3A 30 31 30 36 32 30 30 30 30 30 30 31 44 38 0D 0A",
        "3A 30 31 30 36 30 30 36 35 30 30 30 33 39 31 0D 0A",
        "3A 30 31 30 36 30 30 36 35 30 30 30 35 38 46 0D 0A",
    ],
)
def test_the_worked_ascii_frames_come_back_as_printed(frame: str) -> None:
    async def scenario() -> bytes:
        async with SimulatorClient("sim://df800@1?encoding=ascii") as client:
            return await client.raw(bytes.fromhex(frame))

    assert run_virtual(scenario()) == bytes.fromhex(frame)


@pytest.mark.parametrize("encoding", ["rtu", "ascii"])
def test_a_simulated_df800_runs_up_to_its_frequency_and_ramps_down_at_a_stop(encoding: str) -> None:
    async def scenario() -> None:
        codec = ASCII if encoding == "ascii" else None
        async with SimulatorClient(f"sim://df800@1?encoding={encoding}", codec) as client:
            await running(client)
            assert client.station().motor.output_hz == pytest.approx(30.0)
            assert (await client.request(modbus.ReadRegisters(1, 5, 1))).values[0] in range(850, 900)
            await client.request(write(0x2000, 0b01))
            await asyncio.sleep(11.0)
            assert not client.station().running

    run_virtual(scenario())


@pytest.mark.parametrize(
    ("request_", "rtu", "ascii_"),
    [
        (modbus.ReadRegisters(1, 900, 1), "01 03 00 20 F0", b":010300FC\r\n"),
        (modbus.WriteRegister(1, 900, 1), "01 06 00 23 A0", b":010600F9\r\n"),
        (modbus.ReadRegisters(1, 100, 5), "01 03 00 20 F0", b":010300FC\r\n"),
        (modbus.ReadRegisters(1, 0x2000, 1), "01 03 00 20 F0", b":010300FC\r\n"),
        (modbus.WriteRegister(1, 3, 1), "01 06 00 23 A0", b":010600F9\r\n"),
        (modbus.WriteRegister(1, 0x2001, 40001), "01 06 00 23 A0", b":010600F9\r\n"),
    ],
)
def test_its_error_reply_has_the_unchanged_function_and_one_byte_00(request_: Any, rtu: str, ascii_: bytes) -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://df800@1") as client:
            assert await client.raw(client.codec.encode_request(request_)) == bytes.fromhex(rtu)
        async with SimulatorClient("sim://df800@1?encoding=ascii", ASCII) as client:
            assert await client.raw(ASCII.encode_request(request_)) == ascii_

    run_virtual(scenario())


def test_a_locked_parameter_is_rejected_in_the_same_form() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://df800@1") as client:
            client.station().memory.locked = True
            assert (await client.request(write(107, 50))).code is None
            client.station().memory.locked = False
            await running(client)
            assert (await client.request(write(101, 0))).code is None
            assert isinstance(await client.request(write(107, 50)), modbus.WriteAck)

    run_virtual(scenario())


def test_an_unknown_function_is_rejected_in_the_same_form() -> None:
    async def scenario() -> bytes:
        async with SimulatorClient("sim://df800@1") as client:
            return await client.raw(modbus.ModbusRtuCodec().encode_request(modbus.ReadRegisters(1, 0, 1, function=4)))

    assert run_virtual(scenario())[:3] == bytes.fromhex("01 04 00")


@pytest.mark.parametrize(
    ("variant", "field", "sign"), [("b3b2", 0b01, -1), ("b3b2", 0b10, 1), ("b2b3", 0b01, 1), ("b2b3", 0b10, -1)]
)
def test_the_direction_field_turns_the_motor_as_the_option_defines(variant: str, field: int, sign: int) -> None:
    async def scenario() -> float:
        async with SimulatorClient(f"sim://df800@1?direction_field={variant}") as client:
            await running(client, field << 2 | 0b10)
            return float(client.station().motor.output_hz)

    assert run_virtual(scenario()) == pytest.approx(sign * 30.0)


def test_a_start_without_direction_keeps_the_last_direction() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://df800@1?ramp=1") as client:
            await running(client, 0b0110)
            await client.request(write(0x2000, 0b01))
            await asyncio.sleep(2.0)
            await running(client, 0b10)
            assert client.station().motor.output_hz == pytest.approx(-30.0)

    run_virtual(scenario())


def test_a_toggle_is_executed_each_time_that_it_is_sent() -> None:
    async def scenario() -> list[float]:
        async with SimulatorClient("sim://df800@1?ramp=1") as client:
            await running(client)
            output_hz = []
            for _ in range(3):
                await client.request(write(0x2000, 0b1100))
                await asyncio.sleep(3.0)
                output_hz.append(round(client.station().motor.output_hz, 6))
            return output_hz

    assert run_virtual(scenario()) == [-30.0, 30.0, -30.0]


def test_t16_11b_in_the_run_field_jogs() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://df800@1?ramp=1") as client:
            await client.request(write(0x2000, 0b11))
            await asyncio.sleep(2.0)
            assert client.station().motor.output_hz == pytest.approx(5.0)

    run_virtual(scenario())


def test_deltas_12h_starts_and_resets_on_this_drive() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://df800@1?ramp=1") as client:
            await client.request(write(0x2001, 1000))
            await client.request(write(0x2000, 0x12))
            await asyncio.sleep(2.0)
            assert client.station().motor.output_hz == pytest.approx(10.0)

    run_virtual(scenario())


@pytest.mark.parametrize(("register", "value", "hz"), [(102, 0, 0.0), (101, 0, 12.0)])
def test_f1_01_and_f1_02_enable_commands_and_setpoints_of_the_bus(register: int, value: int, hz: float) -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://df800@1") as client:
            client.station().keypad_set(100, 1200)
            client.station().keypad_set(register, value)
            reply = await client.request(write(0x2000, 0b10))
            assert isinstance(reply, modbus.WriteAck)  # acknowledged all the same
            await running(client)
            assert client.station().motor.output_hz == pytest.approx(hz)

    run_virtual(scenario())


def test_only_the_monitors_distinguish_running_from_stopped() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://df800@1") as client:
            for register in (0x2000, 0x2100, 0x2101, 0x3000):
                assert (await client.request(modbus.ReadRegisters(1, register, 1))).code is None

    run_virtual(scenario())


def test_a_broadcast_is_ignored_by_default() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://df800@1") as client:
            await running(client)
            await client.raw(modbus.ModbusRtuCodec().encode_request(modbus.WriteRegister(0, 0x2000, 1)))
            await asyncio.sleep(1.0)
            assert not client.station().motor.stopping

    run_virtual(scenario())


def test_every_write_is_saved() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://df800@1") as client:
            await client.request(write(107, 200))
            assert client.station().memory.eeprom_writes[107] == 1
            assert (await client.request(modbus.ReadRegisters(1, 107, 2))).values == (200, 100)

    run_virtual(scenario())


def test_an_ascii_frame_begins_again_at_every_colon() -> None:
    async def scenario() -> bytes:
        async with SimulatorClient("sim://df800@1?encoding=ascii", ASCII) as client:
            good = ASCII.encode_request(modbus.ReadRegisters(1, 100, 1))
            return await client.raw(b"\x00" + good[:5] + good)

    assert run_virtual(scenario()) == b":0103021388" + b"5F\r\n"


def test_lower_case_digits_and_a_bad_lrc_get_no_reply() -> None:
    async def scenario() -> list[bytes]:
        async with SimulatorClient("sim://df800@1?encoding=ascii", ASCII) as client:
            good = ASCII.encode_request(modbus.ReadRegisters(1, 107, 1))
            return [await client.raw(good.lower()), await client.raw(good[:-4] + b"00\r\n")]

    assert run_virtual(scenario()) == [b"", b""]


def test_bit_4_resets_a_fault_and_a_fault_stops_the_motor() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://df800@1?ramp=1") as client:
            await running(client)
            client.station().trip(Trip.OVERLOAD)
            await running(client)
            assert not client.station().running
            await client.request(write(0x2000, 0x10))
            await running(client)
            assert client.station().running

    run_virtual(scenario())


def test_a_power_cycle_clears_the_frequency_of_the_bus() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://df800@1") as client:
            await running(client)
            client.station().power_cycle()
            await asyncio.sleep(3.0)
            await client.request(write(0x2000, 0b10))
            await asyncio.sleep(5.0)
            assert client.station().motor.output_hz == 0.0

    run_virtual(scenario())
