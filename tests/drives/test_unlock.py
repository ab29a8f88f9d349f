"""Drives that reject every command until they are unlocked, as Lenze's: in a start, and in a stop that needs it."""

from __future__ import annotations

import asyncio
from contextlib import AbstractAsyncContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drivebus import profiles
from drivebus.commissioning.decode.modbus import describe
from drivebus.commissioning.profile_simulator import ProfileStation
from drivebus.drives.bus_stop import stop_bus
from drivebus.drives.dialects.create import create_dialect
from drivebus.drives.drive import Drive
from drivebus.drives.operations import start
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.steps import DriveOperation
from drivebus.drives.outcome import OutcomeStatus
from drivebus.errors import DrivebusError, ProfileError, StartInhibited, StopUnconfirmed
from drivebus.profiles.model import DriveProfile
from drivebus.profiles.words import CommandMap, FixedWrite
from drivebus.protocols import modbus
from drivebus.protocols.codec import Effect
from drivebus.protocols.modbus import ReadRegisters, WriteRegister
from drivebus.simulator.motor import Trip
from drivebus.testing.virtual_time import run
from fixtures.profile_bench import Write, profile_bench

COMMAND, SETPOINT, UNLOCK = 1, 40, 48
FORWARD, START, STOP = 0x0080, 0x0008, 0x0004


def bench(profile: DriveProfile | None = None) -> AbstractAsyncContextManager[tuple[Drive, Any, list[Write]]]:
    """Return the bench of an smd, or of another profile."""
    return profile_bench(profile or profiles.load("smd"))


def run_from_its_keypad(station: Any) -> None:
    """Start the motor as the keypad does: the bus stays locked out."""
    station.run_towards(20.0)
    assert station.is_locked


def test_a_start_unlocks_first_and_starts_last() -> None:
    async def scenario() -> None:
        async with bench() as (drive, station, writes):
            assert (await drive.run(10.0)).status is OutcomeStatus.CONFIRMED
            assert writes == [(UNLOCK, 0), (COMMAND, FORWARD), (SETPOINT, 100), (COMMAND, START)]
            await asyncio.sleep(2)
            assert station.motor.output_hz == pytest.approx(10.0, abs=0.1)

    run(scenario())


def test_a_locked_drive_rejects_the_start_word_so_that_the_order_matters() -> None:
    station = ProfileStation(1, profile=profiles.load("smd"))
    for word in (START, STOP):
        reply = station.handle_request(WriteRegister(1, COMMAND, word), station.codecs[0])
        assert reply == modbus.ExceptionReply(1, 6, 1)
    assert not station.motor.energised


@pytest.mark.parametrize(("refused", "named"), [((UNLOCK, 0), "0030H = 0000H"), ((COMMAND, FORWARD), "0080H")])
def test_what_the_drive_rejects_before_a_start_ends_it(refused: Write, named: str) -> None:
    async def scenario() -> None:
        async with bench() as (drive, station, writes):
            reject(station, refused)
            with pytest.raises(StartInhibited, match=f"rejected {named}.*code 4"):
                await drive.run(10.0)
            assert writes[-1] == refused and not station.motor.energised

    run(scenario())


def test_an_unlock_without_a_reply_ends_the_start() -> None:
    """No status shows that the drive took it."""

    async def scenario() -> None:
        async with bench() as (drive, station, writes):
            handle = station.handle_request
            station.handle_request = lambda message, codec: (
                None if isinstance(message, WriteRegister) else handle(message, codec)
            )
            with pytest.raises(DrivebusError):
                await drive.run(10.0)
            assert set(writes) == {(UNLOCK, 0)} and not station.motor.energised

    run(scenario())


def test_nothing_is_unlocked_for_a_start_that_may_not_follow() -> None:
    async def scenario() -> None:
        async with bench() as (drive, station, writes):
            drive.bus.inhibit_start()
            with pytest.raises(StartInhibited):
                await drive.run(10.0)
            assert writes == [] and station.is_locked

    run(scenario())


