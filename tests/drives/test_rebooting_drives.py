"""A drive that loses power for a moment: it answers again with its settings lost, stopped or running by itself."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from drivebus.bus.messages import BusRequest
from drivebus.drives.operations.context import VERIFICATION_ROUNDS
from drivebus.drives.operations.start import run
from drivebus.drives.operations.stop import stop
from drivebus.drives.outcome import Outcome, OutcomeStatus
from drivebus.protocols import modbus, sunfar
from fixtures.drives import FakeC320, FakeModbus, PureBus, dialect_for, operation_for

STOPPED, RUNNING = 0x0001, 0x0009
KEYPAD_HZ_WORD = 5000


def vc660(on_command: Callable[[FakeModbus, int], bool]) -> PureBus:
    return PureBus(dialect=dialect_for("vc660"), station=FakeModbus({0x3000: STOPPED, 1: 4}, on_command))


def start(bus: PureBus) -> Outcome:
    return bus.run(run(operation_for(bus.dialect), 10.0, None))


def starts(bus: PureBus) -> int:
    return len(bus.sent(modbus.WriteRegister, register=0x2000, value=1))


def test_no_start_is_sent_to_a_drive_that_has_lost_the_frequency_since_it_confirmed_it() -> None:
    """The state before the start shows it: 50 Hz of the keypad instead of 10 Hz."""
    bus = vc660(lambda fake, word: True)

    def reboots_after_the_read_back(ask: BusRequest) -> None:
        reads = bus.sent(modbus.ReadRegisters, register=0x3001)
        if len(reads) == VERIFICATION_ROUNDS and bus.sent(modbus.WriteRegister, register=0x2001):
            bus.station.registers[0x3001] = KEYPAD_HZ_WORD

    bus.on_request = reboots_after_the_read_back
    outcome = start(bus)
    assert starts(bus) == 0
    assert (outcome.status, outcome.key) == (OutcomeStatus.FAILED, "drives.not_started")
    assert outcome.params["why"].key == "drives.setpoint_differs"


def test_an_unanswered_start_is_not_resent_to_a_drive_that_has_lost_the_frequency() -> None:
    """It would have run up to the 50 Hz of its keypad instead of 10 Hz."""

    def reboots(fake: FakeModbus, word: int) -> bool:
        fake.registers[0x3001] = KEYPAD_HZ_WORD
        return False

    bus = vc660(reboots)
    outcome = start(bus)
    assert starts(bus) == 1
    assert (outcome.status, outcome.key) == (OutcomeStatus.FAILED, "drives.setpoint_differs")
    assert outcome.params == {"expected_hz": 10.0, "found_hz": 50.0}


def test_an_unanswered_start_is_resent_to_a_drive_that_still_has_the_frequency() -> None:
    def lost_once(fake: FakeModbus, word: int) -> bool:
        if starts(bus) < 2:
            return False
        fake.registers[0x3000] = RUNNING
        return True

    bus = vc660(lost_once)
    assert start(bus).status is OutcomeStatus.CONFIRMED and starts(bus) == 2


def test_a_start_is_not_confirmed_of_a_drive_that_runs_by_itself_at_the_frequency_of_its_keypad() -> None:
    """ "Run on power-up": the drive runs again after the interruption, but not at the frequency that was set."""

    def reboots(fake: FakeModbus, word: int) -> bool:
        fake.registers |= {0x3000: RUNNING, 0x3001: KEYPAD_HZ_WORD}
        return True

    outcome = start(vc660(reboots))
    assert (outcome.status, outcome.key) == (OutcomeStatus.FAILED, "drives.setpoint_differs")
    assert outcome.params["found_hz"] == 50.0


def test_the_next_start_after_that_checks_the_settings_of_the_drive_again() -> None:
    def reboots(fake: FakeModbus, word: int) -> bool:
        fake.registers |= {0x3000: RUNNING, 0x3001: KEYPAD_HZ_WORD}
        return True

    bus = vc660(reboots)
    op = operation_for(bus.dialect)
    bus.run(run(op, 10.0, None))
    assert op.drive.preflight is None


@pytest.mark.parametrize("answers", [True, False])
def test_a_stop_goes_on_where_the_drive_runs_by_itself_after_it(answers: bool) -> None:
    """It executed the first stop, lost power, and came back running; only the stop after that one counts."""
    stops: list[int] = []

    def runs_on_power_up(fake: FakeModbus, word: int) -> bool:
        if word & 2:
            stops.append(word)
            fake.registers[0x3000] = RUNNING if len(stops) < 3 else STOPPED
        return answers or len(stops) >= 3

    bus = vc660(runs_on_power_up)
    bus.station.registers[0x3000] = RUNNING
    outcome = bus.run(stop(operation_for(bus.dialect)))
    assert outcome.status is OutcomeStatus.CONFIRMED and len(stops) >= 3


@pytest.mark.parametrize("reboots", [True, False])
def test_a_c320_that_gave_no_reply_after_its_start_may_run_at_another_frequency_and_the_outcome_says_so(
    reboots: bool,
) -> None:
    """It shows no set frequency: "run on power-up" after a power dip looks like the start."""

    def starts(fake: FakeC320, request: sunfar.SunfarControl) -> sunfar.SunfarReply:
        fake.state = sunfar.SunfarState.RUNNING_FORWARD
        fake.silent = reboots
        return fake.ok()

    fake = FakeC320(on_command=starts)
    bus = PureBus(dialect=dialect_for("c320"), station=fake)

    def back_again(ask: BusRequest) -> None:
        fake.silent = fake.silent and bus.now < 1.0

    bus.on_request = back_again
    outcome = bus.run(run(operation_for(bus.dialect), 20.0, None))
    assert (outcome.status, outcome.key) == (OutcomeStatus.CONFIRMED, "drives.start_confirmed")
    assert [key for key, _ in outcome.notes] == (["drives.start_interrupted"] if reboots else [])
    assert all(note.startswith("valid replies were missing") for note in outcome.note_texts("en")), "or not readable"
