"""Simulated buses: ``sim://`` ports, line quality, unplugging, two masters, station faults, determinism."""

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
from drivebus.simulator.models.catalog import make_station
from drivebus.simulator.port import clear_simulated_buses, find_simulated_bus
from drivebus.simulator.station import SimulatedStation
from fixtures.drives import run_virtual
from fixtures.simulator import SimulatorClient

STATUS = modbus.ReadRegisters(1, 0x3000, 4)


@pytest.fixture(autouse=True)
def _no_named_buses() -> Iterator[None]:
    clear_simulated_buses()
    yield
    clear_simulated_buses()


@pytest.mark.parametrize("missing", ["handle_request", "reply_delay_s", "trip_code", "power_up"])
def test_a_station_class_without_its_own_methods_cannot_be_instantiated(missing: str) -> None:
    """The error comes from the constructor, not from the first frame, trip or power cut."""
    methods = {
        name: lambda self: None for name in {"handle_request", "reply_delay_s", "trip_code", "power_up"} - {missing}
    }
    with pytest.raises(TypeError, match=missing):
        type("IncompleteStation", (SimulatedStation,), methods)(1, {})


def test_a_transaction_takes_the_computed_time() -> None:
    async def scenario() -> float:
        async with SimulatorClient("sim://vc660@1?baud=19200&format=8E1") as client:
            sent = asyncio.get_running_loop().time()
            await client.request(STATUS)
            return client.received[0][0] - sent

    character_s = 11 / 19200
    assert run_virtual(scenario()) == pytest.approx((8 + 13) * character_s + 0.004)


def test_a_reply_that_has_arrived_is_read_before_the_event_loop_delivers_it() -> None:
    """The timer of a bus that is due at the last bit of a reply must not end the transaction without it."""
    last_bit_s = 21 * 11 / 19200 + 0.004

    async def scenario() -> list[int]:
        counts: list[int] = []
        async with SimulatorClient("sim://vc660@1?baud=19200&format=8E1") as client:
            loop = asyncio.get_running_loop()

            def read() -> None:
                counts.append(len(client.received))
                client.port.read_pending()
                counts.append(len(client.received))

            loop.call_at(loop.time() + last_bit_s - 1e-4, read)
            loop.call_at(loop.time() + last_bit_s, read)  # before the timer of the wire, which is set later
            client.port.write(client.codec.encode_request(STATUS))
            await asyncio.sleep(1.0)
            return [*counts, len(client.received)]

    assert run_virtual(scenario()) == [0, 0, 0, 1, 1]


def test_the_serial_settings_are_the_factory_settings_unless_the_url_sets_them() -> None:
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
        async with SimulatorClient("sim://vc660@1-2+df800@8") as client:
            assert (await client.request(STATUS)).values[0] == 1
            assert (await client.request(modbus.ReadRegisters(8, 100, 1))).values == (5000,)

    run_virtual(scenario())


def test_an_address_without_a_drive_gives_no_reply() -> None:
    async def scenario() -> Any:
        async with SimulatorClient("sim://vc660@1") as client:
            return await client.request(modbus.ReadRegisters(9, 0x3000, 1))

    assert run_virtual(scenario()) is None


def test_a_drive_with_other_serial_settings_than_the_master_does_not_reply() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1?baud=9600&drives=19200-8N1") as client:
            assert await client.raw(client.codec.encode_request(STATUS)) == b""
            assert client.station().frame_count == 0

    run_virtual(scenario())


def test_two_masters_with_different_settings_receive_each_other_as_noise() -> None:
    async def scenario() -> None:
        async with (
            SimulatorClient("sim://vc660@1?name=a") as right,
            SimulatorClient("sim://vc660@1?name=a&baud=19200") as wrong,
        ):
            frame = right.codec.encode_request(STATUS)
            await right.raw(frame)
            assert wrong.received
            assert all(line_errors == len(data) for _, data, line_errors in wrong.received)
            assert frame not in [data for _, data, _ in wrong.received]

    run_virtual(scenario())


def test_two_masters_that_transmit_at_once_get_no_reply() -> None:
    async def scenario() -> None:
        async with (
            SimulatorClient("sim://vc660@1,2?name=a") as first,
            SimulatorClient("sim://vc660@1,2?name=a") as second,
        ):
            assert first.simulated_bus is second.simulated_bus is find_simulated_bus("a")
            first.port.write(first.codec.encode_request(STATUS))
            await asyncio.sleep(0.002)
            second.port.write(first.codec.encode_request(modbus.ReadRegisters(2, 0x3000, 4)))
            await asyncio.sleep(0.5)
            assert first.simulated_bus.wire.collisions == 1
            assert (first.station(1).reply_count, first.station(2).reply_count) == (0, 0)

    run_virtual(scenario())