def test_the_start_word_gets_no_permit_before_the_unlock(monkeypatch: pytest.MonkeyPatch) -> None:
    """The gate itself refuses it, if an operation leaves out what goes before."""

    def leave_out(op: OperationContext) -> DriveOperation[None]:
        yield from op.check_deadline()

    monkeypatch.setattr(start, "prepare_start", leave_out)

    async def scenario() -> None:
        async with bench() as (drive, _, writes):
            with pytest.raises(StartInhibited, match="does not allow a start yet"):
                await drive.run(10.0)
            assert writes == []

    run(scenario())


def test_a_stop_of_an_unlocked_drive_waits_for_no_unlock() -> None:
    async def scenario() -> None:
        async with bench() as (drive, station, writes):
            await drive.run(10.0)
            writes.clear()
            assert (await drive.stop()).status is OutcomeStatus.CONFIRMED
            assert writes[0] == (COMMAND, STOP) and (UNLOCK, 0) not in writes
            assert not station.motor.energised

    run(scenario())


def test_a_stop_that_a_locked_drive_rejects_is_sent_again_after_an_unlock() -> None:
    async def scenario() -> None:
        async with bench() as (drive, station, writes):
            run_from_its_keypad(station)
            assert (await drive.stop()).status is OutcomeStatus.CONFIRMED
            assert writes[:3] == [(COMMAND, STOP), (UNLOCK, 0), (COMMAND, STOP)]
            assert not station.motor.energised

    run(scenario())


def test_a_stop_that_needed_the_unlock_counts_as_answered() -> None:
    async def scenario() -> None:
        async with bench() as (drive, station, writes):
            run_from_its_keypad(station)
            outcome = await drive.stop(wait=False)
            assert outcome.key == "drives.stop_answered" and writes[:3] == [
                (COMMAND, STOP),
                (UNLOCK, 0),
                (COMMAND, STOP),
            ]

    run(scenario())


def test_a_stop_of_all_unlocks_although_no_start_is_permitted() -> None:
    async def scenario() -> None:
        async with bench() as (drive, station, _):
            run_from_its_keypad(station)
            assert (await stop_bus(drive.bus, [drive])).confirmed
            assert not station.motor.energised

    run(scenario())


@pytest.mark.parametrize("silent", [False, True])
def test_the_stop_is_sent_again_whatever_becomes_of_the_unlock(silent: bool) -> None:
    async def scenario() -> None:
        async with bench() as (drive, station, writes):
            run_from_its_keypad(station)
            reject(station, (UNLOCK, 0), silent=silent)
            with pytest.raises(StopUnconfirmed) as caught:
                await drive.stop()
            assert caught.value.outcome.key == "drives.stop_rejected_running"
            assert (COMMAND, STOP) in writes[writes.index((UNLOCK, 0)) :]

    run(scenario())


def test_a_reset_is_preceded_by_the_unlock_of_its_model() -> None:
    profile = with_commands(reset=FixedWrite(70, 1))
    profile = replace(profile, capabilities=profile.capabilities | {"reset_fault"})

    async def scenario() -> None:
        async with bench(profile) as (drive, station, writes):
            station.trip(Trip.OVERLOAD)
            assert (await drive.reset_fault()).status is OutcomeStatus.CONFIRMED
            assert writes == [(UNLOCK, 0), (70, 1)]

    run(scenario())


def test_only_the_unlock_itself_needs_no_permit() -> None:
    dialect: Any = create_dialect(profiles.load("smd"), 1)

    def effect(*writes: Write) -> Effect:
        register, words = writes[0][0], tuple(word for _, word in writes)
        request = WriteRegister(1, register, words[0]) if len(words) == 1 else modbus.WriteRegisters(1, register, words)
        found: Effect = dialect.effect(dialect.codec.encode_request(request))
        return found

    assert effect((UNLOCK, 0)) is Effect.STOP
    assert {effect((UNLOCK, word)) for word in range(1, 0x10000)} == {Effect.MOTION}
    assert effect((UNLOCK, 0), (UNLOCK + 1, 0)) is Effect.MOTION
    assert effect((COMMAND, FORWARD)) is Effect.SETTING and effect((COMMAND, START)) is Effect.MOTION


