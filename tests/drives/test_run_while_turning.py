"""Run of a motor that turns already: a new frequency, which starts nothing where the motor is being stopped."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from drivebus import profiles
from drivebus.bus.messages import BusRequest, BusResult
from drivebus.drives import create_dialect
from drivebus.drives.operations.context import VERIFICATION_ROUNDS, OperationContext
from drivebus.drives.operations.start import START_CONFIRM_TIMEOUT_S, run
from drivebus.drives.outcome import Outcome, OutcomeStatus
from drivebus.drives.state import Direction
from drivebus.errors import PortLost, StartInhibited
from drivebus.protocols import modbus, sunfar
from fixtures.drives import FakeC320, FakeModbus, PureBus, dialect_for, keypad_registers, operation_for, reject_command

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