def test_a_second_master_receives_the_first_and_its_drive() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1?name=a") as first, SimulatorClient("sim://vc660@1?name=a") as second:
            reply = await first.raw(first.codec.encode_request(STATUS))
            assert [data for _, data, _ in second.received] == [first.codec.encode_request(STATUS), reply]

    run_virtual(scenario())


def test_a_named_bus_keeps_its_drives_when_the_master_restarts() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1?name=plant") as client:
            await client.request(modbus.WriteRegister(1, 0x2001, 3000))
            await client.request(modbus.WriteRegister(1, 0x2000, 1))
        await asyncio.sleep(10.0)
        async with SimulatorClient("sim://vc660@1?name=plant") as client:
            assert (await client.request(STATUS)).values[2] == 3000

    run_virtual(scenario())


def test_a_frame_written_just_before_closing_still_reaches_the_drive() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1") as client:
            client.port.write(client.codec.encode_request(modbus.WriteRegister(1, 0x2000, 1)))
        await asyncio.sleep(1.0)
        assert client.station().motor.starts == 1

    run_virtual(scenario())


def test_an_unplugged_bus_loses_the_port_once_and_the_drives_go_on() -> None:
    async def scenario() -> None:
        client = SimulatorClient("sim://vc660@1")
        await client.port.open(client)
        await client.request(modbus.WriteRegister(1, 0x2001, 3000))
        await client.request(modbus.WriteRegister(1, 0x2000, 1))
        client.port.write(client.codec.encode_request(STATUS))
        client.received.clear()
        client.simulated_bus.unplug()
        await asyncio.sleep(10.0)
        assert [type(error) for error in client.lost] == [PortLost]
        assert client.received == []
        with pytest.raises(PortLost):
            client.port.write(b"x")
        with pytest.raises(PortUnavailable):
            await client.port.open(client)
        client.simulated_bus.replug()
        await client.port.open(client)
        assert (await client.request(STATUS)).values[2] == 3000

    run_virtual(scenario())


def test_an_open_port_is_not_opened_twice() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1") as client:
            with pytest.raises(PortUnavailable):
                await client.port.open(client)

    run_virtual(scenario())


def test_an_echo_brings_the_request_back_when_it_has_been_sent() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1?line_quality=echo") as client:
            frame = client.codec.encode_request(STATUS)
            sent = asyncio.get_running_loop().time()
            data = await client.raw(frame)
            assert data.startswith(frame) and len(data) == 8 + 13
            assert client.received[0][0] - sent == pytest.approx(8 * 10 / 9600)

    run_virtual(scenario())


def test_the_echo_of_a_write_to_a_dead_drive_is_identical_to_its_acknowledgement() -> None:
    async def scenario() -> Any:
        async with SimulatorClient("sim://vc660@1?line_quality=echo") as client:
            client.station().faults.silent = True
            return await client.request(modbus.WriteRegister(1, 0x2000, 1))

    assert isinstance(run_virtual(scenario()), modbus.WriteAck)


def test_a_late_reply_arrives_where_the_next_one_is_expected() -> None:
    async def scenario() -> list[bytes]:
        async with SimulatorClient("sim://vc660@1") as client:
            client.station().faults.next_added_delays_s.append(0.3)
            assert await client.raw(client.codec.encode_request(STATUS), 0.2) == b""
            await client.raw(client.codec.encode_request(modbus.ReadRegisters(1, 0, 1)), 0.5)
            return [data for _, data, _ in client.received]

    first, second = run_virtual(scenario())
    assert len(first) == 13  # the reply to the previous request
    assert len(second) == 7


def test_the_replies_of_two_drives_at_one_address_collide() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1") as client:
            client.simulated_bus.add(make_station("vc660", 1))
            data = await client.raw(client.codec.encode_request(STATUS))
            assert client.simulated_bus.wire.collisions == 1
            assert len(data) == 13
            assert data[:3] != bytes((1, 3, 8))

    run_virtual(scenario())


def test_a_drive_with_a_wrong_address_replies_under_that_address() -> None:
    async def scenario() -> bytes:
        async with SimulatorClient("sim://vc660@1") as client:
            client.station().faults.wrong_address = 5
            return await client.raw(client.codec.encode_request(STATUS))

    assert run_virtual(scenario())[0] == 5


def test_a_slow_drive_replies_later_by_the_added_delay() -> None:
    async def scenario() -> float:
        async with SimulatorClient("sim://vc660@1") as client:
            client.station().faults.added_delay_s = 0.1
            sent = asyncio.get_running_loop().time()
            await client.request(STATUS)
            return client.received[0][0] - sent

    assert run_virtual(scenario()) == pytest.approx(21 * 10 / 9600 + 0.104)