def test_the_unlock_is_named_in_a_decoded_frame() -> None:
    frame = modbus.ModbusRtuCodec().encode_request(WriteRegister(1, UNLOCK, 0))
    assert describe(profiles.load("smd"), frame, "rtu", "request", None).fields["commands"] == ["unlock"]


def test_every_read_is_the_block_or_one_register_and_function_4_reads_the_block_as_the_sync_probe() -> None:
    """The drive gives no two neighbouring registers, whose read is the sync probe elsewhere."""
    profile = profiles.load("smd")
    dialect: Any = create_dialect(profile, 1)
    probe = ReadRegisters(1, 24, 6, 4)
    assert {dialect.station_config.sync_request(n) for n in range(4)} | {dialect.sync_request()} == {probe}
    assert [request for request, _ in dialect.polls(tuple(profile.signals))] == [ReadRegisters(1, 24, 6)]
    station = ProfileStation(1, profile=profile)
    replies = [station.handle_request(read, station.codecs[0]) for read in (probe, ReadRegisters(1, 24, 6))]
    assert replies[0].values == replies[1].values and replies[0].function == 4
    refused = [ReadRegisters(1, 24, 5), ReadRegisters(1, 26, 1, 4), ReadRegisters(1, 25, 6, 4)]
    assert all(isinstance(station.handle_request(read, station.codecs[0]), modbus.ExceptionReply) for read in refused)


STANDS = "{ mask = 15, value = 3 }"
ALONE = """
format = 1
extends = "smd"
"""


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        (f"[commands]\nready = {STANDS}\n[[commands.preparation]]\nword = 1\nwhen = {STANDS}\n", "preparation_parts"),
        (f"[commands]\nready = {STANDS}\n[[commands.preparation]]\nword = 1\nuntil = {STANDS}\n", "preparation_parts"),
        (f"[[commands.preparation]]\nword = 1\nwhen = {STANDS}\nuntil = {STANDS}\n", "preparation_parts"),
        (f"[commands]\nready = {STANDS}\n", "preparation_parts"),
        ("[[commands.preparation]]\nword = 8\n", "preparation_moves"),
        ("[commands]\nunlock = { register = 1, value = 0 }\n", "duplicate"),
        ("[commands]\nunlock = { register = 40, value = 0 }\n", "duplicate"),
        ("[parameters.P48]\nregister = 48\ntext = 'x'\nevidence = 'assumed'\n", "duplicate"),
        ("[modbus]\nsync_block = [24, 5]\n", "choice"),
        ("[modbus]\nfunctions = [3, 6]\n", "access"),
        ("[modbus]\nfunctions = [3, 4, 6, 8]\nloopback = true\n", "no_effect_beside"),
        ("[modbus]\nrejected_read = 7\n", "no_effect_beside"),
    ],
)
def test_a_profile_whose_unlock_or_sync_block_can_not_work_is_rejected(tmp_path: Path, text: str, kind: str) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text(ALONE + text, encoding="utf-8")
    with pytest.raises(ProfileError) as caught:
        profiles.load(path)
    assert kind in [diagnostic.kind for diagnostic in caught.value.params["diagnostics"]]


def with_commands(**changes: Any) -> DriveProfile:
    profile = profiles.load("smd")
    commands: CommandMap | None = profile.commands
    assert commands is not None
    return replace(profile, commands=replace(commands, **changes))


def reject(station: Any, refused: Write, *, silent: bool = False) -> None:
    """Let the station reject one write with exception 4, or leave it without a reply."""
    handle = station.handle_request

    def answer(message: Any, codec: Any) -> Any:
        if isinstance(message, WriteRegister) and (message.register, message.value) == refused:
            return None if silent else modbus.ExceptionReply(1, 6, 4)
        return handle(message, codec)

    station.handle_request = answer
