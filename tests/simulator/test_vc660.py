"""The simulated VC660 replies, rejects and moves as described in its guide."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from drivebus.protocols import modbus
from drivebus.protocols.checksum import crc16
from drivebus.simulator.models.vc660 import (
    COMMAND_SOURCE,
    FIRST_OUTPUT,
    FREQUENCY_SOURCE,
    KEYPAD_HZ,
    REPLY_DELAY,
    VIRTUAL_INPUTS,
    parameter_index,
)
from drivebus.simulator.motor import Trip
from fixtures.drives import run_virtual
from fixtures.simulator import SimulatorClient


def rtu(text: str) -> bytes:
    body = bytes.fromhex(text)
    return body + crc16(body).to_bytes(2, "little")


def read(register: int, count: int = 1, address: int = 1) -> modbus.ReadRegisters:
    return modbus.ReadRegisters(address, register, count)


def write(register: int, value: int, address: int = 1) -> modbus.WriteRegister:
    return modbus.WriteRegister(address, register, value)


async def running(client: SimulatorClient, hz: float = 30.0, word: int = 1) -> None:
    await client.request(write(0x2001, round(hz * 100)))
    await client.request(write(0x2000, word))
    await asyncio.sleep(12.0)


async def output_hz(client: SimulatorClient) -> float:
    return float(client.station().motor.output_hz)


@pytest.mark.parametrize(
    ("sent", "expected"),
    [
        ("01 08 00 00 5A A5 1A D0", "01 08 00 00 5A A5 1A D0"),
        ("01 06 00 02 0B B8 2F 48", "01 06 00 02 0B B8 2F 48"),
        ("01 06 20 00 00 01 43 CA", "01 06 20 00 00 01 43 CA"),
        ("01 06 20 00 00 02 03 CB", "01 06 20 00 00 02 03 CB"),
    ],
)
def test_the_worked_frames_of_section_6_are_answered_as_printed(sent: str, expected: str) -> None:
    async def scenario() -> bytes:
        async with SimulatorClient("sim://vc660@1") as client:
            return await client.raw(bytes.fromhex(sent))

    assert run_virtual(scenario()) == bytes.fromhex(expected)


def test_example_4_a_broadcast_write_is_executed_without_reply() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1,2") as client:
            assert await client.raw(rtu("00 06 00 02 0F A0")) == b""
            assert (await client.request(read(2))).values == (4000,)
            assert (await client.request(read(2, address=2))).values == (4000,)

    run_virtual(scenario())


def test_a_drive_with_factory_settings_executes_broadcasts_and_sends_no_reply() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@0") as client:
            assert await client.raw(rtu("00 03 30 00 00 01")) == b""
            assert await client.raw(rtu("00 06 20 01 03 E8")) == b""
            await client.raw(rtu("00 06 20 00 00 01"))
            await asyncio.sleep(5.0)
            assert client.station(0).motor.output_hz == pytest.approx(10.0)

    run_virtual(scenario())


@pytest.mark.parametrize(
    ("sent", "function", "code"),
    [
        ("01 04 30 00 00 01", 4, 1),
        ("01 10 20 00 00 01 02 00 01", 16, 1),
        ("01 05 00 00 FF 00", 5, 1),
        ("01 16 00 00 00 00 00 00", 0x16, 1),
        ("01 08 00 01 00 00", 8, 1),
        ("01 03 20 00 00 01", 3, 2),
        ("01 03 20 0B 00 03", 3, 2),
        ("01 06 20 0B 00 01", 6, 2),
        ("01 03 30 19 00 01", 3, 2),
        ("01 03 01 C3 00 01", 3, 2),
        ("01 06 30 00 00 01", 6, 2),
        ("01 06 20 0A 00 01", 6, 2),
        ("01 03 30 00 00 05", 3, 3),
        ("01 03 30 00 00 00", 3, 3),
        ("01 06 20 01 9C 41", 6, 3),
        ("01 06 20 08 40 00", 6, 3),
    ],
)
def test_a_rejected_request_is_answered_with_an_exception(sent: str, function: int, code: int) -> None:
    async def scenario() -> bytes:
        async with SimulatorClient("sim://vc660@1") as client:
            return await client.raw(rtu(sent))

    assert run_virtual(scenario()) == rtu(f"01 {function | 0x80:02X} {code:02X}")


def test_the_200bh_of_the_examples_starts_nothing() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1") as client:
            await client.raw(rtu("01 06 20 0B 00 01"))
            assert client.station().motor.starts == 0

    run_virtual(scenario())


def test_a_parameter_locked_while_running_is_exception_4() -> None:
    async def scenario() -> Any:
        async with SimulatorClient("sim://vc660@1") as client:
            await running(client)
            return await client.request(write(COMMAND_SOURCE, 0))

    assert run_virtual(scenario()).code == 4


def test_a_bad_crc_gets_no_reply() -> None:
    async def scenario() -> bytes:
        async with SimulatorClient("sim://vc660@1") as client:
            return await client.raw(bytes.fromhex("01 03 30 00 00 01 00 00"))

    assert run_virtual(scenario()) == b""


def test_trailing_bytes_without_silence_invalidate_the_frame() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1") as client:
            assert await client.raw(rtu("01 06 20 00 00 01") + b"\x00") == b""
            assert client.station().motor.starts == 0

    run_virtual(scenario())


def test_a_frame_in_two_pieces_without_much_pause_is_one_frame() -> None:
    async def scenario(pause: float) -> bytes:
        async with SimulatorClient("sim://vc660@1") as client:
            frame = rtu("01 03 30 00 00 01")
            client.port.write(frame[:3])
            await asyncio.sleep(client.simulated_bus.settings.seconds(3 + pause))
            return await client.raw(frame[3:])

    assert len(run_virtual(scenario(2.0))) == 7
    assert run_virtual(scenario(4.0)) == b""


def test_a_request_too_soon_after_other_traffic_is_counted_and_answered() -> None:
    async def scenario(characters: float) -> tuple[int, bool]:
        async with SimulatorClient("sim://vc660@1,2") as client:
            frame = rtu("01 03 30 00 00 01")
            line = client.simulated_bus.settings
            client.port.write(client.codec.encode_request(read(0x3000, address=2)))
            await asyncio.sleep(line.seconds(8 + 7 + characters) + 0.004)  # request, F06.06, reply
            assert len(client.received) == 1
            data = await client.raw(frame)
            assert client.station().shortest_gap_s == pytest.approx(line.seconds(characters), abs=1e-6)
            return client.station().gap_violations, bool(data)

    assert run_virtual(scenario(2.0)) == (1, True)
    assert run_virtual(scenario(3.5)) == (0, True)


@pytest.mark.parametrize(("delay_ms", "expected"), [(4, 0.004), (0, 3.5 * 10 / 9600), (250, 0.25)])
def test_f06_06_delays_the_reply_but_never_below_the_gap(delay_ms: int, expected: float) -> None:
    async def scenario() -> float:
        async with SimulatorClient("sim://vc660@1?line_quality=bytes") as client:
            await client.request(write(REPLY_DELAY, delay_ms))
            sent = asyncio.get_running_loop().time()
            await client.request(read(0x3000))
            return client.received[0][0] - sent - 9 * client.simulated_bus.settings.character_s

    assert run_virtual(scenario()) == pytest.approx(expected)


def test_it_runs_at_the_frequency_of_2001h() -> None:
    async def scenario() -> Any:
        async with SimulatorClient("sim://vc660@1") as client:
            await running(client)
            return await client.request(read(0x3000, 4))

    status, set_hz, out_hz, current = run_virtual(scenario()).values
    assert status == 0b1001
    assert (set_hz, out_hz) == (3000, 3000)
    assert 20 <= current <= 30


def test_pulse_bits_that_need_an_edge_act_once_until_they_return_to_0() -> None:
    async def scenario(pulses: str) -> list[bool]:
        async with SimulatorClient(f"sim://vc660@1?pulses={pulses}&ramp=1") as client:
            states = []
            await client.request(write(0x2001, 1000))
            for word in (0x0001, 0x0002, 0x0001, 0x0002, 0x0002, 0x0000, 0x0002):
                await client.request(write(0x2000, word), 2.0)
                states.append(client.station().running)
            client.station().keypad_run(10.0)
            await client.request(write(0x2000, 0x0002), 2.0)
            states.append(client.station().running)
            return states

    assert run_virtual(scenario("edge"))[-1] is True  # 0002H was there already: no edge
    assert run_virtual(scenario("write"))[-1] is False
    assert run_virtual(scenario("edge"))[:4] == run_virtual(scenario("write"))[:4] == [True, False, True, False]


def test_every_write_sets_all_levels_so_a_plain_stop_also_sets_forward() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1?ramp=1") as client:
            await client.request(write(0x2001, 3000))
            await client.request(write(0x2000, 0x0005))
            await asyncio.sleep(3.0)
            assert await output_hz(client) == pytest.approx(-30.0)
            await client.request(write(0x2000, 0x0000))  # no pulse, but direction forward
            await asyncio.sleep(3.0)
            assert await output_hz(client) == pytest.approx(30.0)

    run_virtual(scenario())


def test_stop_overrides_start_in_one_word() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1") as client:
            await client.request(write(0x2000, 0x0003))
            await asyncio.sleep(1.0)
            assert client.station().motor.starts == 0

    run_virtual(scenario())


@pytest.mark.parametrize(("bit", "sign"), [(3, 1), (4, -1)])
def test_a_jog_bit_jogs_while_it_is_set(bit: int, sign: int) -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1?ramp=1") as client:
            await client.request(write(0x2000, 1 << bit))
            await asyncio.sleep(2.0)
            assert await output_hz(client) == pytest.approx(sign * 5.0)
            assert (await client.request(read(0x3000))).values[0] & 0x0108 == 0x0108
            await client.request(write(0x2000, 0))
            await asyncio.sleep(2.0)
            assert not client.station().running

    run_virtual(scenario())


def test_a_run_at_the_keypad_after_a_jog_is_a_run_and_takes_a_new_frequency() -> None:
    async def scenario() -> tuple[int, float]:
        async with SimulatorClient("sim://vc660@1?ramp=1") as client:
            await client.request(write(0x2000, 0x0008))
            await client.request(write(0x2000, 0x0000), 2.0)
            client.station().keypad_run(10.0)
            await client.request(write(0x2001, 2000), 2.0)
            return (await client.request(read(0x3000, 1))).values[0], client.station().motor.target_hz

    status, target_hz = run_virtual(scenario())
    assert status & 1 << 8 == 0 and target_hz == 20.0


def test_a_jog_has_no_dead_man_timeout() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1") as client:
            await client.request(write(0x2000, 1 << 3))
            await asyncio.sleep(3600.0)
            assert client.station().running

    run_virtual(scenario())


def test_coast_switches_off_at_once() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1") as client:
            await running(client)
            await client.request(write(0x2000, 1 << 5), 0.05)
            assert not client.station().running
            assert client.station().motor.speed_hz > 10.0

    run_virtual(scenario())


def test_an_emergency_stop_ramps_down_within_a_second_and_shows_bit_4() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1") as client:
            client.station().motor.brake_resistor_w = 5000.0
            await running(client)
            await client.request(write(0x2000, 1 << 6), 0.1)
            assert (await client.request(read(0x3000), 0.1)).values[0] & 0x0010
            await asyncio.sleep(1.5)
            assert (await client.request(read(0x3000))).values[0] & 0x0018 == 0

    run_virtual(scenario())


def test_pause_holds_the_drive_at_0_hz_and_release_goes_on() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1?ramp=1") as client:
            await running(client)
            await client.request(write(0x2000, 1 << 7))
            await asyncio.sleep(2.0)
            assert await output_hz(client) == 0.0
            assert (await client.request(read(0x3000))).values[0] & 0x0028 == 0x0028
            await client.request(write(0x2000, 0))
            await asyncio.sleep(2.0)
            assert await output_hz(client) == pytest.approx(30.0)

    run_virtual(scenario())


def test_a_ramp_hold_keeps_the_output_frequency_of_a_simulated_vc660() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1") as client:
            await client.request(write(0x2001, 3000), 0.0)
            await asyncio.sleep(0.1)
            await client.request(write(0x2000, 1))
            await asyncio.sleep(2.0)
            await client.request(write(0x2000, 1 << 8))
            held_hz = await output_hz(client)
            await asyncio.sleep(5.0)
            assert 10.0 < held_hz == await output_hz(client) < 20.0

    run_virtual(scenario())


def test_a_fault_shows_in_the_status_and_the_fault_words_and_is_reset() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1") as client:
            client.station().trip(Trip.UNDERVOLTAGE)
            assert (await client.request(read(0x3000))).values[0] & 0b11 == 0b10
            assert (await client.request(read(0x3016, 2))).values == (1, 0)
            await client.request(write(0x2000, 1 << 9))
            assert (await client.request(read(0x3000))).values[0] & 0b11 == 0b01

    run_virtual(scenario())


def test_only_the_address_with_8000h_reaches_the_eeprom() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1") as client:
            await client.request(write(KEYPAD_HZ, 3000))
            await client.request(write(3 | 0x8000, 777))
            memory = client.station().memory
            assert dict(memory.eeprom_writes) == {3: 1}
            client.station().power_cycle()
            await asyncio.sleep(3.0)
            assert (await client.request(read(2, 2))).values == (5000, 777)

    run_virtual(scenario())


def test_commands_are_ignored_unless_f01_00_is_2() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1") as client:
            client.station().keypad_set(COMMAND_SOURCE, 0)
            reply = await client.request(write(0x2000, 1))
            assert isinstance(reply, modbus.WriteAck)
            await asyncio.sleep(1.0)
            assert not client.station().running

    run_virtual(scenario())


def test_2001h_is_ignored_unless_f00_01_is_4() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1") as client:
            client.station().keypad_set(FREQUENCY_SOURCE, 0)
            client.station().keypad_set(KEYPAD_HZ, 1200)
            await running(client)
            assert await output_hz(client) == pytest.approx(12.0)

    run_virtual(scenario())


def test_virtual_inputs_and_outputs_are_set_and_cleared_by_ones_where_the_keypad_allows_it() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1") as client:
            await client.request(write(0x2002, 0b0110))
            await client.request(write(0x2006, 0b101))
            assert (await client.request(read(0x3007, 2))).values == (0, 0)
            client.station().keypad_set(VIRTUAL_INPUTS, 1)
            for n in range(3):
                client.station().keypad_set(FIRST_OUTPUT + n, 28 + n)
            await client.request(write(0x2002, 0b0110))
            await client.request(write(0x2003, 0b0010))
            await client.request(write(0x2006, 0b101))
            await client.request(write(0x2007, 0b001))
            assert (await client.request(read(0x3007, 2))).values == (0b0100, 0b100)

    run_virtual(scenario())


def test_parameters_end_at_01c2h() -> None:
    async def scenario() -> Any:
        async with SimulatorClient("sim://vc660@1") as client:
            return await client.request(read(0x01C2))

    assert isinstance(run_virtual(scenario()), modbus.RegisterValues)
    assert parameter_index(9, 40) == 0x01C2


def test_a_new_frequency_changes_a_running_drive_and_does_not_start_a_stopped_drive() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1?ramp=1") as client:
            await client.request(write(0x2001, 1000))
            assert client.station().motor.starts == 0
            await running(client)
            await client.request(write(0x2001, 4000))
            await asyncio.sleep(2.0)
            assert await output_hz(client) == pytest.approx(40.0)

    run_virtual(scenario())


def test_analog_outputs_take_up_to_3fffh() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1") as client:
            assert isinstance(await client.request(write(0x2009, 0x3FFF)), modbus.WriteAck)
            assert client.station().analog == [0, 0x3FFF]

    run_virtual(scenario())
