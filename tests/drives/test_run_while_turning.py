"""Run of a motor that turns already: a new frequency, which starts nothing where the motor is being stopped."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Any

import pytest

from drivebus import i18n, profiles
from drivebus.bus.messages import BusRequest, BusResult
from drivebus.drives import create_dialect
from drivebus.drives.operations.context import VERIFICATION_ROUNDS, OperationContext
from drivebus.drives.operations.setpoint import SETPOINT_READ_TRIES
from drivebus.drives.operations.start import START_CONFIRM_TIMEOUT_S, run
from drivebus.drives.outcome import Outcome, OutcomeStatus
from drivebus.drives.state import Direction
from drivebus.errors import PortLost, StartInhibited, Superseded, TargetNotReached
from drivebus.protocols import modbus, sunfar
from drivebus.simulator.motor import Trip
from fixtures.drives import (
    SAFE_HZ,
    FakeC320,
    FakeModbus,
    PureBus,
    SimulatedDrives,
    dialect_for,
    keypad_registers,
    operation_for,
    reject_command,
    run_virtual,
)
from fixtures.starts import c320, start, starts, vc660

RUNNING, ACCELERATING = sunfar.SunfarState.RUNNING_FORWARD, sunfar.SunfarState.ACCELERATING_FORWARD
DECELERATING, STOPPED = sunfar.SunfarState.DECELERATING_FORWARD, sunfar.SunfarState.STOPPED


def run_c320(
    before: tuple[int, int], hz: float, *after: tuple[int, int], direction: Direction | None = None, **more: Any
) -> tuple[PureBus, Outcome]:
    """Run a C320 of this state and output, which shows one of ``after`` in each verified read behind its frequency."""
    fake = FakeC320(state=before[0], output=before[1], **more)
    bus = PureBus(dialect=dialect_for("c320"), station=fake)
    left = [shown for shown in after for _ in range(VERIFICATION_ROUNDS)]

    def follow(ask: Any) -> None:
        if left and bus.sent(sunfar.SunfarControl) and not isinstance(ask.request, sunfar.SunfarReadParameter):
            fake.state, fake.output = left.pop(0)

    bus.on_request = follow
    return bus, bus.run(run(operation_for(bus.dialect), hz, direction))


@pytest.mark.parametrize("direction", [None, Direction.FORWARD])
@pytest.mark.parametrize("state", [RUNNING, ACCELERATING])
def test_a_motor_that_runs_or_accelerates_gets_its_new_frequency(state: int, direction: Direction | None) -> None:
    bus, outcome = run_c320((state, 2000), 20.0, direction=direction)
    assert (outcome.status, outcome.notes) == (OutcomeStatus.ACKNOWLEDGED, ())
    assert bus.sent(sunfar.SunfarControl) == [sunfar.SunfarControl(1, sunfar.SunfarOperation.SET_FREQUENCY, 2000)]


@pytest.mark.parametrize(
    ("state", "key"),
    [
        (sunfar.SunfarState.JOGGING_FORWARD, "drives.turning"),
        (sunfar.SunfarState.DC_BRAKING, "drives.turning_state"),
    ],
)
def test_a_motor_that_jogs_or_brakes_gets_no_frequency_and_its_direction_is_not_guessed(state: int, key: str) -> None:
    bus = PureBus(dialect=dialect_for("c320"), station=FakeC320(state=state))
    with pytest.raises(StartInhibited) as caught:
        bus.run(run(operation_for(bus.dialect), 10.0, None))
    assert caught.value.key == key and not bus.effects()


def on_profile(model: str, registers: dict[int, int], **options: Any) -> tuple[PureBus, OperationContext, FakeModbus]:
    """Return a bus with a drive of a Modbus profile, an operation on it, and its registers."""
    profile = profiles.load(model)
    fake = FakeModbus(registers=keypad_registers(profile) | registers)
    bus = PureBus(dialect=create_dialect(profile, 1, options=options), station=fake)
    return bus, operation_for(bus.dialect), fake


def test_a_motor_paused_at_a_delta_is_not_started_by_a_model_without_a_pause() -> None:
    """The manual of that model lists the state and no word that ends it."""
    bus, op, fake = on_profile("c2000_plus", {0x2101: 2})
    with pytest.raises(StartInhibited) as caught:
        bus.run(run(op, 10.0, None))
    assert caught.value.key == "drives.turning_state" and not fake.written


@pytest.mark.parametrize("direction", list(Direction))
def test_a_motor_whose_direction_is_not_reported_is_not_turned_round(direction: Direction) -> None:
    bus, op, fake = on_profile("vf51", {0x2002: 1})
    with pytest.raises(StartInhibited) as caught:
        bus.run(run(op, 10.0, direction))
    assert caught.value.key == "drives.turning_unknown_direction" and not fake.written


def test_a_rejected_frequency_of_a_decelerating_motor_is_a_rejection_and_is_not_waited_for() -> None:
    bus, outcome = run_c320((DECELERATING, 600), 20.0, on_command=reject_command)
    assert outcome.status is OutcomeStatus.REFUSED and bus.now < 1.0


def test_a_motor_that_dips_and_rises_again_runs_on_and_is_not_waited_for() -> None:
    bus, outcome = run_c320((RUNNING, 1000), 20.0, (RUNNING, 800), (ACCELERATING, 900))
    assert (outcome.status, outcome.notes) == (OutcomeStatus.ACKNOWLEDGED, ())
    assert bus.now < START_CONFIRM_TIMEOUT_S


def test_the_state_after_a_new_frequency_is_read_once_the_drive_has_had_a_moment_to_follow() -> None:
    """A C320 may still report the state of before."""
    bus, outcome = run_c320((DECELERATING, 600), 20.0, (ACCELERATING, 700))
    sent_at = outcome.exchanges[-1].sent_at
    assert sent_at is not None and bus.now - sent_at == pytest.approx(0.15 + 5 * bus.transaction_s)


def test_a_motor_that_passes_its_new_frequency_on_its_way_to_standstill_does_not_run_on() -> None:
    bus, outcome = run_c320((DECELERATING, 2100), 20.0, (DECELERATING, 2000), (DECELERATING, 900), (STOPPED, 0))
    assert (outcome.status, outcome.key) == (OutcomeStatus.FAILED, "drives.run_while_decelerating")
    assert bus.now < START_CONFIRM_TIMEOUT_S, "a stopped motor is reported at once"


def test_a_motor_that_has_slowed_down_to_its_new_frequency_runs_on_at_it() -> None:
    _, outcome = run_c320((DECELERATING, 2050), 20.0, (RUNNING, 2000))
    assert (outcome.status, outcome.notes) == (OutcomeStatus.ACKNOWLEDGED, ())


def test_a_motor_that_keeps_a_higher_frequency_than_its_new_one_is_not_called_decelerating() -> None:
    bus, outcome = run_c320((DECELERATING, 3000), 20.0, (RUNNING, 3000))
    assert (outcome.status, outcome.notes) == (OutcomeStatus.ACKNOWLEDGED, ())
    assert bus.now > START_CONFIRM_TIMEOUT_S


def test_a_motor_at_0_hz_is_not_at_a_new_frequency_of_1_hz() -> None:
    """A drive that reports *running* down to standstill."""
    _, outcome = run_c320((DECELERATING, 500), 1.0, (RUNNING, 0))
    assert (outcome.status, outcome.key) == (OutcomeStatus.FAILED, "drives.run_while_decelerating")


@pytest.mark.parametrize("state", [sunfar.SunfarState.NOT_READY, sunfar.SunfarState.EMERGENCY_STOP])
def test_a_decelerating_motor_that_loses_its_supply_or_trips_is_not_asked_to_run_again(state: int) -> None:
    _, outcome = run_c320((DECELERATING, 600), 20.0, (state, 0))
    assert (outcome.status, outcome.key) == (OutcomeStatus.FAILED, "drives.start_failed")


def h2a(status: int, speed: int) -> tuple[PureBus, OperationContext, FakeModbus]:
    """Return a Huanyang H2A, which reports a speed and no output frequency."""
    return on_profile("huanyang_h2a", {0x3000: status, 0x700C: speed}, maximum_frequency=400)


def test_a_running_motor_that_reports_a_speed_and_no_output_frequency_gets_its_new_frequency() -> None:
    bus, op, fake = h2a(1, 1000)
    assert bus.run(run(op, 50.0, None)).succeeded and len(fake.written) == 1


def test_a_drive_without_an_output_frequency_runs_on_when_it_reports_so_and_is_not_waited_for() -> None:
    bus, op, fake = h2a(3, 1000)  # stopped, and its motor still turns
    bus.on_request = lambda ask: fake.registers.update({0x3000: 1}) if fake.written else None
    assert bus.run(run(op, 50.0, None)).succeeded and bus.now < 1.0


class UnpluggedBus(PureBus):
    """Bus whose frames do not leave once its station has lost the port."""

    def transact(self, ask: BusRequest) -> BusResult:
        result = super().transact(ask)
        return replace(result, sent=b"") if isinstance(result.error, PortLost) else result


def test_a_port_lost_before_a_second_frequency_of_a_running_motor_is_not_called_a_start_that_was_not_sent() -> None:
    """SKF8000: its maximum frequency was changed meanwhile, and the corrected frequency no longer leaves."""
    bus, op, fake = on_profile("skf8000", {0xF00A: 5000, 0x3000: 1})

    def station(request: Any) -> Any:
        if fake.written and isinstance(request, modbus.WriteRegister):
            return PortLost("sim.unplugged", port="sim://skf8000")
        reply = fake(request)
        fake.registers[0xF00A] = 10000 if fake.written else 5000
        return reply

    unplugged = UnpluggedBus(dialect=bus.dialect, station=station)
    with pytest.raises(PortLost) as caught:
        unplugged.run(run(op, 10.0, None))
    assert (caught.value.key, fake.written) == ("sim.unplugged", [(0x1000, 2000)])


def test_a_running_drive_only_gets_its_new_frequency() -> None:
    bus, op = c320(FakeC320(state=sunfar.SunfarState.RUNNING_FORWARD))
    outcome = start(bus, op, 12.0)
    assert bus.sent(sunfar.SunfarControl) == [sunfar.SunfarControl(1, sunfar.SunfarOperation.SET_FREQUENCY, 1200)]
    assert (outcome.status, outcome.key) == (OutcomeStatus.ACKNOWLEDGED, "drives.setpoint_acknowledged")
    assert "reports no set frequency" in i18n.text(outcome.key, "en", **outcome.params)  # no failed read: it has none


def test_an_unanswered_frequency_that_no_read_shows_is_unknown() -> None:
    bus, op = c320(FakeC320(state=sunfar.SunfarState.RUNNING_FORWARD, on_command=lambda fake, request: None))
    outcome = start(bus, op, 12.0)
    assert (outcome.status, outcome.key) == (OutcomeStatus.UNKNOWN, "drives.setpoint_unknown")


@pytest.mark.parametrize(
    ("shown", "status", "key"),
    [
        (1200, OutcomeStatus.CONFIRMED, "drives.setpoint_confirmed"),
        (1000, OutcomeStatus.FAILED, "drives.setpoint_differs"),
        (None, OutcomeStatus.UNKNOWN, "drives.setpoint_unknown"),
        (modbus.ExceptionReply(1, 3, 4), OutcomeStatus.ACKNOWLEDGED, "drives.setpoint_acknowledged"),
    ],
)
def test_an_answered_frequency_is_judged_by_what_the_drive_shows_afterwards(
    shown: Any, status: OutcomeStatus, key: str
) -> None:
    """It answers every write; then it shows this set frequency, falls silent, or rejects the read."""
    fake = FakeModbus()

    def station(request: Any) -> Any:
        reads_setpoint = isinstance(request, modbus.ReadRegisters) and request.register == 0x3001
        if not (reads_setpoint and fake.written) or isinstance(shown, int):
            reply = fake(request)
            fake.registers[0x3001] = shown if isinstance(shown, int) else 0
            return reply
        return shown

    bus, op = vc660(fake)
    fake.registers[0x3000] = 0x0009
    bus.station = station
    outcome = start(bus, op, 12.0)
    assert (outcome.status, outcome.key) == (status, key)
    assert outcome.params.get("found_hz") == (10.0 if status is OutcomeStatus.FAILED else None)


def test_a_set_frequency_that_only_the_last_read_shows_is_neither_confirmed_nor_called_another_one() -> None:
    """Regression: "12.0 Hz was sent, the drive reports 12.0 Hz as its set frequency"."""
    fake = FakeModbus(registers={0x3001: 1000})
    reads = 2 * SETPOINT_READ_TRIES

    def station(request: Any) -> Any:
        nonlocal reads
        reply = fake(request)
        if isinstance(request, modbus.ReadRegisters) and request.register == 0x3001 and fake.written:
            reads -= 1
            return modbus.RegisterValues(1, 3, (1000 if reads else 1200,))
        return reply

    bus, op = vc660(fake)
    fake.registers[0x3000] = 0x0009
    bus.station = station
    outcome = start(bus, op, 12.0)
    assert (outcome.status, outcome.key, reads) == (OutcomeStatus.UNKNOWN, "drives.setpoint_unknown", 0)


def test_a_run_while_the_drive_decelerates_to_a_standstill_is_no_success() -> None:
    """A new frequency is accepted and starts nothing: the motor stands, and exit code 0 would be untrue."""

    def ends_its_ramp(fake: FakeC320, request: sunfar.SunfarControl) -> Any:
        fake.state = sunfar.SunfarState.STOPPED
        return fake.ok()

    for on_command in (ends_its_ramp, None):
        bus, op = c320(FakeC320(state=sunfar.SunfarState.DECELERATING_FORWARD, output=600, on_command=on_command))
        outcome = start(bus, op, hz=20.0)
        assert (outcome.status, outcome.key) == (OutcomeStatus.FAILED, "drives.run_while_decelerating")
        assert "does not start a drive that is being stopped" in outcome.text("en")
        assert len(bus.sent(sunfar.SunfarControl)) == 1


def test_a_run_of_a_decelerating_drive_that_takes_its_new_frequency_up_is_acknowledged() -> None:
    bus, op = c320(FakeC320(state=sunfar.SunfarState.DECELERATING_FORWARD, output=600, on_command=starts))
    outcome = start(bus, op, hz=20.0)
    assert (outcome.status, outcome.key, outcome.notes) == (
        OutcomeStatus.ACKNOWLEDGED,
        "drives.setpoint_acknowledged",
        (),
    )


def test_a_drive_that_decelerates_above_its_new_frequency_may_slow_down_to_it_or_stop() -> None:
    bus, op = c320(FakeC320(state=sunfar.SunfarState.DECELERATING_FORWARD, output=3000))
    outcome = start(bus, op, hz=20.0)
    assert outcome.succeeded
    assert outcome.notes == (("drives.still_decelerating", {"output_hz": 30.0}),)


def test_a_decelerating_drive_that_falls_silent_after_its_new_frequency_has_an_unknown_outcome() -> None:
    fake = FakeC320(state=sunfar.SunfarState.DECELERATING_FORWARD, output=600)

    def falls_silent(station: FakeC320, request: sunfar.SunfarControl) -> Any:
        station.silent = True
        return station.ok()

    fake.on_command = falls_silent
    outcome = start(*c320(fake), hz=20.0)
    assert (outcome.status, outcome.key) == (OutcomeStatus.UNKNOWN, "drives.run_while_decelerating")


@pytest.mark.parametrize("ramp_s", [10, 40, 400, 3000])
@pytest.mark.parametrize("model", ["vc660", "c320"])
def test_a_drive_that_reports_running_while_it_is_stopped_is_not_run_by_a_new_frequency(
    model: str, ramp_s: int
) -> None:
    """A VC660 reports *running* down to standstill: only its falling output frequency shows the stop.

    Two readings of a slow ramp are equal.
    """

    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            drive, hz = bench.drive(), SAFE_HZ[model]
            await drive.run(hz, wait=True)
            bench.station().motor.stop(ramp_s)
            await asyncio.sleep(0.2 * ramp_s * hz / 50)
            with pytest.raises(TargetNotReached) as caught:
                await drive.run(hz)
            assert caught.value.key == "drives.run_while_decelerating"

    run_virtual(scenario())


@pytest.mark.parametrize("output", [1000, 1990, 2000])
def test_a_running_drive_whose_display_does_not_move_is_not_called_stopping(output: int) -> None:
    """The display may be coarser than what the motor gains in 3 s."""
    bus, op = c320(FakeC320(state=sunfar.SunfarState.RUNNING_FORWARD, output=output))
    outcome = start(bus, op, hz=20.0)
    assert (outcome.status, outcome.notes) == (OutcomeStatus.ACKNOWLEDGED, ())
    assert (bus.now > START_CONFIRM_TIMEOUT_S) is (output == 1000)


def test_a_decelerating_drive_that_trips_after_its_new_frequency_is_reported_in_fault() -> None:
    """The sentence of a drive that is being stopped asks to run it again, which a fault forbids."""

    async def scenario() -> None:
        async with SimulatedDrives("vc660", query="ramp=40") as bench:
            drive = bench.drive()
            await drive.run(SAFE_HZ["vc660"])
            await asyncio.sleep(60)
            bench.station().motor.stop()
            await asyncio.sleep(1)
            asyncio.get_running_loop().call_later(0.5, bench.station().trip, Trip.OVERVOLTAGE)
            with pytest.raises(TargetNotReached) as caught:
                await drive.run(SAFE_HZ["vc660"])
            assert (caught.value.key, caught.value.params["state"]) == ("drives.start_failed", "fault")

    run_virtual(scenario())


def test_a_drive_that_reports_its_speed_only_is_not_run_by_a_new_frequency_either() -> None:
    """The frequency was accepted, and the check behind it failed for want of an output frequency."""

    async def scenario() -> None:
        async with SimulatedDrives("huanyang_h2a") as bench:
            drive = bench.drive(options={"maximum_frequency": 400})
            await drive.run(50.0)
            await asyncio.sleep(15)
            bench.station().motor.stop()
            await asyncio.sleep(0.5)
            with pytest.raises(TargetNotReached) as caught:
                await drive.run(50.0)
            assert caught.value.key == "drives.run_while_decelerating"

    run_virtual(scenario())


def test_a_drive_that_slows_down_to_a_lower_frequency_is_run_at_a_higher_one() -> None:
    async def scenario() -> None:
        async with SimulatedDrives("vc660", query="ramp=10") as bench:
            drive = bench.drive()
            await drive.run(40.0, wait=True)
            await drive.run(10.0)
            await asyncio.sleep(2)
            outcome = await drive.run(8.0)
            assert "drives.still_decelerating" in [key for key, _ in outcome.notes]
            assert (await drive.run(30.0)).status is OutcomeStatus.CONFIRMED

    run_virtual(scenario())


def test_a_stop_supersedes_the_run_of_a_decelerating_drive() -> None:
    bus, op = c320(FakeC320(state=sunfar.SunfarState.DECELERATING_FORWARD, output=600))

    def stop_after_the_frequency(request: BusRequest) -> None:
        if isinstance(request.request, sunfar.SunfarControl):
            bus.count_stop()

    bus.on_request = stop_after_the_frequency
    with pytest.raises(Superseded, match="newer stop"):
        start(bus, op, hz=20.0)


def test_a_running_drive_is_not_turned_round() -> None:
    bus, op = c320(FakeC320(state=sunfar.SunfarState.RUNNING_FORWARD))
    with pytest.raises(StartInhibited) as caught:
        start(bus, op, 12.0, Direction.REVERSE)
    assert caught.value.key == "drives.turning"
    assert not bus.effects()
