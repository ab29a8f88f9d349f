"""Mitsubishi computer link: printed frames, the effect of every run command, late replies, one story on four lines."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from drivebus import i18n, profiles
from drivebus.bus import Bus
from drivebus.bus.messages import BusRequest
from drivebus.commissioning.decode.describe import describe_frame
from drivebus.drives import Drive, create_dialect
from drivebus.drives.outcome import OutcomeStatus
from drivebus.drives.state import Direction, DriveState
from drivebus.errors import (
    AddressError,
    CapabilityError,
    ChecksumError,
    CodeError,
    DrivebusError,
    DriveRejected,
    EchoError,
    HeaderError,
    ProtocolError,
    StartInhibited,
)
from drivebus.families.mitsubishi import codec as fr
from drivebus.families.mitsubishi.codec import MitsubishiCodec, MitsubishiReply, MitsubishiRequest
from drivebus.ports import open_port
from drivebus.protocols.codec import Complete, Effect
from drivebus.simulator.motor import Trip
from drivebus.testing.virtual_time import run

CODEC = MitsubishiCodec()


def test_the_reply_printed_in_the_fr_f500_manual_has_the_computed_sum() -> None:
    """FR-F500 manual, page 114: the reply 1770H of station 1; the request's sum is that of its printed characters."""
    printed = bytes.fromhex("02 30 31 31 37 37 30 03 33 30")
    request = MitsubishiRequest(1, fr.OUTPUT_FREQUENCY)
    assert CODEC.decode_reply(request, printed) == Complete(MitsubishiReply(1, 0x1770, 4), 10)
    assert CODEC.encode_reply(MitsubishiReply(1, 0x1770, 4)) == printed
    assert sum(b"01E1107AD") & 0xFF == 0xF4


def test_a_program_that_runs_these_drives_sends_the_same_frames() -> None:
    """LinuxCNC mitsub_vfd.py for station 01: ENQ, station, code, 1, data, sum of the characters."""
    for request, text in (
        (MitsubishiRequest(1, 0xFA, 0x02), b"01FA102"),
        (MitsubishiRequest(1, 0xFA, 0x04), b"01FA104"),
        (MitsubishiRequest(1, 0xFA, 0x00), b"01FA100"),
        (MitsubishiRequest(1, 0xED, 2500), b"01ED109C4"),
        (MitsubishiRequest(1, 0x7A), b"017A1"),
        (MitsubishiRequest(1, 0x6F), b"016F1"),
    ):
        assert CODEC.encode_request(request) == b"\x05" + text + b"%02X" % (sum(text) & 0xFF)


def test_of_all_run_commands_only_00h_is_a_stop_and_only_the_explained_ones_get_a_permit() -> None:
    dialect = Drive(Bus(open_port("sim://fr_e500@3")), profiles.load("fr_e500"), 3).dialect
    frames = {value: CODEC.encode_request(MitsubishiRequest(3, fr.RUN_COMMAND, value)) for value in range(256)}
    effects = {value: fr.frame_effect(frame) for value, frame in frames.items()}
    assert [value for value, effect in effects.items() if effect is Effect.STOP] == [0x00]
    assert set(effects.values()) == {Effect.STOP, Effect.MOTION}
    assert [value for value, frame in frames.items() if dialect.is_allowed(frame)] == [0x00, 0x02, 0x04]


@pytest.mark.parametrize("code", [fr.STATUS, fr.OUTPUT_FREQUENCY])
@pytest.mark.parametrize("earlier_probes", [0, 1])
def test_a_sync_probe_differs_in_length_from_an_unanswered_read(code: int, earlier_probes: int) -> None:
    """A probe with as many digits as the missing reply proved nothing, and the drive was not read for 5 s."""

    async def play() -> float:
        port: Any = open_port("sim://fr_e500@3")
        async with Bus(port) as bus:
            drive, station = Drive(bus, profiles.load("fr_e500"), 3), port.simulated_bus.stations[0]
            read = BusRequest(station=3, request=MitsubishiRequest(3, code))
            await bus.transact(read)
            bus.core.stations[3].sync_probe_count = earlier_probes
            station.faults.mute = True
            asyncio.get_running_loop().call_later(0.1, setattr, station.faults, "mute", False)
            began = asyncio.get_running_loop().time()
            assert (await bus.transact(read)).error is None
            drive.close()
            return asyncio.get_running_loop().time() - began

    assert run(play()) < 2.0


def test_a_reply_of_another_form_station_or_sum_is_rejected() -> None:
    read, write = MitsubishiRequest(1, fr.OUTPUT_FREQUENCY), MitsubishiRequest(1, fr.SET_FREQUENCY, 100)
    for request_, form in ((read, MitsubishiReply(1)), (write, MitsubishiReply(1, 0, 4))):
        with pytest.raises(EchoError) as caught:
            CODEC.decode_reply(request_, CODEC.encode_reply(form))
        assert caught.value.key == "mitsubishi.reply_form"
    with pytest.raises(HeaderError) as other:
        CODEC.decode_reply(read, CODEC.encode_request(read))
    assert other.value.key == "mitsubishi.reply_header"
    with pytest.raises(CodeError) as unknown:
        CODEC.decode_request(bytes((fr.ENQ,)) + b"01550")
    assert unknown.value.key == "mitsubishi.code"
    with pytest.raises(ProtocolError):
        CODEC.decode_reply(read, CODEC.encode_reply(MitsubishiReply(1, 0x82, 2)) + b"\x06\x30")
    with pytest.raises(AddressError):
        CODEC.decode_reply(write, CODEC.encode_reply(MitsubishiReply(2)))
    with pytest.raises(ChecksumError):
        CODEC.decode_reply(read, bytes.fromhex("02 30 31 31 37 37 31 03 33 30"))


