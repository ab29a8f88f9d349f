"""The simulated C320 replies, rejects and moves as described in appendix one of its manual."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from typing import Any

import pytest

from drivebus.protocols import sunfar
from drivebus.protocols.sunfar import SunfarOperation, SunfarResponse, SunfarState
from drivebus.simulator.motor import Trip
from fixtures.drives import run_virtual
from fixtures.simulator import SimulatorClient


def control(operation: SunfarOperation, data: int = 0, address: int = 1) -> sunfar.SunfarControl:
    return sunfar.SunfarControl(address, operation, data, expected_item=0)


def frame(address: int, kind: int, operation: int, *rest: str) -> bytes:
    """Return any ASCII frame, also one that a master must never send."""
    body = f"{address:02X}{kind:X}{operation:02X}{''.join(rest)}".encode()
    return b"*" + body + b"%04X\r" % sum(body)


async def running(client: SimulatorClient, hz: float = 30.0, address: int = 1) -> None:
    await client.request(control(SunfarOperation.RUN_FORWARD_AT, round(hz * 100), address))
    await asyncio.sleep(15.0)


def test_it_runs_at_the_frequency_that_the_start_carries() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://c320@1") as client:
            reply = await client.request(control(SunfarOperation.RUN_FORWARD_AT, 3000))
            assert reply.response is SunfarResponse.OK
            await asyncio.sleep(5.0)
            assert (await client.request(sunfar.ReadMonitor(1, 0))).state is SunfarState.ACCELERATING_FORWARD
            await asyncio.sleep(5.0)
            reply = await client.request(sunfar.ReadMonitor(1, 0))
            assert (reply.state, reply.data) == (SunfarState.RUNNING_FORWARD, 3000)

    run_virtual(scenario())


def test_the_reply_to_a_start_still_shows_stopped() -> None:
    async def scenario() -> Any:
        async with SimulatorClient("sim://c320@1") as client:
            return await client.request(control(SunfarOperation.RUN_FORWARD_AT, 3000))

    assert run_virtual(scenario()).state is SunfarState.STOPPED


@pytest.mark.parametrize(
    "bad",
    [
        frame(1, 0, 1, "0", "00"),
        frame(1, 1, 1, "0", "00"),
        frame(1, 2, 1, "0", "01"),
        frame(1, 3, 1, "4", "00", "0001"),
        frame(1, 5, 1, "4", "00", "0001"),
    ],
    ids=["4.1", "4.2", "4.3", "4.4", "4.5"],
)
def test_the_manuals_reads_and_writes_with_operation_01_start_the_motor(bad: bytes) -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://c320@1") as client:
            client.station().setpoint_hz = 20.0
            assert len(await client.raw(bad)) == 18
            await asyncio.sleep(10.0)
            assert client.station().motor.output_hz == pytest.approx(20.0)
            assert client.station().motor.starts == 1

    run_virtual(scenario())


def test_reads_with_operation_00_have_no_effect() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://c320@1") as client:
            await running(client)
            before = client.station().motor.output_hz
            for request in reads():
                await client.request(request, 0.1)
            assert client.station().motor.output_hz == before
            assert client.station().motor.starts == 1

    run_virtual(scenario())


def reads() -> Iterator[Any]:
    yield from (sunfar.ReadIdentity(1, group) for group in range(16))
    yield from (sunfar.ReadMonitor(1, item) for item in range(38))
    yield from (sunfar.SunfarReadParameter(1, group, item) for group in range(16) for item in (0, 1, 4, 10, 12))


def test_a_digit_encoded_as_3ah_is_answered_with_code_7() -> None:
    async def scenario() -> bytes:
        async with SimulatorClient("sim://c320@1") as client:
            body = b"0150110:0010"
            return await client.raw(b"*" + body + b"%04X\r" % sum(body))

    reply = run_virtual(scenario())
    assert len(reply) == 11
    assert reply[3:4] == b"7"


def test_packed_hex_frames_are_answered_in_packed_hex() -> None:
    async def scenario() -> Any:
        async with SimulatorClient("sim://c320@1", sunfar.SunfarCodec("hex")) as client:
            return await client.request(sunfar.SunfarReadParameter(1, 0, 1))

    assert run_virtual(scenario()).data == 2


def test_a_read_of_f0_1_and_of_d_1_have_replies_of_the_same_shape() -> None:
    async def scenario() -> tuple[bytes, bytes]:
        async with SimulatorClient("sim://c320@1") as client:
            codec = client.codec
            parameter = await client.raw(codec.encode_request(sunfar.SunfarReadParameter(1, 0, 1)))
            monitor = await client.raw(codec.encode_request(sunfar.ReadMonitor(1, 1)))
            return parameter, monitor

    parameter, monitor = run_virtual(scenario())
    assert parameter[:9] == monitor[:9]


def test_a_fault_code_replaces_the_item_and_nothing_else() -> None:
    async def scenario() -> Any:
        async with SimulatorClient("sim://c320@1") as client:
            client.station().trip(Trip.OVERLOAD)
            return await client.request(sunfar.ReadMonitor(1, 4))

    reply = run_virtual(scenario())
    assert reply.state is SunfarState.FAULT
    assert reply.fault_code == 6
    assert reply.item is None
    assert reply.data == 537, "by 2.4.6 only digits 7 and 8 have another meaning"


def test_a_fault_is_reset_and_the_drive_starts_again() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://c320@1") as client:
            await running(client)
            client.station().trip(Trip.EXTERNAL)
            await client.request(control(SunfarOperation.RUN_FORWARD_AT, 3000))
            assert client.station().motor.output_hz == 0.0
            reply = await client.request(control(SunfarOperation.RESET_FAULT))
            assert reply.state is SunfarState.STOPPED
            await running(client)
            assert client.station().motor.output_hz == pytest.approx(30.0)

    run_virtual(scenario())


def test_a_reset_keeps_the_module_temperature_of_the_last_fault() -> None:
    """It read 0 °C after the reset, as if there had been no fault."""

    async def scenario() -> None:
        async with SimulatorClient("sim://c320@1") as client:
            assert (await client.request(sunfar.ReadMonitor(1, 37))).data == 0
            motor = client.station().motor
            motor.temperature_c = 61.0
            motor.force_trip(Trip.OVERLOAD)
            motor.temperature_c = 40.0
            await client.request(control(SunfarOperation.RESET_FAULT))
            assert (await client.request(sunfar.ReadMonitor(1, 37))).data == 61

    run_virtual(scenario())


def test_t06_0dh_as_data_of_a_hex_frame_ends_nothing() -> None:
    async def scenario() -> Any:
        async with SimulatorClient("sim://c320@13", sunfar.SunfarCodec("hex")) as client:
            return await client.request(sunfar.SunfarWriteParameter(13, 1, 0, 0x0D0D))

    assert run_virtual(scenario()).response is SunfarResponse.OK


@pytest.mark.parametrize(
    ("request_", "response"),
    [
        (sunfar.SunfarWriteParameter(1, 9, 3, 9), SunfarResponse.OUT_OF_RANGE),
        (sunfar.SunfarReadParameter(1, 2, 7), SunfarResponse.RESERVED),
        (sunfar.SunfarWriteParameter(1, 15, 0, 1), SunfarResponse.RESERVED),
        (sunfar.SunfarReadParameter(1, 0, 200), SunfarResponse.BAD_CODE),
        (sunfar.ReadMonitor(1, 38), SunfarResponse.BAD_CODE),
        (sunfar.ReadIdentity(1, 9), SunfarResponse.RESERVED),
    ],
)
def test_a_rejected_request_is_answered_with_the_code_of_the_manual(request_: Any, response: SunfarResponse) -> None:
    async def scenario() -> Any:
        async with SimulatorClient("sim://c320@1") as client:
            return await client.request(request_)

    reply = run_virtual(scenario())
    assert reply.response is response
    assert reply.data in (None, 0)


def test_a_rejected_write_reports_data_0000_and_changes_nothing() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://c320@1") as client:
            reply = await client.request(sunfar.SunfarWriteParameter(1, 9, 3, 9, save=True))
            assert (reply.response, reply.data) == (SunfarResponse.OUT_OF_RANGE, 0)
            assert client.station().memory.eeprom_writes.total() == 0

    run_virtual(scenario())


def test_some_parameters_are_locked_while_running() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://c320@1") as client:
            await running(client)
            assert (await client.request(sunfar.SunfarWriteParameter(1, 0, 1, 0))).response is SunfarResponse.RUNNING
            assert (await client.request(sunfar.SunfarWriteParameter(1, 9, 4, 30))).response is SunfarResponse.OK

    run_virtual(scenario())


def test_a_password_locks_every_write_and_no_read() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://c320@1") as client:
            client.station().memory.locked = True
            assert (await client.request(sunfar.SunfarWriteParameter(1, 9, 4, 30))).response is SunfarResponse.PASSWORD
            assert (await client.request(sunfar.SunfarReadParameter(1, 9, 4))).response is SunfarResponse.OK

    run_virtual(scenario())


@pytest.mark.parametrize("kind", range(6, 16))
def test_reserved_classes_are_answered_with_code_8(kind: int) -> None:
    async def scenario() -> bytes:
        async with SimulatorClient("sim://c320@1") as client:
            return await client.raw(frame(1, kind, 0, "0", "00"))

    reply = run_virtual(scenario())
    assert (len(reply), reply[3:4]) == (11, b"8")


@pytest.mark.parametrize("operation", [0x07, 0x17, 0x22, 0x30, 0x31, 0xFF])
def test_reserved_operations_are_answered_with_code_8_and_do_nothing(operation: int) -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://c320@1") as client:
            reply = await client.raw(frame(1, 4, operation, "0BB8"))
            assert (len(reply), reply[3:4]) == (11, b"8")
            await asyncio.sleep(5.0)
            assert client.station().motor.output_hz == 0.0

    run_virtual(scenario())


@pytest.mark.parametrize("at", [0, 9, 13])
def test_a_bad_head_sum_or_end_byte_gets_no_reply(at: int) -> None:
    async def scenario() -> bytes:
        async with SimulatorClient("sim://c320@1") as client:
            good = bytearray(client.codec.encode_request(sunfar.ReadMonitor(1, 0)))
            good[at] ^= 0x01
            return await client.raw(bytes(good))

    assert run_virtual(scenario()) == b""


def test_a_frequency_above_the_maximum_is_rejected_and_starts_nothing() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://c320@1") as client:
            reply = await client.request(control(SunfarOperation.RUN_FORWARD_AT, 5001))
            assert reply.response is SunfarResponse.OUT_OF_RANGE
            await asyncio.sleep(5.0)
            assert client.station().motor.starts == 0

    run_virtual(scenario())


def test_all_stations_execute_a_broadcast_stop_and_none_replies() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://c320@0-3") as client:
            for address in range(4):
                await client.request(control(SunfarOperation.RUN_FORWARD_AT, 3000, address))
            await asyncio.sleep(10.0)
            assert await client.raw(client.codec.encode_request(control(SunfarOperation.STOP, 0, 31))) == b""
            await asyncio.sleep(11.0)
            assert [client.station(address).motor.energised for address in range(4)] == [False] * 4

    run_virtual(scenario())


def test_the_first_byte_of_a_reply_comes_within_eight_characters() -> None:
    async def scenario() -> float:
        async with SimulatorClient("sim://c320@1?line_quality=bytes") as client:
            sent = asyncio.get_running_loop().time()
            await client.raw(client.codec.encode_request(sunfar.ReadMonitor(1, 0)))
            return client.received[0][0] - sent

    character_s = 11 / 9600
    assert run_virtual(scenario()) == pytest.approx((14 + 4 + 1) * character_s)


@pytest.mark.parametrize(("characters", "answered"), [(4.5, False), (5.1, True)])
def test_a_frame_without_five_characters_of_silence_before_it_is_not_recognized(
    characters: float, answered: bool
) -> None:
    async def scenario() -> tuple[bytes, int]:
        async with SimulatorClient("sim://c320@1,2") as client:
            request = client.codec.encode_request(sunfar.ReadMonitor(1, 0))
            line = client.simulated_bus.settings
            client.port.write(client.codec.encode_request(sunfar.ReadMonitor(3, 0)))
            await asyncio.sleep(line.seconds(14 + characters))
            return await client.raw(request), client.station().gap_violations

    data, violations = run_virtual(scenario())
    assert bool(data) is answered
    assert violations == 0


def test_a_head_in_the_middle_of_other_bytes_starts_no_frame() -> None:
    async def scenario() -> bytes:
        async with SimulatorClient("sim://c320@1") as client:
            return await client.raw(b"\x00" + client.codec.encode_request(sunfar.ReadMonitor(1, 0)))

    assert run_virtual(scenario()) == b""


@pytest.mark.parametrize(
    ("action", "expected"),
    [(0, SunfarState.RUNNING_FORWARD), (1, SunfarState.DECELERATING_FORWARD), (2, SunfarState.FAULT)],
)
def test_f9_3_selects_the_reaction_to_f9_4_seconds_without_a_frame(action: int, expected: SunfarState) -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://c320@1") as client:
            await client.request(sunfar.SunfarWriteParameter(1, 9, 3, action))
            await client.request(sunfar.SunfarWriteParameter(1, 9, 4, 200))
            await running(client)
            await asyncio.sleep(4.0)
            assert client.station().state is SunfarState.RUNNING_FORWARD
            await asyncio.sleep(2.0)
            assert client.station().state is expected

    run_virtual(scenario())


def test_polling_restarts_the_comm_loss_timer_and_foreign_frames_do_not() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://c320@1,2") as client:
            for address in (1, 2):
                await client.request(sunfar.SunfarWriteParameter(address, 9, 4, 20))
                await client.request(control(SunfarOperation.RUN_FORWARD_AT, 3000, address))
            for _ in range(12):
                await client.request(sunfar.ReadMonitor(1, 0), 1.0)
            assert client.station(1).running
            assert not client.station(2).running

    run_virtual(scenario())


def test_a_frame_after_comm_loss_is_executed_by_its_operation_field() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://c320@1") as client:
            await client.request(sunfar.SunfarWriteParameter(1, 9, 4, 20))
            await running(client)
            assert not client.station().running
            await client.request(control(SunfarOperation.RUN_FORWARD))
            await asyncio.sleep(1.0)
            assert client.station().running

    run_virtual(scenario())


def test_class_3_is_lost_at_power_down_and_class_5_is_saved_and_counted() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://c320@1") as client:
            await client.request(sunfar.SunfarWriteParameter(1, 9, 4, 30))
            await client.request(sunfar.SunfarWriteParameter(1, 6, 12, 4, save=True))
            client.station().power_cycle()
            await asyncio.sleep(3.0)
            assert (await client.request(sunfar.SunfarReadParameter(1, 9, 4))).data == 0
            assert (await client.request(sunfar.SunfarReadParameter(1, 6, 12))).data == 4
            memory = client.station().memory
            assert memory.eeprom_writes[0x60C] == 1
            assert memory.eeprom_writes[0x904] == 0

    run_virtual(scenario())


def test_a_rebooting_drive_sends_no_reply_and_does_not_run_afterwards() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://c320@1") as client:
            await running(client)
            client.station().power_cycle(off_s=2.0)
            assert await client.request(sunfar.ReadMonitor(1, 0)) is None
            await asyncio.sleep(2.0)
            reply = await client.request(sunfar.ReadMonitor(1, 0))
            assert (reply.state, reply.data) == (SunfarState.STOPPED, 0)

    run_virtual(scenario())


def test_f6_12_selects_the_item_in_a_control_reply() -> None:
    async def scenario() -> Any:
        async with SimulatorClient("sim://c320@1") as client:
            await client.request(sunfar.SunfarWriteParameter(1, 6, 12, 4))
            return await client.request(sunfar.SunfarControl(1, SunfarOperation.STOP, expected_item=4))

    reply = run_virtual(scenario())
    assert reply.item == 4
    assert reply.data == 537


@pytest.mark.parametrize("operation", [SunfarOperation.RUN_FORWARD_AT, SunfarOperation.JOG_FORWARD])
def test_keypad_control_ignores_commands_of_the_bus_and_replies(operation: SunfarOperation) -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://c320@1") as client:
            client.station().keypad_set(0x003, 0)
            data = 1000 if operation.sets_frequency else 0
            assert (await client.request(control(operation, data))).response is SunfarResponse.OK
            await asyncio.sleep(5.0)
            assert not client.station().running
            assert (await client.request(sunfar.ReadIdentity(1, 3))).info == "010000"

    run_virtual(scenario())


def test_with_f0_1_not_2_the_frequency_of_the_bus_is_ignored() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://c320@1") as client:
            client.station().keypad_set(0x001, 0)
            client.station().keypad_set(0x002, 1000)
            await running(client, 30.0)
            assert client.station().motor.output_hz == pytest.approx(10.0)

    run_virtual(scenario())


def test_a_person_can_start_and_stop_at_the_keypad() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://c320@1") as client:
            client.station().keypad_run(25.0)
            await asyncio.sleep(6.0)
            assert (await client.request(sunfar.ReadMonitor(1, 0))).data == 2500
            client.station().keypad_stop()
            await asyncio.sleep(6.0)
            assert (await client.request(sunfar.ReadMonitor(1, 0))).state is SunfarState.STOPPED

    run_virtual(scenario())


@pytest.mark.parametrize(
    ("operation", "jogging", "output_hz"),
    [
        (SunfarOperation.JOG_FORWARD, SunfarState.JOGGING_FORWARD, 5.0),
        (SunfarOperation.JOG_REVERSE, SunfarState.JOGGING_REVERSE, -5.0),
    ],
)
def test_it_jogs_until_a_jog_stop(operation: SunfarOperation, jogging: SunfarState, output_hz: float) -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://c320@1") as client:
            await client.request(control(operation))
            await asyncio.sleep(3.0)
            assert client.station().state is jogging
            assert client.station().motor.output_hz == pytest.approx(output_hz)
            await client.request(control(SunfarOperation.JOG_STOP))
            await asyncio.sleep(3.0)
            assert client.station().state is SunfarState.STOPPED

    run_virtual(scenario())


def test_a_jog_stop_does_not_stop_a_run() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://c320@1") as client:
            await running(client)
            await client.request(control(SunfarOperation.JOG_STOP))
            await asyncio.sleep(1.0)
            assert client.station().state is SunfarState.RUNNING_FORWARD

    run_virtual(scenario())


def test_an_emergency_stop_switches_off_and_latches_until_a_stop_or_reset() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://c320@1") as client:
            await running(client)
            assert (await client.request(control(SunfarOperation.EMERGENCY_STOP))).state is SunfarState.EMERGENCY_STOP
            await client.request(control(SunfarOperation.RUN_FORWARD))
            await asyncio.sleep(2.0)
            client.station().keypad_run(5.0)
            assert not client.station().running, "nor by the keypad"
            assert (await client.request(control(SunfarOperation.RESET_FAULT))).state is SunfarState.STOPPED

    run_virtual(scenario())


def test_reverse_runs_show_reverse_states() -> None:
    async def scenario() -> list[SunfarState]:
        async with SimulatorClient("sim://c320@1") as client:
            await client.request(control(SunfarOperation.RUN_REVERSE_AT, 1000))
            states = [client.station().state]
            await asyncio.sleep(3.0)
            states.append(client.station().state)
            await client.request(control(SunfarOperation.STOP))
            states.append(client.station().state)
            return states

    assert run_virtual(scenario()) == [
        SunfarState.ACCELERATING_REVERSE,
        SunfarState.RUNNING_REVERSE,
        SunfarState.DECELERATING_REVERSE,
    ]


def test_an_instantaneous_power_loss_is_ridden_through_with_speed_search() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://c320@1") as client:
            await client.request(sunfar.SunfarWriteParameter(1, 4, 0, 1))
            await running(client)
            client.station().power_dip(0.3)
            await asyncio.sleep(0.2)
            assert client.station().state is SunfarState.RESTARTING
            await asyncio.sleep(15.0)
            assert client.station().state is SunfarState.RUNNING_FORWARD
            assert client.station().motor.output_hz == pytest.approx(30.0)

    run_virtual(scenario())


def test_without_mains_the_dc_bus_is_not_ready() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://c320@1") as client:
            client.station().power_dip(100.0)
            await asyncio.sleep(50.0)
            assert (await client.request(sunfar.ReadMonitor(1, 4))).state is SunfarState.NOT_READY

    run_virtual(scenario())


def test_its_identity_is_class_voltage_and_decimal_power() -> None:
    async def scenario() -> Any:
        async with SimulatorClient("sim://c320@1") as client:
            return await client.request(sunfar.ReadIdentity(1, 0))

    assert run_virtual(scenario()).info == "400022"


def test_the_echo_of_a_class_3_request_looks_like_the_reply_of_a_silent_drive() -> None:
    async def scenario() -> bytes:
        async with SimulatorClient("sim://c320@1?line_quality=echo") as client:
            client.station().faults.silent = True
            request = client.codec.encode_request(sunfar.SunfarWriteParameter(1, 4, 0, 0))
            data = await client.raw(request)
            assert data == request
            return data

    assert len(run_virtual(scenario())) == 18


def test_monitors_can_be_read_by_their_decimal_index() -> None:
    async def scenario() -> tuple[Any, Any]:
        async with SimulatorClient("sim://c320@1?monitor_index=bcd") as client:
            return await client.request(sunfar.ReadMonitor(1, 0x37)), await client.request(sunfar.ReadMonitor(1, 0x0F))

    known, unknown = run_virtual(scenario())
    assert known.response is SunfarResponse.OK
    assert unknown.response is SunfarResponse.BAD_CODE


def test_the_e_series_counts_in_tenths_of_a_hertz() -> None:
    async def scenario() -> Any:
        async with SimulatorClient("sim://e550@1") as client:
            await client.request(control(SunfarOperation.RUN_FORWARD_AT, 300))
            await asyncio.sleep(10.0)
            assert client.station().motor.output_hz == pytest.approx(30.0)
            return await client.request(sunfar.ReadMonitor(1, 0))

    assert run_virtual(scenario()).data == 300


def test_a_stop_with_a_frequency_stops() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://c320@1") as client:
            await running(client)
            await client.request(control(SunfarOperation.STOP_AT, 1000))
            await asyncio.sleep(10.0)
            assert client.station().state is SunfarState.STOPPED
            assert client.station().setpoint_hz == 10.0

    run_virtual(scenario())


def test_the_e_series_has_selector_and_comm_loss_time_at_other_parameters() -> None:
    async def scenario(model: str, group: int, item: int) -> tuple[SunfarResponse, SunfarResponse]:
        async with SimulatorClient(f"sim://{model}@1", sunfar.SunfarCodec()) as client:
            there = await client.request(sunfar.SunfarReadParameter(1, group, item))
            here = await client.request(sunfar.SunfarReadParameter(1, *((6, 12) if model == "e500" else (9, 4))))
            return there.response, here.response

    assert run_virtual(scenario("e500", 3, 8)) == (SunfarResponse.OK, SunfarResponse.RESERVED)
    assert run_virtual(scenario("e550", 4, 4)) == (SunfarResponse.OK, SunfarResponse.RESERVED)


@pytest.mark.parametrize("model", ["e300", "e550"])
@pytest.mark.parametrize(("action", "stops"), [(0x00, True), (0x01, True), (0x10, False), (0x11, False)])
def test_the_tens_digit_of_the_e_series_selects_whether_it_stops(model: str, action: int, stops: bool) -> None:
    """E300 manual, F4.3: 0 stop, 1 keep state. It stops at its time, and not as a fault."""

    async def scenario() -> None:
        async with SimulatorClient(f"sim://{model}@1?ramp=1") as client:
            client.station().keypad_set(0x4_03, action)
            client.station().keypad_set(0x4_04, 50)
            await client.request(control(SunfarOperation.RUN_FORWARD_AT, 300))
            await asyncio.sleep(4.9)
            assert client.station().motor.energised
            await asyncio.sleep(2.0)
            assert client.station().motor.energised is not stops
            assert client.station().motor.trip is None

    run_virtual(scenario())


def test_dc_braking_is_a_state_of_its_own() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://c320@1?ramp=1") as client:
            client.station().motor.dc_brake_s = 2.0
            await running(client)
            await client.request(control(SunfarOperation.STOP))
            await asyncio.sleep(1.5)
            assert client.station().state is SunfarState.DC_BRAKING

    run_virtual(scenario())


def test_a_new_frequency_changes_a_running_drive_and_does_not_start_a_stopped_drive() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://c320@1?ramp=1") as client:
            await client.request(control(SunfarOperation.SET_FREQUENCY, 2000))
            assert client.station().motor.starts == 0
            await client.request(control(SunfarOperation.RUN_FORWARD))
            await asyncio.sleep(1.0)
            await client.request(control(SunfarOperation.SET_FREQUENCY, 4000))
            await asyncio.sleep(2.0)
            assert client.station().motor.output_hz == pytest.approx(40.0)

    run_virtual(scenario())


def test_a_jog_does_not_disturb_a_run() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://c320@1?ramp=1") as client:
            await running(client)
            await client.request(control(SunfarOperation.JOG_REVERSE))
            await asyncio.sleep(3.0)
            assert client.station().motor.output_hz == pytest.approx(30.0)

    run_virtual(scenario())
