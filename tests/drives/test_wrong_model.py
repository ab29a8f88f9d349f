"""A profile that is not the drive's: its stop may be the start of the drive, and must not be sent to it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest
from generator.command_collisions import collisions

from drivebus import profiles
from drivebus.bus import Bus
from drivebus.drives import Drive, create_dialect, stop_bus
from drivebus.drives.outcome import OutcomeStatus
from drivebus.drives.store import MemoryStore
from drivebus.errors import NoReply, StartInhibited, StopUnconfirmed
from drivebus.ports import open_port
from drivebus.protocols import modbus
from drivebus.simulator.models.catalog import make_station
from drivebus.testing.virtual_time import run

STOP_WORD = 0x0001  # of ms300; "run forward" on gd10 and skf8000


@asynccontextmanager
async def foreign_drive(model: str, simulated: str, **given: Any) -> AsyncIterator[tuple[Drive, Any]]:
    """Yield a drive of ``model`` at address 3, where a station of another model answers."""
    port: Any = open_port(f"sim://{simulated}@3?line_quality=clean")
    async with Bus(port) as bus:
        yield Drive(bus, model, 3, encoding="rtu", **given), port.simulated_bus.stations[0]


@pytest.mark.parametrize("simulated", ["gd10", "skf8000"])
def test_the_stop_of_one_model_does_not_start_another(simulated: str) -> None:
    """The motor of the simulated drive ran after ``stop --model ms300``; nothing says so but the motor."""

    async def scenario() -> None:
        async with foreign_drive("ms300", simulated) as (drive, station):
            with pytest.raises(StopUnconfirmed) as caught:
                await drive.stop()
            assert caught.value.outcome.key == "drives.stop_withheld"
            await asyncio.sleep(5)  # the stop is repeated: still no command word
            assert station.command == 0 and not station.motor.energised

    run(scenario())


@pytest.mark.parametrize("model", ["gd10", "galt_g200", "gd350"])
def test_the_stop_of_a_goodrive_does_not_start_an_enc_whose_states_read_the_same(model: str) -> None:
    """Word 5 runs an ENC in the direction that was set last (EDS800 manual, 10.7.1); no profile lists that command."""

    async def scenario() -> None:
        async with foreign_drive(model, "eds800") as (drive, station):
            with pytest.raises(StopUnconfirmed) as caught:
                await drive.stop()
            assert caught.value.outcome.key == "drives.stop_withheld"
            assert station.command == 0

    run(scenario())


def test_a_stop_of_all_broadcasts_no_number_before_every_drive_has_answered_as_its_model() -> None:
    async def scenario() -> None:
        async with foreign_drive("ms300", "gd10") as (drive, station):
            report = await stop_bus(drive.bus, [drive])
            assert report.broadcasts == () and report.unconfirmed == (3,)
            assert station.command == 0 and not station.motor.energised
        async with foreign_drive("gd10", "gd10") as (drive, _):
            assert (await stop_bus(drive.bus, [drive])).broadcasts == ()
            again = await stop_bus(drive.bus, [drive])
            assert len(again.broadcasts) == 2 and again.confirmed

    run(scenario())


def test_a_drive_that_has_answered_as_its_model_is_stopped_at_once_by_the_first_frame() -> None:
    async def scenario() -> None:
        async with foreign_drive("gd10", "gd10") as (drive, station):
            await drive.run(10.0)
            stopped = await drive.stop()
            assert stopped.status is OutcomeStatus.CONFIRMED and station.command == 5
            assert stopped.exchanges[0].sent[1] == modbus.WriteRegister.function

    run(scenario())


def test_the_first_stop_to_a_drive_waits_for_the_reads_of_status_and_identity() -> None:
    async def scenario() -> None:
        async with foreign_drive("gd10", "gd10") as (drive, station):
            stopped = await drive.stop()
            assert [each.sent[1] for each in stopped.exchanges[:3]] == [3, 3, modbus.WriteRegister.function]
            assert stopped.status is OutcomeStatus.CONFIRMED and station.command == 5

    run(scenario())


def test_a_user_who_read_the_name_plate_can_send_the_first_stop_without_a_read() -> None:
    async def scenario() -> None:
        async with foreign_drive("ms300", "gd10") as (drive, station):
            drive.assume_model()
            with pytest.raises(StopUnconfirmed):
                await drive.stop()
            assert station.command == STOP_WORD

    run(scenario())


@pytest.mark.parametrize("was_ready", [True, False])
def test_a_silent_station_is_sent_the_stop_where_its_model_was_made_ready_to_start_there(was_ready: bool) -> None:
    """After a restart of this program with a broken receiver the motor may still run."""

    async def scenario() -> None:
        store = MemoryStore()
        if was_ready:
            async with foreign_drive("gd10", "gd10", store=store) as (drive, _):
                await drive.run(10.0)
        async with foreign_drive("gd10", "gd10", store=store) as (drive, station):
            station.address = 4  # it hears, but no reply arrives
            with pytest.raises(StopUnconfirmed) as caught:
                await drive.stop()
            sent = {each.sent[1] for each in caught.value.outcome.exchanges}
            assert (modbus.WriteRegister.function in sent) is was_ready
            assert (caught.value.outcome.key == "drives.stop_withheld_silent") is not was_ready

    run(scenario())


def test_a_station_that_answers_as_another_model_is_sent_no_stop_although_its_model_was_there_before() -> None:
    """The drive was exchanged for another make while this program was off: its stop may start the new one."""

    async def scenario() -> None:
        async with foreign_drive("gd10", "eds800") as (drive, station):
            drive._runner.drive.was_this_model = True
            with pytest.raises(StopUnconfirmed) as caught:
                await drive.stop()
            assert caught.value.outcome.key == "drives.stop_withheld"
            assert station.command == 0 and not station.motor.energised

    run(scenario())


@pytest.mark.parametrize("assumed", [False, True])
def test_a_first_stop_that_still_waits_for_the_model_says_so_and_is_sent_after_it(assumed: bool) -> None:
    """The bus holds the read back for 5 s after unanswered ones. The outcome named the turn on the bus instead."""

    async def scenario() -> None:
        async with foreign_drive("gd10", "gd10") as (drive, station):
            station.faults.silent = True
            with pytest.raises(NoReply):
                await drive.status()
            station.faults.silent = False
            if assumed:
                drive.assume_model()
                await asyncio.gather(drive.stop(), return_exceptions=True)
                assert station.command == 5
                return
            with pytest.raises(StopUnconfirmed) as caught:
                await drive.stop()
            outcome = caught.value.outcome
            assert (outcome.key, outcome.params) == ("drives.stop_awaits_model", {"station": 3, "model": "gd10"})
            assert outcome.text("en").startswith("STOP NOT SENT") and station.command == 0
            await asyncio.sleep(6)
            assert station.command == 5 and not drive.stop_pending

    run(scenario())


def test_no_frequency_of_a_model_is_written_to_a_station_that_answers_as_another() -> None:
    """A setpoint needs no verified state: its register may be anything in another model."""

    async def scenario() -> None:
        async with foreign_drive("ms300", "gd10") as (drive, station):
            with pytest.raises(StartInhibited, match="station 3 does not answer as a ms300") as caught:
                await drive.set_frequency(20.0)
            assert caught.value.key == "drives.model_unconfirmed"
            assert station.command == station.setpoint_word == 0

    run(scenario())


EXEMPT = {"vc660", "df800"}  # graded higher, with words of bits: named in docs/explanation/bus-stop.md


def test_no_station_of_another_model_passes_for_one_whose_stop_starts_it() -> None:
    """Every included model is read by the check of every other whose stop or reset starts it."""
    pairs = {(collision.model, collision.other) for collision in collisions()}
    assert len(pairs) >= 20
    for model, other in sorted(pairs):
        dialect: Any = create_dialect(profiles.load(model), 3, encoding="rtu")
        if model in EXEMPT:
            assert dialect.model_check() is None
            continue
        assert not passes_for_model(dialect, make_station(other, 3)), f"{other} passes for {model}"


def passes_for_model(dialect: Any, station: Any) -> bool:
    """Return whether the replies of a station pass the reads that show the model."""
    while (read := dialect.model_check()) is not None:
        dialect.decode_readings(read, station.handle_request(read, dialect.codec), 1.0)
        if dialect.model_check() == read:
            return False
    return True


@pytest.mark.parametrize("model", sorted(set(profiles.models()) - EXEMPT))
def test_a_station_of_the_model_itself_passes(model: str) -> None:
    profile = profiles.load(model)
    dialect: Any = create_dialect(profile, 3)
    assert (dialect.model_check() is not None) is (profile.commands is not None)
    assert passes_for_model(dialect, make_station(model, 3))
