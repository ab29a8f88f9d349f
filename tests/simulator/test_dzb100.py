"""The simulated DZB100 replies, rejects and moves as described in its manual, in every variant that it leaves open."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from drivebus.protocols import dzb100
from drivebus.protocols.dzb100 import Dzb100Command
from drivebus.simulator.models.dzb100 import decode_steps, encode_steps
from drivebus.simulator.motor import Trip
from fixtures.drives import run_virtual
from fixtures.simulator import SimulatorClient


def frame_bytes(frame: str) -> bytes:
    return bytes.fromhex(frame)


@pytest.mark.parametrize(
    ("coding", "word", "hz"),
    [("hex-0.1", 0x007B, 12.3), ("hex-0.01", 0x04CE, 12.3), ("decimal-0.1", 0x0123, 12.3), ("hex-1", 0x000C, 12.0)],
)
def test_each_setpoint_coding_runs_at_its_own_frequency(coding: str, word: int, hz: float) -> None:
    async def scenario() -> float:
        async with SimulatorClient(f"sim://dzb100@1?setpoint_coding={coding}&ramp=1") as client:
            await client.request(dzb100.Dzb100Control(1, Dzb100Command.FORWARD, word))
            await asyncio.sleep(5.0)
            return float(client.station().motor.output_hz)

    assert run_virtual(scenario()) == pytest.approx(hz)


@pytest.mark.parametrize(
    ("coding", "word"), [("hex-0.1", 0x007B), ("hex-0.01", 0x04CE), ("decimal-0.1", 0x0123), ("hex-1", 0x000C)]
)
def test_keypad_frequency_12_3_hz_reads_differently_in_each_query_coding(coding: str, word: int) -> None:
    async def scenario() -> Any:
        async with SimulatorClient(f"sim://dzb100@1?query_coding={coding}") as client:
            client.station().setpoint_hz = 12.3
            return await client.request(dzb100.Dzb100Query(1, 0))

    assert run_virtual(scenario()).data == word


def test_hex_01_sent_to_a_hex_1_drive_runs_ten_times_too_fast() -> None:
    async def scenario() -> float:
        async with SimulatorClient("sim://dzb100@1?setpoint_coding=hex-1&ramp=1") as client:
            await client.request(dzb100.Dzb100Control(1, Dzb100Command.FORWARD, 50))  # meant as 5.0 Hz
            await asyncio.sleep(5.0)
            return float(client.station().motor.output_hz)

    assert run_virtual(scenario()) == pytest.approx(50.0)


def test_a_word_that_is_no_decimal_number_is_rejected_as_a_frequency() -> None:
    async def scenario() -> float:
        async with SimulatorClient("sim://dzb100@1?setpoint_coding=decimal-0.1&ramp=1") as client:
            await client.request(dzb100.Dzb100Control(1, Dzb100Command.FORWARD, 0x00FF))
            await asyncio.sleep(5.0)
            return float(client.station().motor.output_hz)

    assert run_virtual(scenario()) == 0.0


@pytest.mark.parametrize("number", [0, 1, 123, 4000, 9999])
def test_encoding_and_decoding_a_word_are_inverse(number: int) -> None:
    for coding in ("hex-0.1", "hex-0.01", "decimal-0.1", "hex-1"):
        assert decode_steps(encode_steps(number, coding), coding) == number  # type: ignore[arg-type]


def test_an_eleven_byte_p_read_of_the_text_writes_0() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://dzb100@3") as client:
            client.station(3).keypad_set(23, 100)
            await client.raw(frame_bytes("50 03 01 30 33 32 33 30 30 30 30"))
            assert client.station(3).memory[23] == 0
            assert client.station(3).memory.eeprom_writes[23] == 2

    run_virtual(scenario())


def test_r_reads_a_parameter_and_changes_nothing() -> None:
    async def scenario() -> Any:
        async with SimulatorClient("sim://dzb100@3") as client:
            client.station(3).keypad_set(23, 100)
            reply = await client.raw(frame_bytes("52 03 01 30 33 32 33 30 30 30 30"))
            assert reply == frame_bytes("52 03 06 30 33 32 33 30 30 36 34")
            assert client.station(3).memory[23] == 100

    run_virtual(scenario())


def test_a_written_parameter_is_saved_there_is_no_ram() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://dzb100@2") as client:
            reply = await client.raw(frame_bytes("50 03 01 30 32 31 30 30 30 39 36"))
            assert reply == frame_bytes("50 03 06 30 32 31 30 30 30 39 36")
            client.station(2).power_cycle()
            await asyncio.sleep(3.0)
            assert (await client.request(dzb100.Dzb100ReadParameter(2, 10))).data == 150
            assert client.station(2).memory.eeprom_writes[10] == 1

    run_virtual(scenario())


def test_a_rejected_request_is_answered_with_07() -> None:
    async def scenario() -> list[bool]:
        async with SimulatorClient("sim://dzb100@1") as client:
            codec = client.codec
            replies = [
                await client.raw(frame_bytes("51 03 01 30 31 30 37 30 30 30 30")),
                await client.raw(codec.encode_request(dzb100.Dzb100WriteParameter(1, 78, 40))),
            ]
            client.station().memory.locked = True
            replies.append(await client.raw(codec.encode_request(dzb100.Dzb100WriteParameter(1, 10, 50))))
            return [reply[2:3] == b"\x07" for reply in replies]

    assert run_virtual(scenario()) == [True, True, True]


def test_the_source_parameters_are_locked_while_running() -> None:
    async def scenario() -> Any:
        async with SimulatorClient("sim://dzb100@1") as client:
            await client.request(dzb100.Dzb100Control(1, Dzb100Command.FORWARD, 300))
            return await client.request(dzb100.Dzb100WriteParameter(1, 1, 1))

    assert run_virtual(scenario()).accepted is False


def test_a_drive_at_address_0_executes_broadcasts_and_sends_no_reply() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://dzb100@0") as client:
            assert await client.raw(frame_bytes("51 03 01 30 30 30 33 30 30 30 30")) == b""
            assert await client.raw(frame_bytes("43 03 02 30 30 30 31 30 30 36 34")) == b""
            await asyncio.sleep(5.0)
            assert client.station(0).motor.output_hz == pytest.approx(10.0)

    run_virtual(scenario())


def test_all_drives_execute_a_control_frame_with_a_02_whatever_its_address() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://dzb100@1-3") as client:
            for address in (1, 2, 3):
                await client.request(dzb100.Dzb100Control(address, Dzb100Command.FORWARD, 300))
            await asyncio.sleep(8.0)
            assert await client.raw(frame_bytes("43 03 02 30 32 30 30 30 30 30 30")) == b""
            await asyncio.sleep(11.0)
            assert [client.station(address).running for address in (1, 2, 3)] == [False] * 3

    run_virtual(scenario())


@pytest.mark.parametrize("head", ["50", "52", "51"])
def test_a_02_is_for_control_frames_only(head: str) -> None:
    async def scenario() -> bytes:
        async with SimulatorClient("sim://dzb100@1") as client:
            return await client.raw(frame_bytes(f"{head} 03 02 30 31 31 30 30 30 36 34"))

    assert run_virtual(scenario()) == b""


def test_a_stop_with_one_flipped_bit_runs_at_the_frequency_in_its_data() -> None:
    async def scenario(data: str) -> float:
        async with SimulatorClient("sim://dzb100@1?ramp=1") as client:
            await client.raw(frame_bytes(f"43 03 01 30 31 30 31 {data}"))  # 30H with bit 0 flipped
            await asyncio.sleep(5.0)
            return float(client.station().motor.output_hz)

    assert run_virtual(scenario("30 30 30 30")) == 0.0
    assert run_virtual(scenario("30 31 46 34")) == pytest.approx(50.0)


def test_b_is_06_or_the_state_digit_and_proves_nothing() -> None:
    async def scenario(b_digit: str) -> Any:
        async with SimulatorClient(f"sim://dzb100@1?b_digit={b_digit}") as client:
            client.station().trip(Trip.EXTERNAL)
            reply = await client.request(dzb100.Dzb100Control(1, Dzb100Command.FORWARD, 300))
            assert not client.station().running
            return reply

    assert run_virtual(scenario("06")).accepted is True
    assert (run_virtual(scenario("state")).accepted, run_virtual(scenario("state")).digit) == (None, 1)


@pytest.mark.parametrize(("command", "sign"), [(1, 1), (3, -1), (4, 1), (5, 1), (6, -1), (7, -1)])
def test_run_and_jog_commands_turn_the_motor_in_their_direction(command: int, sign: int) -> None:
    async def scenario() -> float:
        async with SimulatorClient("sim://dzb100@1?ramp=1") as client:
            await client.request(dzb100.Dzb100Control(1, Dzb100Command(command), 100))
            await asyncio.sleep(3.0)
            return float(client.station().motor.output_hz)

    assert run_virtual(scenario()) == pytest.approx(sign * (10.0 if command < 4 else 5.0))


@pytest.mark.parametrize("command", [0, 2])
def test_0_and_2_both_stop(command: int) -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://dzb100@1?ramp=1") as client:
            await client.request(dzb100.Dzb100Control(1, Dzb100Command.FORWARD, 100))
            await asyncio.sleep(3.0)
            await client.request(dzb100.Dzb100Control(1, Dzb100Command(command)))
            await asyncio.sleep(3.0)
            assert not client.station().running

    run_virtual(scenario())


def test_q03_holds_the_last_command_and_the_fault() -> None:
    async def scenario(coding: str) -> int:
        async with SimulatorClient(f"sim://dzb100@1?fault_coding={coding}") as client:
            await client.request(dzb100.Dzb100Control(1, Dzb100Command.FORWARD, 300))
            client.station().trip(Trip.UNDERVOLTAGE)
            return int((await client.request(dzb100.Dzb100Query(1, 3))).data)

    assert run_virtual(scenario("decimal")) == 0x1014
    assert run_virtual(scenario("hex")) == 0x100E


def test_a_reset_clears_the_fault() -> None:
    async def scenario() -> int:
        async with SimulatorClient("sim://dzb100@1") as client:
            client.station().trip(Trip.OVERLOAD)
            await client.request(dzb100.Dzb100Control(1, Dzb100Command.RESET))
            return int((await client.request(dzb100.Dzb100Query(1, 3))).data)

    assert run_virtual(scenario()) == 0x8000


def test_q01_and_q02_follow_the_motor() -> None:
    async def scenario() -> tuple[int, int]:
        async with SimulatorClient("sim://dzb100@1?ramp=1") as client:
            await client.request(dzb100.Dzb100Control(1, Dzb100Command.FORWARD, 300))
            await asyncio.sleep(3.0)
            return (await client.request(dzb100.Dzb100Query(1, 1))).data, (
                await client.request(dzb100.Dzb100Query(1, 2))
            ).data

    frequency, current = run_virtual(scenario())
    assert frequency == 300
    assert 20 <= current <= 30


@pytest.mark.parametrize(("parameter", "value"), [(1, 1), (0, 0)])
def test_a_drive_not_set_for_the_bus_replies_and_does_not_run(parameter: int, value: int) -> None:
    async def scenario() -> float:
        async with SimulatorClient("sim://dzb100@1?ramp=1") as client:
            client.station().keypad_set(parameter, value)
            reply = await client.request(dzb100.Dzb100Control(1, Dzb100Command.FORWARD, 300))
            assert reply.accepted is True
            await asyncio.sleep(3.0)
            return float(client.station().motor.output_hz)

    assert run_virtual(scenario()) == 0.0


def test_a_new_address_applies_from_the_next_power_up() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://dzb100@1") as client:
            await client.request(dzb100.Dzb100WriteParameter(1, 78, 9))
            assert (await client.request(dzb100.Dzb100Query(1, 0))) is not None
            client.station().power_cycle()
            await asyncio.sleep(3.0)
            assert (await client.request(dzb100.Dzb100Query(9, 0))) is not None

    run_virtual(scenario())


def test_a_wrong_constant_gets_no_reply() -> None:
    async def scenario() -> bytes:
        async with SimulatorClient("sim://dzb100@1") as client:
            return await client.raw(frame_bytes("51 04 01 30 31 30 33 30 30 30 30"))

    assert run_virtual(scenario()) == b""


def test_a_truncated_frame_is_discarded_after_silence() -> None:
    async def scenario() -> Any:
        async with SimulatorClient("sim://dzb100@1") as client:
            assert await client.raw(frame_bytes("51 03 01 30 31 30 33 30 30 30")) == b""
            return await client.request(dzb100.Dzb100Query(1, 3))

    assert run_virtual(scenario()).data == 0
