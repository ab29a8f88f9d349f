"""Benches: sim:// ports, weather end to end, unplugging, two masters, faults of stations, determinism."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Iterator
from typing import Any

import pytest

from drivebus.errors import ConfigurationError, PortLost, PortUnavailable, PortUrlError
from drivebus.ports import open_port
from drivebus.ports.base import Port
from drivebus.protocols import modbus, sunfar
from drivebus.serial_settings import SerialSettings
from drivebus.simulator.models.catalog import make_station, parse_addresses
from drivebus.simulator.port import clear_simulated_buses, find_simulated_bus
from drivebus.simulator.station import Station
from fixtures.simulator import SimulatorClient, run_virtual

STATUS = modbus.ReadRegisters(1, 0x3000, 4)


@pytest.fixture(autouse=True)
def _fresh_names() -> Iterator[None]:
    clear_simulated_buses()
    yield
    clear_simulated_buses()


@pytest.mark.parametrize("lacking", ["handle_request", "reply_delay_s", "trip_code", "power_up"])
def test_a_family_that_leaves_out_what_only_it_can_say_is_no_station(lacking: str) -> None:
    """It fails when it is made, not at the first frame, trip or power cut of a bench."""
    given = {
        name: lambda self: None for name in {"handle_request", "reply_delay_s", "trip_code", "power_up"} - {lacking}
    }
    with pytest.raises(TypeError, match=lacking):
        type("Half", (Station,), given)(1, {})


def test_a_transaction_takes_what_the_arithmetic_says() -> None:
    async def scenario() -> float:
        async with SimulatorClient("sim://vc660@1?baud=19200&format=8E1") as desk:
            sent = asyncio.get_running_loop().time()
            await desk.request(STATUS)
            return desk.received[0][0] - sent

    character_s = 11 / 19200
    assert run_virtual(scenario()) == pytest.approx((8 + 13) * character_s + 0.004)


def test_the_line_is_the_factory_setting_unless_the_link_says() -> None:
    assert open_port("sim://c320@1").settings == SerialSettings(9600, 8, "E")
    assert open_port("sim://dzb100@1").settings == SerialSettings(4800, 8, "E")
    assert open_port("sim://vc660@1?baud=38400").settings == SerialSettings(38400, 8, "N")


def test_a_sim_port_is_a_port() -> None:
    port: Port = open_port("sim://c320@1")
    assert port.capabilities.has_line_timing and port.capabilities.parity
    assert port.url == "sim://c320@1"
    assert port.echo == "off"
    assert open_port("sim://c320@1?line_quality=echo").echo == "detect"


def test_families_can_share_a_wire() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1-2+df800@8") as desk:
            assert (await desk.request(STATUS)).values[0] == 1
            assert (await desk.request(modbus.ReadRegisters(8, 100, 1))).values == (5000,)

    run_virtual(scenario())


def test_nobody_answers_for_an_address_without_a_drive() -> None:
    async def scenario() -> Any:
        async with SimulatorClient("sim://vc660@1") as desk:
            return await desk.request(modbus.ReadRegisters(9, 0x3000, 1))

    assert run_virtual(scenario()) is None


def test_a_drives_line_other_than_the_hosts_is_silence() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1?baud=9600&drives=19200-8N1") as desk:
            assert await desk.raw(desk.codec.encode_request(STATUS)) == b""
            assert desk.station().frame_count == 0

    run_virtual(scenario())


def test_two_masters_with_different_settings_hear_each_other_as_noise() -> None:
    async def scenario() -> None:
        async with (
            SimulatorClient("sim://vc660@1?name=a") as right,
            SimulatorClient("sim://vc660@1?name=a&baud=19200") as wrong,
        ):
            frame = right.codec.encode_request(STATUS)
            await right.raw(frame)
            assert wrong.received
            assert all(marks == len(data) for _, data, marks in wrong.received)
            assert frame not in [data for _, data, _ in wrong.received]

    run_virtual(scenario())


def test_two_masters_who_speak_at_once_get_no_answer() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1,2?name=a") as one, SimulatorClient("sim://vc660@1,2?name=a") as two:
            assert one.simulated_bus is two.simulated_bus is find_simulated_bus("a")
            one.port.write(one.codec.encode_request(STATUS))
            await asyncio.sleep(0.002)
            two.port.write(one.codec.encode_request(modbus.ReadRegisters(2, 0x3000, 4)))
            await asyncio.sleep(0.5)
            assert one.simulated_bus.wire.collisions == 1
            assert (one.station(1).reply_count, one.station(2).reply_count) == (0, 0)

    run_virtual(scenario())


def test_a_second_master_hears_the_first_and_its_drive() -> None:
    async def scenario() -> list[bytes]:
        async with SimulatorClient("sim://vc660@1?name=a") as one, SimulatorClient("sim://vc660@1?name=a") as two:
            reply = await one.raw(one.codec.encode_request(STATUS))
            received_frames = [data for _, data, _ in two.received]
            assert received_frames == [one.codec.encode_request(STATUS), reply]
            return received_frames

    run_virtual(scenario())


def test_a_named_bench_keeps_its_drives_when_the_host_restarts() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1?name=plant") as desk:
            await desk.request(modbus.WriteRegister(1, 0x2001, 3000))
            await desk.request(modbus.WriteRegister(1, 0x2000, 1))
        await asyncio.sleep(10.0)
        async with SimulatorClient("sim://vc660@1?name=plant") as desk:
            assert (await desk.request(STATUS)).values[2] == 3000

    run_virtual(scenario())


def test_a_frame_written_just_before_closing_still_reaches_the_drive() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1") as desk:
            desk.port.write(desk.codec.encode_request(modbus.WriteRegister(1, 0x2000, 1)))
        await asyncio.sleep(1.0)
        assert desk.station().motor.starts == 1

    run_virtual(scenario())


def test_an_unplugged_bench_loses_the_port_once_and_the_drives_go_on() -> None:
    async def scenario() -> None:
        desk = SimulatorClient("sim://vc660@1")
        await desk.port.open(desk)
        await desk.request(modbus.WriteRegister(1, 0x2001, 3000))
        await desk.request(modbus.WriteRegister(1, 0x2000, 1))
        desk.port.write(desk.codec.encode_request(STATUS))
        desk.received.clear()
        desk.simulated_bus.unplug()
        await asyncio.sleep(10.0)
        assert [type(error) for error in desk.lost] == [PortLost]
        assert desk.received == []
        with pytest.raises(PortLost):
            desk.port.write(b"x")
        with pytest.raises(PortUnavailable):
            await desk.port.open(desk)
        desk.simulated_bus.replug()
        await desk.port.open(desk)
        assert (await desk.request(STATUS)).values[2] == 3000

    run_virtual(scenario())


def test_an_open_port_is_not_opened_twice() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1") as desk:
            with pytest.raises(PortUnavailable):
                await desk.port.open(desk)

    run_virtual(scenario())


def test_an_echo_brings_the_request_back_when_it_has_been_sent() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1?line_quality=echo") as desk:
            frame = desk.codec.encode_request(STATUS)
            sent = asyncio.get_running_loop().time()
            data = await desk.raw(frame)
            assert data.startswith(frame) and len(data) == 8 + 13
            assert desk.received[0][0] - sent == pytest.approx(8 * 10 / 9600)

    run_virtual(scenario())


def test_the_echo_of_a_write_to_a_dead_drive_is_identical_to_its_acknowledgement() -> None:
    async def scenario() -> Any:
        async with SimulatorClient("sim://vc660@1?line_quality=echo") as desk:
            desk.station().faults.silent = True
            return await desk.request(modbus.WriteRegister(1, 0x2000, 1))

    assert isinstance(run_virtual(scenario()), modbus.WriteAck)


def test_a_late_reply_comes_where_the_next_one_is_expected() -> None:
    async def scenario() -> list[bytes]:
        async with SimulatorClient("sim://vc660@1") as desk:
            desk.station().faults.next_added_delays_s.append(0.3)
            assert await desk.raw(desk.codec.encode_request(STATUS), 0.2) == b""
            await desk.raw(desk.codec.encode_request(modbus.ReadRegisters(1, 0, 1)), 0.5)
            return [data for _, data, _ in desk.received]

    first, second = run_virtual(scenario())
    assert len(first) == 13  # of the request before
    assert len(second) == 7


def test_two_drives_at_one_address_garble_their_replies() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1") as desk:
            desk.simulated_bus.add(make_station("vc660", 1))
            data = await desk.raw(desk.codec.encode_request(STATUS))
            assert desk.simulated_bus.wire.collisions == 1
            assert len(data) == 13
            assert data[:3] != bytes((1, 3, 8))

    run_virtual(scenario())


def test_a_wrong_address_answers_as_somebody_else() -> None:
    async def scenario() -> bytes:
        async with SimulatorClient("sim://vc660@1") as desk:
            desk.station().faults.wrong_address = 5
            return await desk.raw(desk.codec.encode_request(STATUS))

    assert run_virtual(scenario())[0] == 5


def test_a_slow_drive_answers_later_by_so_much() -> None:
    async def scenario() -> float:
        async with SimulatorClient("sim://vc660@1") as desk:
            desk.station().faults.added_delay_s = 0.1
            sent = asyncio.get_running_loop().time()
            await desk.request(STATUS)
            return desk.received[0][0] - sent

    assert run_virtual(scenario()) == pytest.approx(21 * 10 / 9600 + 0.104)


def test_a_mute_drive_obeys_and_a_silent_one_does_not() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1,2") as desk:
            desk.station(1).faults.mute = True
            desk.station(2).faults.silent = True
            for address in (1, 2):
                assert await desk.request(modbus.WriteRegister(address, 0x2000, 1)) is None
            assert (desk.station(1).motor.starts, desk.station(2).motor.starts) == (1, 0)

    run_virtual(scenario())


def test_a_stuck_drive_shows_what_it_showed() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1") as desk:
            await desk.request(modbus.WriteRegister(1, 0x2001, 3000))
            await desk.request(modbus.WriteRegister(1, 0x2000, 1))
            await asyncio.sleep(3.0)
            desk.station().faults.frozen_readings = True
            shown = (await desk.request(STATUS)).values
            await asyncio.sleep(5.0)
            assert (await desk.request(STATUS)).values == shown
            assert desk.station().motor.output_hz > shown[2] / 100

    run_virtual(scenario())


def test_a_marked_byte_spoils_the_frame_that_it_is_in() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://c320@1?line_quality=flip=1") as desk:
            await desk.raw(desk.codec.encode_request(sunfar.ReadMonitor(1, 0)))
            assert desk.station().frame_count == 0
            desk.simulated_bus.line_quality = "clean"
            assert (await desk.request(sunfar.ReadMonitor(1, 0))).data == 0

    run_virtual(scenario())


@pytest.mark.parametrize("weather", ["lossy,late,junk=0.1,duplicate=0.1,cut_first=0.05", "bytes,noisy"])
def test_the_same_seed_gives_the_same_trace(weather: str) -> None:
    async def scenario(seed: int) -> str:
        async with SimulatorClient(f"sim://vc660@1-3?line_quality={weather}&seed={seed}") as desk:
            trace = hashlib.sha256()
            for n in range(120):
                request = modbus.WriteRegister(1, 0x2000, n % 2) if n % 7 == 0 else STATUS
                await desk.raw(desk.codec.encode_request(request), 0.2)
                trace.update(repr(desk.received).encode())
            return trace.hexdigest()

    assert run_virtual(scenario(5)) == run_virtual(scenario(5))
    assert run_virtual(scenario(5)) != run_virtual(scenario(6))


def test_a_bench_can_be_used_in_another_loop() -> None:
    async def scenario() -> int:
        async with SimulatorClient("sim://vc660@1?name=kept") as desk:
            await desk.request(modbus.WriteRegister(1, 0x2000, 1))
            return int(desk.station().motor.starts)

    assert [run_virtual(scenario()), run_virtual(scenario())] == [1, 1]


def test_c300_shows_its_current_where_c320_shows_its_voltage() -> None:
    async def scenario(model: str) -> int:
        async with SimulatorClient(f"sim://{model}@1?ramp=1", sunfar.SunfarCodec()) as desk:
            await desk.request(sunfar.SunfarControl(1, sunfar.SunfarOperation.RUN_FORWARD_AT, 5000))
            await asyncio.sleep(3.0)
            return int((await desk.request(sunfar.ReadMonitor(1, 1))).data)

    assert run_virtual(scenario("c320")) == 380
    assert 20 < run_virtual(scenario("c300")) < 40


@pytest.mark.parametrize(
    ("link", "key"),
    [
        ("sim://c999@1", "sim.model"),
        ("sim://c320@31", "sim.address"),
        ("sim://df800@0", "sim.address"),
        ("sim://c320@x", "sim.addresses"),
        ("sim://c320", "sim.target"),
        ("sim://df800@1?direction_field=b1b0", "sim.setting"),
        ("sim://c320@1?load=rocket", "sim.setting"),
        ("sim://c320@1?line_quality=rain", "sim.line_quality_word"),
        ("sim://c320@1?drives=fast", "sim.drives"),
        ("sim://c320@1?colour=red", "ports.option-unknown"),
    ],
)
def test_a_link_that_names_no_bench_is_refused(link: str, key: str) -> None:
    with pytest.raises((ConfigurationError, PortUrlError)) as caught:
        open_port(link)
    assert caught.value.key == key


def test_the_refusal_of_a_model_names_those_that_exist() -> None:
    with pytest.raises(ConfigurationError) as caught:
        open_port("sim://c999@1")
    assert str(caught.value) == (
        "there is no simulated drive c999: expected one of c320, c300, e300, e500, e550, dzb100, vc660, df800"
    )


@pytest.mark.parametrize(("text", "expected"), [("0-3,7", [0, 1, 2, 3, 7]), ("5", [5]), ("1,1-2", [1, 2]), ("3-1", [])])
def test_addresses_are_ranges_and_numbers(text: str, expected: list[int]) -> None:
    if expected:
        assert parse_addresses(text) == expected
    else:
        with pytest.raises(ConfigurationError):
            parse_addresses(text)