def test_a_mute_drive_executes_requests_and_a_silent_one_does_not() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1,2") as client:
            client.station(1).faults.mute = True
            client.station(2).faults.silent = True
            for address in (1, 2):
                assert await client.request(modbus.WriteRegister(address, 0x2000, 1)) is None
            assert (client.station(1).motor.starts, client.station(2).motor.starts) == (1, 0)

    run_virtual(scenario())


def test_frozen_monitors_keep_their_values() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://vc660@1") as client:
            await client.request(modbus.WriteRegister(1, 0x2001, 3000))
            await client.request(modbus.WriteRegister(1, 0x2000, 1))
            await asyncio.sleep(3.0)
            client.station().faults.frozen_readings = True
            shown = (await client.request(STATUS)).values
            await asyncio.sleep(5.0)
            assert (await client.request(STATUS)).values == shown
            assert client.station().motor.output_hz > shown[2] / 100

    run_virtual(scenario())


def test_a_line_error_invalidates_its_own_frame_only() -> None:
    async def scenario() -> None:
        async with SimulatorClient("sim://c320@1?line_quality=flip=1") as client:
            await client.raw(client.codec.encode_request(sunfar.ReadMonitor(1, 0)))
            assert client.station().frame_count == 0
            client.simulated_bus.line_quality = "clean"
            assert (await client.request(sunfar.ReadMonitor(1, 0))).data == 0

    run_virtual(scenario())


@pytest.mark.parametrize("line_quality", ["lossy,late,junk=0.1,duplicate=0.1,cut_first=0.05", "bytes,noisy"])
def test_the_same_seed_gives_the_same_trace(line_quality: str) -> None:
    async def scenario(seed: int) -> str:
        async with SimulatorClient(f"sim://vc660@1-3?line_quality={line_quality}&seed={seed}") as client:
            trace = hashlib.sha256()
            for n in range(120):
                request = modbus.WriteRegister(1, 0x2000, n % 2) if n % 7 == 0 else STATUS
                await client.raw(client.codec.encode_request(request), 0.2)
                trace.update(repr(client.received).encode())
            return trace.hexdigest()

    assert run_virtual(scenario(5)) == run_virtual(scenario(5))
    assert run_virtual(scenario(5)) != run_virtual(scenario(6))


def test_a_simulated_bus_can_be_used_in_another_event_loop() -> None:
    async def scenario() -> int:
        async with SimulatorClient("sim://vc660@1?name=shared") as client:
            await client.request(modbus.WriteRegister(1, 0x2000, 1))
            return int(client.station().motor.starts)

    assert [run_virtual(scenario()), run_virtual(scenario())] == [1, 1]


def test_c300_shows_its_current_where_c320_shows_its_voltage() -> None:
    async def scenario(model: str) -> int:
        async with SimulatorClient(f"sim://{model}@1?ramp=1", sunfar.SunfarCodec()) as client:
            await client.request(sunfar.SunfarControl(1, sunfar.SunfarOperation.RUN_FORWARD_AT, 5000))
            await asyncio.sleep(3.0)
            return int((await client.request(sunfar.ReadMonitor(1, 1))).data)

    assert run_virtual(scenario("c320")) == 380
    assert 20 < run_virtual(scenario("c300")) < 40


@pytest.mark.parametrize(
    ("link", "key"),
    [
        ("sim://c999@1", "sim.model"),
        ("sim://c320@31", "sim.address"),
        ("sim://df800@0", "sim.address"),
        ("sim://c320@x", "sim.addresses"),
        ("sim://c320@3-1", "sim.addresses"),
        ("sim://c320", "sim.target"),
        ("sim://df800@1?direction_field=b1b0", "sim.setting"),
        ("sim://c320@1?load=rocket", "sim.setting"),
        ("sim://c320@1?line_quality=rain", "sim.line_quality_word"),
        ("sim://c320@1?drives=fast", "sim.drives"),
        ("sim://c320@1?colour=red", "ports.option_unknown"),
    ],
)
def test_an_invalid_sim_url_is_rejected(link: str, key: str) -> None:
    with pytest.raises((ConfigurationError, PortUrlError)) as caught:
        open_port(link)
    assert caught.value.key == key


def test_a_model_without_simulated_drive_is_reported_with_near_names_and_the_list() -> None:
    """The message named 15 of 107 models."""
    with pytest.raises(ConfigurationError) as caught:
        open_port("sim://gd11@1")
    assert "gd10" in caught.value.params["near"]
    for language in ("en", "zh"):
        assert "`drivebus models`" in caught.value.text(language) and "gd10" in caught.value.text(language)
    with pytest.raises(ConfigurationError) as caught:
        open_port("sim://zzzzzzzzzzzz@1")
    assert caught.value.params["near"] == ("c320", "c300", "e300", "e350"), "an example, where no name is near"
