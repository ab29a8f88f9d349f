"""Registers that a drive gives only as a whole block, and parameters whose address decides whether a write is saved."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from drivebus import profiles
from drivebus.commissioning.decode.modbus import describe
from drivebus.commissioning.profile_simulator import ProfileStation
from drivebus.drives import create_dialect
from drivebus.profiles.model import DriveProfile, WriteSupport
from drivebus.protocols import modbus
from drivebus.protocols.codec import Effect
from drivebus.protocols.modbus import ReadRegisters

TWIN = 0xF000  # F00AH saves, 000AH does not


def blocked() -> DriveProfile:
    """Return the NowForever as if it gave 0503H to 0507H only as a whole."""
    profile = profiles.load("nowforever_d100")
    assert profile.modbus is not None
    return replace(profile, modbus=replace(profile.modbus, blocks=((0x0503, 5),)))


BLOCK = ReadRegisters(1, 0x0503, 5)


def test_every_read_of_a_register_of_a_block_is_a_read_of_all_of_it() -> None:
    dialect: Any = create_dialect(blocked(), 1)
    reads = [request for request, _ in dialect.polls(("output_frequency", "output_current", "temperature"))]
    assert reads == [ReadRegisters(1, 0x0500, 1), ReadRegisters(1, 0x0502, 1), BLOCK]
    whole = modbus.RegisterValues(1, 3, (12, 2300, 310, 0, 41))
    found = {name: reading.value for name, reading in dialect.decode_readings(BLOCK, whole, 1.0).items()}
    assert found == {"output_current": 1.2, "output_voltage": 230.0, "dc_bus_voltage": 310.0, "temperature": 41.0}


def test_a_state_in_a_block_is_read_with_all_of_it() -> None:
    profile = blocked()
    assert profile.modbus is not None
    whole = replace(profile, modbus=replace(profile.modbus, loopback=True, blocks=((0x0500, 8),)))
    dialect: Any = create_dialect(whole, 1)
    block = ReadRegisters(1, 0x0500, 8)
    assert dialect.state_reads() == dialect.setpoint_reads() == (block,)
    assert dialect.echo_test_read() == dialect.model_check() == block
    assert [request for request, _ in dialect.polls(("temperature",))] == [block]
    assert dialect.polls(("temperature",))[0][1] == 0.5  # as often as the state


def test_no_sync_probe_reads_a_part_of_a_block() -> None:
    dialect: Any = create_dialect(blocked(), 1)
    assert {dialect.station_config.sync_request(n) for n in range(8)} == {ReadRegisters(1, 0x0500, 2)}


def test_a_block_keeps_its_size_beside_registers_that_touch_it() -> None:
    profile = blocked()
    beside = replace(profile.signals["temperature"], name="beside", locator=("holding", 0x0508))
    dialect: Any = create_dialect(replace(profile, signals={**profile.signals, "beside": beside}), 1)
    reads = [request for request, _ in dialect.polls(("temperature", "beside"))]
    assert reads == [ReadRegisters(1, 0x0500, 1), BLOCK, ReadRegisters(1, 0x0508, 1)]


@pytest.mark.parametrize(("register", "count", "answers"), [(0x0503, 5, True), (0x0503, 4, False), (0x0504, 1, False)])
def test_a_station_with_a_block_rejects_a_part_of_it(register: int, count: int, answers: bool) -> None:
    station = ProfileStation(1, profile=blocked())
    reply = station.handle_request(ReadRegisters(1, register, count), station.codecs[0])
    assert isinstance(reply, modbus.RegisterValues) is answers


def twin_profile() -> DriveProfile:
    """Return the MD380 map with its parameter P0-10 writable, saved or not by its address."""
    profile = profiles.load("skf8000")
    parameter = replace(profile.parameters["P0-10"], writable=True)
    support = WriteSupport(ram=True, eeprom=True, ram_address_mask=TWIN)
    parameters = {**profile.parameters, "P0-10": parameter}
    return replace(profile, parameters=parameters, write_support=support, setpoint_share=None)


@pytest.mark.parametrize(("save", "register"), [(True, 0xF00A), (False, 0x000A)])
def test_the_address_of_a_write_decides_whether_it_is_saved(save: bool, register: int) -> None:
    """Each write to EEPROM wears it."""
    profile = twin_profile()
    dialect: Any = create_dialect(profile, 1)
    request = dialect.write_parameter(profile.parameters["P0-10"], 6000, save=save).request
    assert request == modbus.WriteRegister(1, register, 6000)
    frame = dialect.codec.encode_request(request)
    assert dialect.effect(frame) is Effect.SETTING and dialect.is_allowed(frame)
    assert dialect.read_parameter(profile.parameters["P0-10"]).register == 0xF00A
    station = ProfileStation(1, profile=profile)
    assert isinstance(station.handle_request(request, station.codecs[0]), modbus.WriteAck)
    assert (station.memory.ram[0xF00A], station.memory.eeprom_writes[0xF00A]) == (6000, int(save))


def test_a_ram_address_of_no_parameter_may_be_anything() -> None:
    dialect: Any = create_dialect(twin_profile(), 1)
    for register in (0x000B, 0x100A, 0x00FA):
        frame = dialect.codec.encode_request(modbus.WriteRegister(1, register, 1))
        assert dialect.effect(frame) is Effect.MOTION and not dialect.is_allowed(frame)


@pytest.mark.parametrize(("register", "saves"), [(0xF00A, True), (0x000A, None)])
def test_a_described_write_says_whether_it_is_saved(register: int, saves: bool | None) -> None:
    frame = modbus.ModbusRtuCodec().encode_request(modbus.WriteRegister(1, register, 6000))
    fields = describe(twin_profile(), frame, "rtu", "request", None).fields
    assert (fields["frequency_hz"], fields.get("saves")) == (60.0, saves)