@asynccontextmanager
async def simulated_drive(quality: str) -> AsyncIterator[tuple[Drive, Any]]:
    port: Any = open_port(f"sim://fr_e500@3?line_quality={quality}&ramp=2")
    async with Bus(port) as bus:
        yield Drive(bus, profiles.load("fr_e500"), 3), port.simulated_bus.stations[0]


async def until_confirmed(action: Any, *statuses: OutcomeStatus) -> None:
    """Repeat as a user would on a line that loses frames."""
    for _ in range(20):
        try:
            if (await action()).status in (statuses or (OutcomeStatus.CONFIRMED,)):
                return
        except DrivebusError:
            await asyncio.sleep(1)
    raise AssertionError("not confirmed in twenty tries")


@pytest.mark.parametrize("quality", ["clean", "bytes", "loss=0.03", "late=0.02:0.3"])
def test_the_motor_does_what_was_confirmed_on_a_line_of_any_quality(quality: str) -> None:
    async def play() -> None:
        async with simulated_drive(quality) as (drive, station):

            async def output_hz() -> float:
                await asyncio.sleep(3)
                station.advance(asyncio.get_running_loop().time())
                found: float = station.motor.output_hz
                return found

            await until_confirmed(lambda: drive.run(20.0))
            assert await output_hz() == pytest.approx(20.0)
            await until_confirmed(lambda: drive.set_frequency(12.34), OutcomeStatus.ACKNOWLEDGED)
            assert await output_hz() == pytest.approx(12.34)
            await until_confirmed(drive.stop)
            await output_hz()
            assert not station.motor.energised
            await until_confirmed(lambda: drive.run(10.0, Direction.REVERSE))
            assert await output_hz() == pytest.approx(-10.0)
            await until_confirmed(drive.stop)

    run(play())


def test_a_trip_is_a_fault_without_a_number_and_forbids_a_start() -> None:
    async def play() -> None:
        async with simulated_drive("clean") as (drive, station):
            await drive.run(20.0)
            await asyncio.sleep(3)
            station.trip(Trip.OVERCURRENT_RUNNING)
            status = await drive.status()
            assert status.state is DriveState.FAULT and status.fault is not None
            with pytest.raises(StartInhibited):
                await drive.run(20.0)
            with pytest.raises(CapabilityError):
                await drive.reset_fault()

    run(play())


def test_a_drive_in_another_operation_mode_rejects_the_frequency_and_is_not_started() -> None:
    async def play() -> None:
        async with simulated_drive("clean") as (drive, station):
            station.keypad_set(79, 2)
            with pytest.raises(DriveRejected) as rejected:
                await drive.run(20.0)
            assert "Pr.79" in rejected.value.text("en") and "Pr.79" in rejected.value.text("zh")
            assert station.motor.starts == 0

    run(play())


@pytest.mark.parametrize(("language", "moves"), [("en", "may start the motor"), ("zh", "可能启动")])
def test_a_reverse_start_is_described_with_its_hazard(language: str, moves: str) -> None:
    found = describe_frame("fr_e500", CODEC.encode_request(MitsubishiRequest(4, fr.RUN_COMMAND, fr.RUN_REVERSE)))
    assert (found.valid, found.fields["name"]) == (True, "run_reverse")
    ((key, params),) = found.hazards
    assert key == "mitsubishi.moves" and moves in i18n.text(key, language, **params)
    stop = MitsubishiRequest(4, fr.RUN_COMMAND, fr.STOP)
    assert describe_frame("fr_e500", CODEC.encode_request(stop)).hazards == ()
    reply = describe_frame("fr_e500", bytes.fromhex("02 30 31 31 37 37 30 03 33 30"))
    assert reply.fields["data"] == 0x1770


@pytest.mark.parametrize(
    ("error", "key"),
    [
        (0xA, "mitsubishi.error_a"),
        (0xB, "mitsubishi.error_b"),
        (0xC, "mitsubishi.error_c"),
        (0x1, "mitsubishi.error"),
    ],
)
def test_each_error_code_has_its_own_sentence_and_another_one_its_number(error: int, key: str) -> None:
    dialect = create_dialect(profiles.load("fr_a500"), 1)
    rejection = dialect.rejection(MitsubishiReply(1, error=error))
    assert rejection is not None and (rejection.key, rejection.code) == (key, error)
    assert dialect.rejection(MitsubishiReply(1)) is None


def test_a_station_that_no_drive_can_have_is_named() -> None:
    frame = CODEC.encode_request(MitsubishiRequest(31, fr.STATUS))
    body = b"20" + frame[3:-2]
    with pytest.raises(AddressError) as caught:
        CODEC.decode_request(frame[:1] + body + f"{sum(body) & 0xFF:02X}".encode())
    assert (caught.value.key, caught.value.params["found"]) == ("mitsubishi.station", 32)
