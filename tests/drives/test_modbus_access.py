"""Reads and writes of Modbus models: spaces, coils, numbers in two registers, and sync probes beside all of them."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Any

import pytest

from drivebus import profiles
from drivebus.bus import Bus
from drivebus.drives import Drive, create_dialect
from drivebus.drives.dialects.base import StopMode
from drivebus.drives.state import Direction, DriveState
from drivebus.errors import LengthError, ProtocolError
from drivebus.ports import open_port
from drivebus.protocols import modbus
from drivebus.protocols.codec import Complete, Effect
from drivebus.protocols.modbus import ReadBits, ReadRegisters, RegisterValues
from drivebus.simulator.models.catalog import make_station
from drivebus.testing.virtual_time import run
from drives.test_simulated_profiles import settle, simulated_drive


def dialect_of(model: str, **changes: Any) -> Any:
    return create_dialect(replace(profiles.load(model), **changes), 1, encoding="rtu")


def frame_of(dialect: Any, request: Any) -> bytes:
    frame: bytes = dialect.codec.encode_request(request)
    return frame


# --- reads ---------------------------------------------------------------------------------------------------------

UNNUMBERED = [
    name
    for name in profiles.models()
    if (profile := profiles.load(name)).family == "modbus" and profile.modbus and not profile.modbus.loopback
]


def every_read(dialect: Any) -> list[Any]:
    profile = dialect.profile
    reads = [request for request, _ in dialect.polls(tuple(profile.signals))]
    reads += [request for name in profile.signals for request, _ in dialect.polls((name,))]
    reads += [*dialect.fault_reads(), *dialect.setpoint_reads(), dialect.echo_test_read()]
    reads += [dialect.read_parameter(parameter) for parameter in profile.parameters.values() if parameter.readable]
    return [*reads, *filter(None, [dialect.model_check()])]


@pytest.mark.parametrize("model", UNNUMBERED)
def test_no_late_reply_to_another_read_passes_for_that_to_a_sync_probe(model: str) -> None:
    """A reply names neither register nor value; only its function and its length tell it from another one."""
    dialect: Any = create_dialect(profiles.load(model), 1)
    probes = [dialect.station_config.sync_request(n) for n in range(4)]
    for read in every_read(dialect):
        kind = modbus.BitValues if isinstance(read, ReadBits) else RegisterValues
        late = dialect.codec.encode_reply(kind(1, read.function, (0,) * read.count))
        for probe in probes:
            with pytest.raises(ProtocolError):
                result = dialect.codec.decode_reply(probe, late)
                assert not isinstance(result, Complete), f"{read} answers {probe}"
                raise ProtocolError("bus.incomplete")  # more bytes are awaited: no reply either


@pytest.mark.parametrize("request_of", [ReadRegisters, ReadBits])
def test_a_read_of_any_space_waits_for_a_sync_probe(request_of: Any) -> None:
    assert dialect_of("h100").needs_sync(request_of(1, 0, 1, 4 if request_of is ReadRegisters else 1))


def test_a_model_with_input_registers_alone_is_probed_with_their_function() -> None:
    assert dialect_of("h100").sync_request() == ReadRegisters(1, 0, 2, 4)


def test_input_registers_and_holding_registers_of_one_number_are_not_mixed_up() -> None:
    dialect = dialect_of("h100")
    holding = dialect.decode_readings(ReadRegisters(1, 0, 1, 3), RegisterValues(1, 3, (123,)), 1.0)
    inputs = dialect.decode_readings(ReadRegisters(1, 0, 1, 4), RegisterValues(1, 4, (123,)), 1.0)
    assert holding == {} and inputs["output_frequency"].value == 12.3
    assert frame_of(dialect, dialect.read_parameter(dialect.profile.parameters["F005"]))[1] == 3


def test_every_value_is_right_on_a_line_whose_replies_come_late() -> None:
    """F005 reads 400.0 Hz and F011 reads 5.0 Hz: one in the place of the other would show."""

    async def tell() -> None:
        async with simulated_drive("h100", quality="late=0.3:0.4") as (drive, station):
            station.keypad_set(5, 4000)
            station.keypad_set(11, 50)
            seen: dict[str, set[Any]] = {"F005": set(), "F011": set(), "output_frequency": set()}
            for _ in range(60):
                for name, reading in (await drive.read(list(seen))).items():
                    seen[name] |= {reading.value} if reading.value is not None else set()
                await asyncio.sleep(0.5)
            assert seen == {"F005": {400.0}, "F011": {5.0}, "output_frequency": {0.0}}

    run(tell())


def test_a_number_in_two_registers_is_read_in_one_frame() -> None:
    dialect = dialect_of("wj200")
    reads = [request for request, _ in dialect.polls(("output_frequency", "output_current"))]
    assert ReadRegisters(1, 0x1000, 3) in reads and ReadBits(1, 0x000E, 10) in reads
    found = dialect.decode_readings(ReadRegisters(1, 0x1000, 3), RegisterValues(1, 3, (1, 0x86A0, 250)), 1.0)
    assert (found["output_frequency"].value, found["output_current"].value) == (1000.0, 2.5)
    half = dialect.decode_readings(ReadRegisters(1, 0x1000, 1), RegisterValues(1, 3, (1,)), 1.0)
    assert "output_frequency" not in half


def test_the_word_order_of_a_model_decides_which_register_is_high() -> None:
    rule = profiles.load("wj200").modbus
    assert rule is not None
    dialect = dialect_of("wj200", modbus=replace(rule, word_order="low_first"))
    found = dialect.decode_readings(ReadRegisters(1, 0x1000, 2), RegisterValues(1, 3, (0x86A0, 1)), 1.0)
    assert found["output_frequency"].value == 1000.0
    assert dialect.set_frequency(100_000, None)[0].request.values == (0x86A0, 1)


@pytest.mark.parametrize(
    ("bits", "state"),
    [(0x0004, DriveState.STOPPED), (0x0005, DriveState.RUNNING), (0x0200, DriveState.FAULT), (0, DriveState.NOT_READY)],
)
def test_coils_are_the_bits_of_a_status_word(bits: int, state: DriveState) -> None:
    """The WJ200 has its state in the coils 000FH to 0018H."""
    from drivebus.drives.dialects.status_word import status_state

    dialect = dialect_of("wj200")
    reply = modbus.BitValues(1, 1, tuple(bool(bits >> place & 1) for place in range(10)))
    raw = dialect.decode_readings(ReadBits(1, 0x000E, 10), reply, 1.0)["state"].raw
    assert raw == bits and status_state(dialect.status_map, raw) is state


# --- writes --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("made", "frame"),
    [
        (lambda d: d.start(Direction.FORWARD, 0)[0].request, "010f000000040101"),
        (lambda d: d.start(Direction.REVERSE, 0)[0].request, "010f000000040103"),
        (lambda d: d.stop(StopMode.STOP)[0], "010f000000040100"),
        (lambda d: d.reset()[0].request, "010f000000040108"),
        (lambda d: d.broadcast_stop()[0], "000f000000040100"),
        (lambda d: d.set_frequency(5000, None)[0].request, "0110000000020400001388"),
    ],
)
def test_a_wj200_is_commanded_by_four_coils_and_two_registers_in_one_frame_each(made: Any, frame: str) -> None:
    dialect = dialect_of("wj200")
    assert frame_of(dialect, made(dialect))[:-2].hex() == frame


@pytest.mark.parametrize(
    ("made", "frame"),
    [
        (lambda d: d.start(Direction.FORWARD, 0)[0].request, "01050049ff00"),
        (lambda d: d.start(Direction.REVERSE, 0)[0].request, "0105004aff00"),
        (lambda d: d.stop(StopMode.STOP)[0], "0105004bff00"),
    ],
)
def test_an_h100_is_commanded_by_one_coil_each(made: Any, frame: str) -> None:
    dialect = dialect_of("h100")
    assert frame_of(dialect, made(dialect))[:-2].hex() == frame


WJ200_EFFECTS = [
    (modbus.WriteBits(1, 0, (False, False, False, False)), Effect.STOP),
    (modbus.WriteBits(1, 0, (False, False, False, True)), Effect.SETTING),
    (modbus.WriteBits(1, 0, (True, False, False, False)), Effect.MOTION),
    (modbus.WriteBits(1, 0, (False, True, False, False)), Effect.MOTION),  # reverse alone: no command of the profile
    (modbus.WriteBits(1, 0, (False, False, True, False)), Effect.MOTION),  # external trip: not in the profile
    (modbus.WriteBits(1, 0, (False, False, False)), Effect.MOTION),  # not the whole command
    (modbus.WriteBits(1, 0, (False, False, False, False, True)), Effect.MOTION),  # a coil more
    (modbus.WriteBit(1, 0, False), Effect.MOTION),  # one coil of the command
    (modbus.WriteBit(1, 6, True), Effect.MOTION),  # an input terminal that may be wired to run
    (modbus.WriteRegisters(1, 0, (0, 5000)), Effect.SETTING),
    (modbus.WriteRegister(1, 0, 1), Effect.MOTION),  # the high half of the frequency alone: 655 Hz
    (modbus.WriteRegister(1, 1, 5000), Effect.MOTION),
    (modbus.WriteRegisters(1, 0, (0, 5000, 1)), Effect.MOTION),
    (ReadBits(1, 0, 16), Effect.NONE),
]


@pytest.mark.parametrize(("request_", "effect"), WJ200_EFFECTS)
def test_an_unknown_coil_or_half_a_number_may_move_the_motor_and_is_never_sent(request_: Any, effect: Effect) -> None:
    dialect = dialect_of("wj200")
    frame = frame_of(dialect, request_)
    assert dialect.effect(frame) is effect
    mapped = effect is not Effect.MOTION or getattr(request_, "values", ()) == (True, False, False, False)
    assert dialect.is_allowed(frame) is mapped


def test_the_worked_frame_of_the_maker_that_starts_the_drive_needs_a_permit() -> None:
    """WJ-C1 manual, 11.2.3: coil 0001H is address 0."""
    assert dialect_of("wj200").effect(bytes.fromhex("010500 00ff008c3a")) is Effect.MOTION


@pytest.mark.parametrize(
    ("coil", "value", "effect"),
    [
        (0x4B, True, Effect.STOP),
        (0x49, True, Effect.MOTION),
        (0x4B, False, Effect.MOTION),
        (0x48, True, Effect.MOTION),
        (0x4C, True, Effect.MOTION),
    ],
)
def test_only_the_stop_coil_of_an_h100_switched_on_is_a_stop(coil: int, value: bool, effect: Effect) -> None:
    dialect = dialect_of("h100")
    frame = frame_of(dialect, modbus.WriteBit(1, coil, value))
    assert dialect.effect(frame) is effect
    assert dialect.is_allowed(frame) is (value and coil in (0x49, 0x4A, 0x4B))


def test_a_station_with_coils_takes_the_whole_command_only() -> None:
    station: Any = make_station("wj200", 1)
    codec = station.codecs[0]
    refused = station.handle_request(modbus.WriteBit(1, 0, True), codec)
    assert isinstance(refused, modbus.ExceptionReply) and not station.motor.energised
    acknowledged = station.handle_request(modbus.WriteBits(1, 0, (True, False, False, False)), codec)
    assert acknowledged == modbus.WriteAck(1, 15, 0, 4)


def test_a_reset_in_a_register_of_its_own_is_no_command_word() -> None:
    """Delta: bit 1 of 2002H resets, bit 0 is an external fault."""
    dialect = dialect_of("ms300")
    (frame,) = dialect.reset()
    assert frame.request == modbus.WriteRegister(1, 0x2002, 2)
    assert dialect.effect(frame_of(dialect, frame.request)) is Effect.SETTING
    for other in (0, 1, 3):
        wrong = frame_of(dialect, modbus.WriteRegister(1, 0x2002, other))
        assert dialect.effect(wrong) is Effect.MOTION and not dialect.is_allowed(wrong)


@pytest.mark.parametrize(
    ("made", "values", "effect"),
    [
        (lambda d: d.start(Direction.FORWARD, 0)[0].request, (1, 0, 0, 0), Effect.MOTION),
        (lambda d: d.start(Direction.REVERSE, 0)[0].request, (1, 1, 0, 0), Effect.MOTION),
        (lambda d: d.stop(StopMode.STOP)[0], (0, 0, 0, 0), Effect.STOP),
        (lambda d: d.reset()[0].request, (0, 0, 0, 1), Effect.SETTING),
    ],
)
def test_a_gs2_gets_run_direction_fault_and_reset_in_one_frame(made: Any, values: Any, effect: Effect) -> None:
    """With a register for each, a reset could leave the run command standing, and a start the old direction."""
    dialect = dialect_of("gs2")
    request = made(dialect)
    assert request == modbus.WriteRegisters(1, 0x091B, values)
    assert dialect.effect(frame_of(dialect, request)) is effect


@pytest.mark.parametrize(
    "request_",
    [
        modbus.WriteRegister(1, 0x091B, 0),
        modbus.WriteRegister(1, 0x091C, 0),
        modbus.WriteRegister(1, 0x091E, 1),
        modbus.WriteRegisters(1, 0x091B, (0, 0, 0)),
        modbus.WriteRegisters(1, 0x091B, (1, 0, 0, 1)),
        modbus.WriteRegisters(1, 0x091C, (0, 0, 0, 0)),
    ],
)
def test_a_part_of_a_command_in_several_registers_is_never_sent(request_: Any) -> None:
    dialect = dialect_of("gs2")
    frame = frame_of(dialect, request_)
    assert dialect.effect(frame) is Effect.MOTION and not dialect.is_allowed(frame)


def test_a_command_register_that_reads_as_the_status_is_both() -> None:
    """Shihlin 1001H: a write of 2 runs forward, a read of 2 is no running drive."""

    async def tell() -> None:
        async with simulated_drive("shihlin_ss2") as (drive, station):
            assert (await drive.status()).state is DriveState.STOPPED
            assert (await drive.run(10.0, Direction.REVERSE)).succeeded
            assert station.command == 4
            codec = station.codecs[0]
            assert station.handle_request(ReadRegisters(3, 0x1001, 1), codec).values == (5,)

    run(tell())


def test_a_frequency_beyond_sixteen_bits_reaches_the_drive_whole() -> None:
    """700.00 Hz is 70000: one register alone would be 44.64 Hz."""

    async def tell() -> None:
        profile = profiles.load("wj200")
        fast = replace(profile, limits=replace(profile.limits, maximum_hz=1000.0))
        async with simulated_drive("wj200", profile=fast) as (drive, station):
            assert (await drive.run(10.0)).succeeded
            assert (await drive.set_frequency(700.0)).succeeded
            await settle(drive)
            assert station.setpoint_word == 70000

    run(tell())


@pytest.mark.parametrize("model", ["vf_s11", "vf_s15"])
def test_the_rejection_of_a_read_of_many_registers_proves_that_replies_are_current(model: str) -> None:
    """Such a drive reads one register at a time; exception 03 answers no other read of it."""
    dialect = dialect_of(model)
    probe = dialect.station_config.sync_request(0)
    assert probe == dialect.sync_request() == ReadRegisters(1, 0xFD01, dialect.profile.modbus.rejected_read)
    assert dialect.effect(frame_of(dialect, probe)) is Effect.NONE
    rejection = dialect.codec.encode_reply(modbus.ExceptionReply(1, 3, 3))
    reply = dialect.codec.decode_reply(probe, rejection).message
    assert dialect.is_valid_sync_reply(reply) and not dialect.is_valid_sync_reply(RegisterValues(1, 3, (0,)))
    for read in every_read(dialect):
        assert read.count == 1
        with pytest.raises(ProtocolError):
            dialect.codec.decode_reply(read, rejection)
    for other in (1, 2, 4):
        with pytest.raises(ProtocolError):
            dialect.codec.decode_reply(probe, dialect.codec.encode_reply(modbus.ExceptionReply(1, 3, other)))


def test_an_exception_is_no_sync_reply_of_a_model_that_reads_two_registers() -> None:
    assert not dialect_of("huanyang_h2a").is_valid_sync_reply(modbus.ExceptionReply(1, 3, 3))


def test_stations_of_both_reply_forms_are_read_on_one_bus() -> None:
    """The simulated stations share the receiver of their requests, not the form of their replies."""

    async def scenario() -> None:
        port: Any = open_port("sim://md500_plus@1+huanyang_h2a@2+skf8000@3?drives=9600-8N1&baud=9600&format=8N1")
        async with Bus(port) as bus:
            for address, model in ((1, "md500_plus"), (2, "huanyang_h2a"), (3, "skf8000")):
                status = await Drive(bus, profiles.load(model), address).status()
                assert status.state is DriveState.STOPPED, model

    run(scenario())


def test_a_reply_with_another_byte_count_than_the_profile_states_is_no_reply() -> None:
    """F9.05 changes it: no value is shown until the profile says so."""

    async def scenario() -> None:
        other = profiles.load("huanyang_h2a")
        assert other.modbus is not None
        wrong = replace(other, modbus=replace(other.modbus, reply_count_bytes=1))
        async with Bus(open_port("sim://huanyang_h2a@1?baud=19200&format=8E1")) as bus:
            assert (await Drive(bus, other, 1).status()).state is DriveState.STOPPED
        async with Bus(open_port("sim://huanyang_h2a@1?baud=19200&format=8E1")) as bus:
            with pytest.raises(LengthError):
                await Drive(bus, wrong, 1).status()

    run(scenario())
