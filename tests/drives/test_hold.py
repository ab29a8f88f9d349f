"""Pause and ramp hold: levels that every later word ends, so each of them is a command of its own."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, nullcontext
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest

from drivebus import profiles
from drivebus.drives import Drive, create_dialect, stop_bus
from drivebus.drives.dialects.base import StopMode
from drivebus.drives.operations.command_age import CommandAge
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.hold import hold_ramp, pause
from drivebus.drives.operations.jog import begin_jog
from drivebus.drives.operations.preflight import ensure_preflight
from drivebus.drives.operations.start import COMMAND_SETTLE_S, START_CONFIRM_TIMEOUT_S, run
from drivebus.drives.operations.stop import stop
from drivebus.drives.outcome import Outcome, OutcomeStatus
from drivebus.drives.state import Direction, DriveState
from drivebus.errors import (
    CapabilityError,
    LimitError,
    OutcomeUnknown,
    StartInhibited,
    StopUnconfirmed,
    Superseded,
    TargetNotReached,
)
from drivebus.profiles.model import DriveProfile
from drivebus.protocols import modbus
from drivebus.protocols.codec import Effect
from fixtures.drives import FakeModbus, PureBus, SimulatedDrives, dialect_for, operation_for, run_virtual

COMMANDS, STATUS, OUTPUT = 0x2000, 0x3000, 0x3002


async def output_hz(drive: Any) -> float:
    """Read the output frequency."""
    return float((await drive.status(["output_frequency"])).readings["output_frequency"].value)


@asynccontextmanager
async def held_ramp(seconds: float) -> AsyncIterator[tuple[Drive, Any, asyncio.Task[Outcome]]]:
    """Provide a drive at 20 Hz with its station and a ramp hold of ``seconds``, of which one has passed."""
    async with SimulatedDrives("vc660") as bench:
        drive = bench.drive()
        await drive.run(20.0, wait=True)
        holding = asyncio.create_task(drive.hold_ramp(seconds))
        await asyncio.sleep(1.0)
        yield drive, bench.station(), holding


def words_of(outcome: Any) -> list[int]:
    """Return the command words that an operation sent."""
    requests = [exchange.sent for exchange in outcome.exchanges if exchange.sent[1] == 6]
    return [int.from_bytes(sent[4:6]) for sent in requests if sent[2:4] == COMMANDS.to_bytes(2)]


def test_a_pause_brings_the_motor_to_0_hz_and_a_start_lets_it_run_again() -> None:
    async def played() -> None:
        async with SimulatedDrives("vc660") as bench:
            drive = bench.drive()
            await drive.run(20.0, wait=True)
            paused = await drive.pause()
            assert (paused.status, paused.key) == (OutcomeStatus.CONFIRMED, "drives.paused")
            assert words_of(paused) == [0x0080]
            await asyncio.sleep(20.0)
            assert await output_hz(drive) == 0.0 and bench.station().motor.energised
            assert words_of(await drive.pause()) == []
            again = await drive.run(30.0, wait=True)
            assert again.succeeded and await output_hz(drive) == 30.0
            assert (await drive.status()).state is DriveState.RUNNING

    run_virtual(played())


def test_a_stop_ends_a_paused_run() -> None:
    async def played() -> None:
        async with SimulatedDrives("vc660") as bench:
            drive = bench.drive()
            await drive.run(20.0, "reverse", wait=True)
            await drive.pause()
            stopped = await drive.stop()
            assert stopped.status is OutcomeStatus.CONFIRMED and words_of(stopped)[:2] == [0x0006, 0x0004]
            await asyncio.sleep(30.0)
            assert not bench.station().motor.energised

    run_virtual(played())


def test_a_paused_drive_does_not_run_when_its_stop_is_lost() -> None:
    """The levels that follow a stop would end the pause: without an accepted stop they are not sent."""

    class LosesStops(FakeModbus):
        lost = 0

        def __call__(self, request: Any) -> Any:
            if isinstance(request, modbus.WriteRegister) and request.value & 0x0002 and self.lost < 3:
                self.lost += 1
                return None
            return super().__call__(request)

    station = LosesStops(registers={STATUS: 0x0029})
    bus = PureBus(dialect=dialect_for("vc660"), station=station)

    def stops(ask: Any) -> None:
        if isinstance(ask.request, modbus.WriteRegister) and station.lost == 3 and ask.request.value == 0:
            station.registers[STATUS] = 0x0001

    bus.on_request = stops
    bus.run(stop(operation_for(bus.dialect)))
    words = [write.value for write in bus.sent(modbus.WriteRegister)]
    assert words[:3] == [0x0002] * 3 and words[-1] == 0x0000


@pytest.mark.parametrize("status", [0x0001, 0x0003, 0x0109], ids=["stopped", "fault", "jogging"])
def test_only_a_running_motor_is_paused_or_held(status: int) -> None:
    for operation in (pause, lambda op: hold_ramp(op, 1.0)):
        bus = PureBus(dialect=dialect_for("vc660"), station=FakeModbus(registers={STATUS: status}))
        with pytest.raises(StartInhibited):
            bus.run(operation(operation_for(bus.dialect)))
        assert not bus.effects()


def test_a_motor_in_reverse_is_not_turned_by_what_follows_a_rejected_stop() -> None:
    """A program that has just begun knows neither its direction nor a ramp hold that a killed one has left."""

    class RejectsStops(FakeModbus):
        rejected = 0

        def __call__(self, request: Any) -> Any:
            if isinstance(request, modbus.WriteRegister) and request.value & 0x0002:
                self.rejected += 1
                if self.rejected <= 3:
                    return modbus.ExceptionReply(1, 6, 6)
                self.registers[STATUS] = 0x4001
            return super().__call__(request)

    station = RejectsStops(registers={STATUS: 0xC009})
    bus = PureBus(dialect=dialect_for("vc660"), station=station)
    outcome = bus.run(stop(operation_for(bus.dialect)))
    words = [write.value for write in bus.sent(modbus.WriteRegister)]
    assert outcome.status is OutcomeStatus.CONFIRMED and all(word & 0x0002 for word in words[:4])


def test_a_pause_that_the_drive_does_not_execute_is_not_called_one() -> None:
    bus = PureBus(dialect=dialect_for("vc660"), station=FakeModbus(registers={STATUS: 0x0009}))
    outcome = bus.run(pause(operation_for(bus.dialect)))
    assert (outcome.status, outcome.key) == (OutcomeStatus.FAILED, "drives.not_paused")
    assert "reports running" in outcome.text("en")


def test_a_pause_after_which_the_drive_is_silent_is_unknown() -> None:
    station = FakeModbus(registers={STATUS: 0x0009})
    bus = PureBus(dialect=dialect_for("vc660"), station=lambda request: None if bus.effects() else station(request))
    outcome = bus.run(pause(operation_for(bus.dialect)))
    assert (outcome.status, outcome.key) == (OutcomeStatus.UNKNOWN, "drives.pause_unknown")


def test_a_trip_during_a_ramp_hold_is_reported() -> None:
    registers = {STATUS: 0x0009, 0x0001: 4}
    bus = PureBus(dialect=dialect_for("vc660"), station=FakeModbus(registers=registers))

    def trips(ask: Any) -> None:
        if isinstance(ask.request, modbus.WriteRegister):
            registers[STATUS] = 0x0002

    bus.on_request = trips
    op = operation_for(bus.dialect)
    outcome = bus.run(hold_ramp(op, 5.0))
    assert (outcome.status, outcome.key) == (OutcomeStatus.FAILED, "drives.ramp_hold_ended")
    assert not op.may_be_running


def test_an_unanswered_ramp_hold_is_ended_at_once() -> None:
    class LosesHold(FakeModbus):
        def __call__(self, request: Any) -> Any:
            lost = isinstance(request, modbus.WriteRegister) and request.value == 0x0100
            return None if lost else super().__call__(request)

    bus = PureBus(dialect=dialect_for("vc660"), station=LosesHold(registers={STATUS: 0x0009, 0x0001: 4}))
    op = operation_for(bus.dialect)
    outcome = bus.run(hold_ramp(op, 5.0))
    assert (outcome.status, outcome.key) == (OutcomeStatus.UNKNOWN, "drives.ramp_hold_unanswered")
    assert [write.value for write in bus.sent(modbus.WriteRegister)] == [0x0100, 0x0000]
    assert bus.now < 5.0 and not op.may_be_running


def test_a_start_does_not_end_the_pause_of_a_drive_in_fault() -> None:
    registers = {STATUS: 0x0022, 0x0001: 4, 0x3016: 0x0002}
    bus = PureBus(dialect=dialect_for("vc660"), station=FakeModbus(registers=registers))
    with pytest.raises(StartInhibited, match="fault") as caught:
        bus.run(run(operation_for(bus.dialect), 20.0, None))
    assert caught.value.key == "drives.state_forbids" and not bus.effects()


def paused_bus(output_hz: float, profile: DriveProfile | None = None) -> tuple[PureBus, dict[int, int]]:
    """Return a bus with a VC660 paused in forward, which a start lets run at this output frequency; its registers."""
    registers = {STATUS: 0x0029, 0x0001: 4, 0x3001: 2000, OUTPUT: round(output_hz * 100)}

    def starts(fake: FakeModbus, word: int) -> bool:
        registers[STATUS] = 0x0009 if word & 1 else 0x0001 if word & 2 else registers[STATUS]
        return True

    dialect = create_dialect(profile or profiles.load("vc660"), 1)
    return PureBus(dialect=dialect, station=FakeModbus(registers=registers, on_command=starts)), registers


def words(bus: PureBus) -> list[int]:
    """Return the command words that were sent."""
    return [write.value for write in bus.sent(modbus.WriteRegister, register=COMMANDS)]


def test_a_motor_that_still_turns_during_its_pause_runs_again_in_its_direction() -> None:
    bus, _ = paused_bus(5.0)
    assert bus.run(run(operation_for(bus.dialect), 20.0, None)).status is OutcomeStatus.CONFIRMED
    assert words(bus) == [0x0001, 0x0000]


def test_a_motor_that_still_turns_during_its_pause_is_not_started_the_other_way() -> None:
    bus, _ = paused_bus(5.0)
    with pytest.raises(StartInhibited) as caught:
        bus.run(run(operation_for(bus.dialect), 20.0, Direction.REVERSE))
    assert caught.value.key == "drives.turning" and not bus.effects()


def test_a_pause_ends_also_where_neither_direction_nor_output_frequency_is_reported() -> None:
    profile = profiles.load("vc660")
    assert profile.status is not None
    bits = {name: bit for name, bit in profile.status.bits.items() if not name.endswith("reverse")}
    signals = {name: signal for name, signal in profile.signals.items() if name != "output_frequency"}
    bus, _ = paused_bus(5.0, replace(profile, status=replace(profile.status, bits=bits), signals=signals))
    assert bus.run(run(operation_for(bus.dialect), 20.0, None)).status is OutcomeStatus.CONFIRMED


@pytest.mark.parametrize("changed", [{STATUS: 0x002A, 0x3016: 0x0002}, {STATUS: 0x8029}], ids=["fault", "reverse"])
def test_a_pause_does_not_end_where_a_fault_or_the_other_direction_shows_after_the_checks(
    changed: dict[int, int],
) -> None:
    bus, registers = paused_bus(5.0)
    bus.on_request = lambda ask: registers.update(changed) if isinstance(ask.request, modbus.WriteRegister) else None
    outcome = bus.run(run(operation_for(bus.dialect), 20.0, None))
    assert (outcome.status, outcome.key, words(bus)) == (OutcomeStatus.FAILED, "drives.not_started", [])


def test_a_paused_motor_that_trips_at_the_start_that_ends_its_pause_has_not_run() -> None:
    bus, registers = paused_bus(0.0)

    def trips(ask: Any) -> None:
        if words(bus):
            registers.update({STATUS: 0x0002, 0x3016: 0x0002})

    bus.on_request = trips
    outcome = bus.run(run(operation_for(bus.dialect), 20.0, None))
    assert (outcome.status, outcome.key) == (OutcomeStatus.FAILED, "drives.start_failed")


@pytest.mark.parametrize(
    ("paused_hz", "hz", "shown_hz", "is_stopped"),
    [(40.0, 20.0, 47.9, False), (40.0, 20.0, 48.1, True), (0.0, 0.5, 3.4, False), (0.0, 0.5, 3.6, True)],
)
def test_the_overspeed_after_a_pause_counts_from_the_frequency_that_the_motor_had_left(
    paused_hz: float, hz: float, shown_hz: float, is_stopped: bool
) -> None:
    bus, registers = paused_bus(paused_hz)
    registers[0x3001] = round(hz * 100)
    bus.on_request = lambda ask: registers.update({OUTPUT: round(shown_hz * 100)}) if words(bus) == [1] else None
    with pytest.raises(TargetNotReached) if is_stopped else nullcontext():
        assert bus.run(run(operation_for(bus.dialect), hz, None)).status is OutcomeStatus.CONFIRMED
    assert (0x0002 in words(bus)) is is_stopped


def test_a_start_does_not_end_a_pause_in_fault_that_appears_after_its_checks() -> None:
    registers = {STATUS: 0x0001, 0x0001: 4, 0x3001: 2000, 0x3016: 0x0002}
    bus = PureBus(dialect=dialect_for("vc660"), station=FakeModbus(registers=registers))

    def trips(ask: Any) -> None:
        if isinstance(ask.request, modbus.WriteRegister):
            registers[STATUS] = 0x0022

    bus.on_request = trips
    outcome = bus.run(run(operation_for(bus.dialect), 20.0, None))
    assert (outcome.status, outcome.key) == (OutcomeStatus.FAILED, "drives.not_started")
    assert [write.register for write in bus.sent(modbus.WriteRegister)] == [0x2001]


@pytest.mark.parametrize(("before", "after"), [(0x0029, 0x0001), (0x0001, 0x0029)], ids=["stopped", "paused"])
def test_a_start_does_not_follow_a_stop_or_a_pause_by_another_program_after_its_checks(before: int, after: int) -> None:
    registers = {STATUS: before, 0x0001: 4, 0x3001: 2000}
    bus = PureBus(dialect=dialect_for("vc660"), station=FakeModbus(registers=registers))

    def changes(ask: Any) -> None:
        if isinstance(ask.request, modbus.WriteRegister):
            registers[STATUS] = after

    bus.on_request = changes
    outcome = bus.run(run(operation_for(bus.dialect), 20.0, None))
    assert (outcome.status, outcome.key) == (OutcomeStatus.FAILED, "drives.not_started")
    assert [write.register for write in bus.sent(modbus.WriteRegister)] == [0x2001]


@pytest.mark.parametrize("before", [0x0009, 0x0029], ids=["running", "paused"])
@pytest.mark.parametrize(
    "command",
    [lambda op: run(op, 20.0, None), lambda op: begin_jog(op, None, Direction.FORWARD)],
    ids=["start", "jog"],
)
def test_a_motor_that_another_source_stops_during_the_checks_is_not_started(before: int, command: Any) -> None:
    """The command was meant for a motor that ran; a stop at the keypad came after it."""
    registers = {STATUS: before, 0x0001: 4, 0x3001: 2000}
    bus = PureBus(dialect=dialect_for("vc660"), station=FakeModbus(registers=registers))

    def stops(ask: Any) -> None:
        if isinstance(ask.request, modbus.ReadRegisters) and ask.request.register < COMMANDS:  # the pre-flight check
            registers[STATUS] = 0x0001

    bus.on_request = stops
    with pytest.raises(StartInhibited) as caught:
        bus.run(command(operation_for(bus.dialect)))
    assert caught.value.key == "drives.stopped_meanwhile" and not bus.sent(modbus.WriteRegister)


def test_a_motor_that_stops_between_the_two_reads_of_its_state_is_not_started() -> None:
    registers = {STATUS: 0x0009, 0x0001: 4, 0x3001: 2000}
    bus = PureBus(dialect=dialect_for("vc660"), station=FakeModbus(registers=registers))
    bus.run(ensure_preflight(operation_for(bus.dialect)))

    def stops(ask: Any) -> None:
        if isinstance(ask.request, modbus.ReadRegisters) and ask.request.register == STATUS:
            registers[STATUS] = 0x0001

    bus.on_request = stops
    with pytest.raises(StartInhibited, match="Another source stopped it"):
        bus.run(run(operation_for(bus.dialect), 20.0, None))
    assert not bus.sent(modbus.WriteRegister)


@pytest.mark.parametrize("is_checked", [False, True], ids=["pre-flight check", "state read twice"])
def test_a_motor_that_another_program_pauses_during_the_checks_of_a_run_stays_paused(is_checked: bool) -> None:
    """The run was meant as a new frequency of a running motor; the pause came after it."""
    registers = {STATUS: 0x0009, 0x0001: 4, 0x3001: 2000}
    bus = PureBus(dialect=dialect_for("vc660"), station=FakeModbus(registers=registers))
    if is_checked:
        bus.run(ensure_preflight(operation_for(bus.dialect)))

    def pauses(ask: Any) -> None:
        if isinstance(ask.request, modbus.ReadRegisters) and ask.request.register == (STATUS if is_checked else 0x0001):
            registers[STATUS] = 0x0029

    bus.on_request = pauses
    with pytest.raises(StartInhibited, match="Another source paused it"):
        bus.run(run(operation_for(bus.dialect), 30.0, None))
    assert not bus.sent(modbus.WriteRegister)


def test_a_start_the_other_way_round_waits_until_the_paused_motor_stands() -> None:
    async def played() -> None:
        async with SimulatedDrives("vc660") as bench:
            drive = bench.drive()
            await drive.run(20.0, wait=True)
            await drive.pause()
            with pytest.raises(StartInhibited, match="forward"):
                await drive.run(20.0, Direction.REVERSE)
            await asyncio.sleep(20.0)
            assert (await drive.run(20.0, Direction.REVERSE, wait=True)).succeeded

    run_virtual(played())


def test_a_ramp_hold_keeps_the_frequency_and_ends_by_itself() -> None:
    async def played() -> None:
        async with SimulatedDrives("vc660") as bench:
            drive = bench.drive()
            await drive.run(40.0)
            await asyncio.sleep(3.0)
            holding = asyncio.create_task(drive.hold_ramp(3.0))
            await asyncio.sleep(1.0)
            held_hz = await output_hz(drive)
            await asyncio.sleep(1.5)
            assert 0.0 < await output_hz(drive) == held_hz < 40.0
            outcome = await holding
            assert (outcome.status, outcome.key) == (OutcomeStatus.ACKNOWLEDGED, "drives.ramp_held")
            assert words_of(outcome) == [0x0100, 0x0000]
            await asyncio.sleep(20.0)
            assert await output_hz(drive) == 40.0

    run_virtual(played())


def test_a_stop_during_a_ramp_hold_stops_and_supersedes_it() -> None:
    async def played() -> None:
        async with held_ramp(10.0) as (drive, station, holding):
            assert (await drive.stop()).status is OutcomeStatus.CONFIRMED
            with pytest.raises(Superseded):
                await holding
            assert not station.motor.energised

    run_virtual(played())


def test_a_cancelled_ramp_hold_stops_the_drive() -> None:
    async def played() -> None:
        async with held_ramp(10.0) as (drive, station, holding):
            holding.cancel()
            with pytest.raises(asyncio.CancelledError):
                await holding
            await asyncio.sleep(30.0)
            assert not station.motor.energised and not drive.stop_pending

    run_virtual(played())


def test_a_ramp_hold_whose_end_is_not_acknowledged_is_ended_by_a_stop() -> None:
    async def played() -> None:
        async with held_ramp(2.0) as (_, station, holding):
            handled = station.handle_request

            def loses_levels(message: Any, codec: Any) -> Any:
                lost = isinstance(message, modbus.WriteRegister) and message.value == 0
                return None if lost and not station.motor.stopping else handled(message, codec)

            station.handle_request = loses_levels
            with pytest.raises(OutcomeUnknown) as caught:
                await holding
            assert caught.value.key == "drives.ramp_hold_unknown"
            assert not station.motor.energised

    run_virtual(played())


@pytest.mark.parametrize("seconds", [0.0, -1.0, 10.1, float("nan")])
def test_the_time_of_a_ramp_hold_is_limited(seconds: float) -> None:
    bus = PureBus(dialect=dialect_for("vc660"), station=FakeModbus(registers={STATUS: 0x0009}))
    with pytest.raises(LimitError, match="at most 10") as caught:
        bus.run(hold_ramp(operation_for(bus.dialect), seconds))
    assert caught.value.key == "drives.ramp_hold_time"
    assert not bus.requests


def test_no_ramp_is_held_outside_the_limits_of_the_user() -> None:
    async def played() -> None:
        async with SimulatedDrives("vc660") as bench:
            drive = bench.drive()
            await drive.run(40.0, wait=True)
            drive.limits = replace(drive.limits, maximum_hz=30.0)
            with pytest.raises(LimitError):
                await drive.hold_ramp(1.0)

    run_virtual(played())


@pytest.mark.parametrize("model", ["c320", "dzb100", "df800"])
def test_a_model_without_pause_and_ramp_hold_says_so(model: str) -> None:
    for operation in (pause, lambda op: hold_ramp(op, 1.0)):
        bus = PureBus(dialect=dialect_for(model), station=FakeModbus())
        with pytest.raises(CapabilityError):
            bus.run(operation(operation_for(bus.dialect)))
        assert not bus.requests


def test_a_start_inhibit_refuses_a_pause_and_a_ramp_hold() -> None:
    async def played() -> None:
        async with SimulatedDrives("vc660") as bench:
            drive = bench.drive()
            await drive.run(20.0, wait=True)
            bench.bus.inhibit_start()
            for command in (drive.pause, lambda: drive.hold_ramp(1.0)):
                with pytest.raises(StartInhibited):
                    await command()

    run_virtual(played())


def test_a_pause_by_another_program_does_not_end_when_the_stop_is_lost() -> None:
    """Our own words were sent before: the pause shows in the status alone."""

    async def played() -> None:
        async with SimulatedDrives("vc660") as bench:
            drive, station = bench.drive(), bench.station()
            await drive.run(20.0, wait=True)
            station.handle_request(modbus.WriteRegister(1, COMMANDS, 0x0080), drive.dialect.codec)
            assert (await drive.status()).state is DriveState.PAUSED
            handled = station.handle_request
            lost: list[int] = []
            resumed: list[int] = []

            def loses_stops(message: Any, codec: Any) -> Any:
                if isinstance(message, modbus.WriteRegister) and message.value & 0x0002 and len(lost) < 3:
                    lost.append(message.value)
                    return None
                reply = handled(message, codec)
                if isinstance(message, modbus.WriteRegister) and not station.paused and not station.motor.stopping:
                    resumed.append(message.value)
                return reply

            station.handle_request = loses_stops
            assert (await drive.stop()).status is OutcomeStatus.CONFIRMED
            assert len(lost) == 3 and not [word for word in resumed if not word & 0x0002]

    run_virtual(played())


@pytest.mark.parametrize("word", [0x0080, 0x0004], ids=["paused", "reversed"])
def test_a_bus_stop_lets_no_motor_run_that_missed_the_broadcast_and_that_another_program_changed(word: int) -> None:
    """A broadcast has no reply: whether it stopped the drive is unknown when the next frame leaves."""

    async def played() -> None:
        async with SimulatedDrives("vc660", "1-2") as bench:
            drives = [bench.drive(address) for address in (1, 2)]
            for drive in drives:
                await drive.run(20.0, wait=True)
            station = bench.station(2)
            station.handle_request(modbus.WriteRegister(2, COMMANDS, word), drives[1].dialect.codec)
            await asyncio.sleep(0.01)
            handled = station.handle_request
            resumed: list[int] = []

            def loses_broadcast_stops(message: Any, codec: Any) -> Any:
                is_command = isinstance(message, modbus.WriteRegister)
                if is_command and message.address == 0 and message.value & 0x0002:
                    return None
                reply = handled(message, codec)
                if is_command and not message.value & 0x0002 and not station.motor.stopping and station.control != word:
                    resumed.append(message.value)
                return reply

            station.handle_request = loses_broadcast_stops
            assert (await stop_bus(bench.bus, drives)).confirmed
            assert not resumed

    run_virtual(played())


def test_a_ramp_hold_does_not_end_the_repetition_of_an_unconfirmed_stop() -> None:
    async def played() -> None:
        async with SimulatedDrives("vc660") as bench:
            drive, station = bench.drive(), bench.station()
            await drive.run(20.0, wait=True)
            handled = station.handle_request

            def loses_stops(message: Any, codec: Any) -> Any:
                lost = isinstance(message, modbus.WriteRegister) and message.value & 0x0002
                return None if lost else handled(message, codec)

            station.handle_request = loses_stops
            with pytest.raises(StopUnconfirmed):
                await drive.stop()
            with pytest.raises(Superseded):
                await drive.hold_ramp(5.0)
            assert drive.stop_pending
            station.handle_request = handled
            await asyncio.sleep(20.0)
            assert not station.motor.energised

    run_virtual(played())


def test_a_pause_cancelled_while_its_frame_is_on_the_wire_counts_as_sent() -> None:
    """Otherwise the levels after a lost stop would end it."""

    async def played() -> None:
        async with SimulatedDrives("vc660") as bench:
            drive, station = bench.drive(), bench.station()
            await drive.run(20.0, wait=True)
            handled, received = station.handle_request, asyncio.Event()

            def note_pause(message: Any, codec: Any) -> Any:
                if isinstance(message, modbus.WriteRegister) and message.value == 0x0080:
                    received.set()
                return handled(message, codec)

            station.handle_request = note_pause
            pausing = asyncio.create_task(drive.pause())
            await received.wait()
            pausing.cancel()
            with pytest.raises(asyncio.CancelledError):
                await pausing
            assert station.paused
            levels = drive.dialect.stop(StopMode.STOP)[1]
            assert drive.dialect.effect(drive.dialect.codec.encode_request(levels)) is Effect.MOTION

    run_virtual(played())


def test_a_pause_shows_in_a_status_that_is_a_number() -> None:
    profile = profiles.load("vc660")
    assert profile.status is not None
    numbers = replace(profile.status, bits={}, values={0x0029: "paused", 0x0001: "stopped", 0x0009: "running"})
    dialect: Any = create_dialect(replace(profile, status=numbers), 1)
    dialect.decode_readings(modbus.ReadRegisters(1, STATUS, 1), modbus.RegisterValues(1, 3, (0x0029,)), 0.0)
    levels = dialect.stop(StopMode.STOP)[1]
    assert dialect.effect(dialect.codec.encode_request(levels)) is Effect.MOTION


@pytest.mark.parametrize("operation", [pause, lambda op: hold_ramp(op, 1.0)], ids=["pause", "ramp hold"])
def test_a_motor_that_another_program_has_reversed_is_not_turned_back_by_a_hold(operation: Any) -> None:
    """The direction was read earlier, when it was forward."""
    station = FakeModbus(registers={STATUS: 0x0001, 0x0001: 4})
    bus = PureBus(dialect=dialect_for("vc660"), station=station)
    bus.run(operation_for(bus.dialect).read_verified_state())
    station.registers[STATUS] = 0xC009
    bus.run(operation(operation_for(bus.dialect)))
    words = [write.value for write in bus.sent(modbus.WriteRegister, register=COMMANDS)]
    assert words and all(word & 0x0004 for word in words)


def test_a_motor_that_another_program_reverses_during_a_ramp_hold_is_not_turned_back_by_its_end() -> None:
    station = FakeModbus(registers={STATUS: 0x0009, 0x0001: 4})
    bus = PureBus(dialect=dialect_for("vc660"), station=station)

    def reverses(ask: Any) -> None:
        if isinstance(ask.request, modbus.WriteRegister):
            station.registers[STATUS] = 0xC009

    bus.on_request = reverses
    bus.run(hold_ramp(operation_for(bus.dialect), 1.0))
    assert [write.value for write in bus.sent(modbus.WriteRegister)] == [0x0100, 0x0004]


def test_a_start_during_a_slow_ramp_to_the_pause_is_no_overspeed() -> None:
    async def played() -> None:
        async with SimulatedDrives("vc660") as bench:
            drive = bench.drive()
            await drive.run(45.0, wait=True)
            bench.station().set_ramps(10.0, 600.0)
            await drive.pause()
            assert (await drive.run(20.0, wait=True, timeout_s=600.0)).succeeded

    run_virtual(played())


class Rejects(FakeModbus):
    """Rejects every write of these words to the command register."""

    words: tuple[int, ...] = ()

    def __call__(self, request: Any) -> Any:
        if isinstance(request, modbus.WriteRegister) and request.value in self.words:
            return modbus.ExceptionReply(1, 6, 4)
        return super().__call__(request)


def held_bus(station: FakeModbus) -> PureBus:
    """Return a bus with a VC660 that runs forward, with its command source set."""
    station.registers |= {STATUS: 0x0009, 0x0001: 4}
    return PureBus(dialect=dialect_for("vc660"), station=station)


def test_the_pause_of_a_paused_motor_is_confirmed_without_a_frame() -> None:
    bus = held_bus(FakeModbus())
    bus.station.registers[STATUS] = 0x0029  # type: ignore[attr-defined]
    outcome = bus.run(pause(operation_for(bus.dialect)))
    assert (outcome.status, outcome.key) == (OutcomeStatus.CONFIRMED, "drives.paused") and not bus.effects()


@pytest.mark.parametrize("operation", [pause, lambda op: hold_ramp(op, 1.0)], ids=["pause", "ramp hold"])
def test_a_rejected_pause_or_ramp_hold_is_reported_at_once_and_not_repeated(operation: Any) -> None:
    bus = held_bus(Rejects())
    bus.station.words = (0x0080, 0x0100)  # type: ignore[attr-defined]
    op = operation_for(bus.dialect)
    outcome = bus.run(operation(op))
    assert outcome.status is OutcomeStatus.REFUSED and len(bus.sent(modbus.WriteRegister)) == 1
    assert [key for key, _ in outcome.notes] == ["drives.modbus_remedy_4"]
    assert op.age.checks_started_at == 0.0, "slow checks end before the frame: the clock began with them"


def test_a_motor_that_stopped_instead_of_pausing_is_reported_at_once() -> None:
    station = FakeModbus()
    bus = held_bus(station)
    bus.on_request = lambda ask: station.registers.update({STATUS: 0x0001}) if bus.effects() else None
    outcome = bus.run(pause(operation_for(bus.dialect)))
    assert (outcome.status, outcome.key) == (OutcomeStatus.FAILED, "drives.not_paused")
    assert outcome.params["state"] is DriveState.STOPPED and bus.now < 1.0


def test_a_drive_has_three_seconds_to_report_a_pause_and_a_moment_before_the_first_read() -> None:
    times: list[float] = []
    bus = held_bus(FakeModbus())
    bus.on_request = lambda ask: times.append(bus.now) if bus.effects() else None
    assert bus.run(pause(operation_for(bus.dialect))).key == "drives.not_paused"
    assert START_CONFIRM_TIMEOUT_S < bus.now < START_CONFIRM_TIMEOUT_S + 0.5
    assert times[1] - times[0] >= COMMAND_SETTLE_S


def test_a_pause_after_which_the_readings_contradict_each_other_is_unknown() -> None:
    station = FakeModbus()
    bus = held_bus(station)

    def flips(ask: Any) -> None:
        if bus.effects() and isinstance(ask.request, modbus.ReadRegisters) and ask.request.register == STATUS:
            station.registers[STATUS] ^= 0x0008

    bus.on_request = flips
    outcome = bus.run(pause(operation_for(bus.dialect)))
    assert (outcome.status, outcome.key) == (OutcomeStatus.UNKNOWN, "drives.pause_unknown")


def test_no_ramp_is_held_of_a_motor_that_stopped_during_the_checks() -> None:
    """The pre-flight check reads parameters for a while: the state before it is no longer evidence."""
    station = FakeModbus()
    bus = held_bus(station)

    def stops(ask: Any) -> None:
        if isinstance(ask.request, modbus.ReadRegisters) and ask.request.register < 0x1000:
            station.registers[STATUS] = 0x0001

    bus.on_request = stops
    with pytest.raises(StartInhibited):
        bus.run(hold_ramp(operation_for(bus.dialect), 1.0))
    assert not bus.effects()


def test_no_ramp_is_held_at_a_frequency_that_was_not_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """It may be above the limits of the user."""
    bus = held_bus(FakeModbus())
    monkeypatch.setattr(OperationContext, "output_hz", lambda op: None)
    with pytest.raises(StartInhibited):
        bus.run(hold_ramp(operation_for(bus.dialect), 1.0))
    assert not bus.effects()


@pytest.mark.parametrize("seconds", [0.15, 5.0])
def test_a_ramp_hold_ends_in_time_and_reads_the_state_five_times_a_second_until_then(seconds: float) -> None:
    begun: list[float] = []
    bus = held_bus(FakeModbus())
    bus.on_request = lambda ask: begun.append(bus.now) if bus.effects() else None
    outcome = bus.run(hold_ramp(operation_for(bus.dialect), seconds))
    assert outcome.key == "drives.ramp_held"
    assert seconds <= begun[-1] - begun[0] < seconds + 0.2
    pauses = [later - earlier - bus.transaction_s for earlier, later in pairwise(begun)]
    waits = [each for each in pauses if each > 0.01]
    assert max(waits) == pytest.approx(min(0.2, seconds - 4 * bus.transaction_s), abs=0.1)
    assert len(waits) == (1 if seconds < 1.0 else pytest.approx(seconds / 0.29, abs=4))


def test_the_end_of_a_ramp_hold_does_not_expire_with_its_request() -> None:
    """A hold of five seconds outlives the two seconds of a command; a stop would follow."""
    bus = held_bus(FakeModbus())
    op = operation_for(bus.dialect)
    op.age = CommandAge(requested_at=0.0, checks_started_at=None)
    outcome = bus.run(hold_ramp(op, 5.0))
    assert (outcome.status, outcome.key) == (OutcomeStatus.ACKNOWLEDGED, "drives.ramp_held")
    assert [write.value for write in bus.sent(modbus.WriteRegister)] == [0x0100, 0x0000]


def test_a_ramp_hold_whose_end_the_drive_rejects_is_ended_by_a_stop() -> None:
    bus = held_bus(Rejects())
    bus.station.words = (0x0000,)  # type: ignore[attr-defined]
    outcome = bus.run(hold_ramp(operation_for(bus.dialect), 1.0))
    assert (outcome.status, outcome.key) == (OutcomeStatus.UNKNOWN, "drives.ramp_hold_unknown")
    assert any(write.value & 0x0002 for write in bus.sent(modbus.WriteRegister))


def test_a_ramp_hold_whose_end_the_bus_forbids_is_ended_by_a_stop() -> None:
    """A start inhibit during the hold withholds every motion: the motor would be held for ever."""
    bus = held_bus(FakeModbus())

    def inhibits(ask: Any) -> None:
        if bus.effects():
            bus.conditions = replace(bus.conditions, start_inhibited=True)

    bus.on_request = inhibits
    outcome = bus.run(hold_ramp(operation_for(bus.dialect), 1.0))
    assert (outcome.status, outcome.key) == (OutcomeStatus.UNKNOWN, "drives.ramp_hold_unknown")
    words = [write.value for write in bus.sent(modbus.WriteRegister)]
    assert words[0] == 0x0100 and words[1] & 0x0002


@pytest.mark.parametrize(("later_hz", "key"), [(2500, "drives.ramp_held"), (5000, "drives.ramp_not_held")])
def test_a_ramp_hold_during_which_the_frequency_changes_is_not_called_held(later_hz: int, key: str) -> None:
    """The drive lost its power for a moment, and with it the hold, and runs again by itself at another frequency."""
    bus = held_bus(FakeModbus(registers={STATUS: 0x0009, 0x0001: 4, 0x3002: 2500}))

    def reboots(ask: Any) -> None:
        bus.station.registers[0x3002] = later_hz if bus.now > 2.0 else 2500

    bus.on_request = reboots
    op = operation_for(bus.dialect)
    outcome = bus.run(hold_ramp(op, 5.0))
    assert outcome.key == key and outcome.succeeded is (later_hz == 2500)
    assert words(bus) == [0x0100, 0x0000] and not op.may_be_running
    if later_hz == 5000:
        assert "from 25.0 Hz to 50.0 Hz" in outcome.text("en")


def test_a_ramp_hold_of_a_host_that_was_held_up_says_how_long_it_lasted() -> None:
    bus = held_bus(FakeModbus(registers={STATUS: 0x0009, 0x0001: 4, 0x3002: 2500}))
    asleep = [600.0]

    def sleeps(ask: Any) -> None:
        if words(bus) and bus.now > 1.0 and asleep:
            bus.pass_time(asleep.pop())

    bus.on_request = sleeps
    outcome = bus.run(hold_ramp(operation_for(bus.dialect), 5.0))
    assert outcome.key == "drives.ramp_held" and words(bus) == [0x0100, 0x0000]
    [(key, params)] = outcome.notes
    assert key == "drives.ramp_held_for" and params["held_s"] > 600.0
    assert params["held_s"] == round(params["held_s"], 1)
