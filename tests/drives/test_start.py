"""Start: sent once with a permit, confirmed by verified reads, resent only after reads that show standstill."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import pytest

from drivebus import i18n, profiles
from drivebus.bus.messages import BusRequest
from drivebus.drives import create_dialect
from drivebus.drives.context import DriveLimits
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.setpoint import SETPOINT_READ_TRIES
from drivebus.drives.operations.start import START_CONFIRM_TIMEOUT_S, run
from drivebus.drives.outcome import Outcome, OutcomeStatus
from drivebus.drives.state import Direction
from drivebus.errors import (
    CapabilityError,
    Expired,
    LimitError,
    PreflightError,
    StartInhibited,
    Superseded,
    TargetNotReached,
)
from drivebus.protocols import dzb100, modbus, sunfar
from drivebus.protocols.codec import Effect
from drivebus.simulator.motor import Trip
from drivebus.values import bilingual_text
from fixtures.drives import (
    SAFE_HZ,
    FakeC320,
    FakeModbus,
    PureBus,
    SimulatedDrives,
    context_for,
    dialect_for,
    keypad_registers,
    operation_for,
    reject_command,
    run_virtual,
)

ON_320 = sunfar.SunfarOperation.RUN_FORWARD_AT


def c320(fake: FakeC320, **limits: Any) -> tuple[PureBus, OperationContext]:
    dialect = dialect_for("c320")
    return PureBus(dialect=dialect, station=fake), operation_for(dialect, limits=DriveLimits(**limits))


def vc660(fake: FakeModbus) -> tuple[PureBus, OperationContext]:
    dialect = dialect_for("vc660")
    fake.registers |= {0x3000: 0x0001, 1: 4}
    return PureBus(dialect=dialect, station=fake), operation_for(dialect)


def df800(fake: FakeModbus, **settings: Any) -> tuple[PureBus, OperationContext]:
    dialect = dialect_for("df800", **settings)
    fake.registers |= {101: 5, 102: 2, 107: 100, 108: 50}
    return PureBus(dialect=dialect, station=fake), operation_for(dialect)


def starts(fake: FakeC320, request: sunfar.SunfarControl) -> Any:
    fake.state = sunfar.SunfarState.ACCELERATING_FORWARD
    return fake.ok()


def start(bus: PureBus, op: OperationContext, hz: float = 10.0, direction: Direction | None = None) -> Outcome:
    return bus.run(run(op, hz, direction))


def test_a_start_is_one_frame_with_its_frequency_and_confirmed_by_later_reads() -> None:
    bus, op = c320(FakeC320(on_command=starts))
    outcome = start(bus, op)
    assert (outcome.status, outcome.key) == (OutcomeStatus.CONFIRMED, "drives.start_confirmed")
    assert bus.sent(sunfar.SunfarControl) == [sunfar.SunfarControl(1, ON_320, 1000)]
    assert outcome.exchanges[-1].sent_at is not None


@pytest.mark.parametrize(
    ("hz", "on_command", "is_noted"), [(0.0, starts, True), (1.0, starts, False), (0.0, None, False)]
)
def test_a_run_at_0_hz_that_succeeded_says_that_the_motor_does_not_turn(
    hz: float, on_command: Any, is_noted: bool
) -> None:
    outcome = start(*c320(FakeC320(on_command=on_command)), hz=hz)
    assert ("drives.run_at_zero" in dict(outcome.notes)) is is_noted


FASTER = sunfar.SunfarState.RUNNING_FORWARD


@pytest.mark.parametrize(
    ("shown", "state", "found_hz"),
    [
        ((1300, 1300), FASTER, None),
        ((1301, 1301), FASTER, 13.01),
        ((1400, 1500), FASTER, 15.0),
        ((1500, 1400), FASTER, None),
        ((1200, 1500), FASTER, None),
        ((1500, 1500), sunfar.SunfarState.ACCELERATING_FORWARD, 15.0),
        ((1500, 1500), sunfar.SunfarState.RESTARTING, None),
    ],
    ids=["tolerated", "too fast", "rising", "falling", "once", "accelerating", "caught by a speed search"],
)
@pytest.mark.parametrize("is_stoppable", [True, False])
def test_a_start_stops_a_drive_that_two_reads_show_too_fast(
    shown: tuple[int, int], state: int, found_hz: float | None, is_stoppable: bool
) -> None:
    """No wait for the speed is needed for that: 10 Hz was sent, 3 Hz more are tolerated."""

    def races(fake: FakeC320, request: sunfar.SunfarControl) -> Any:
        fake.state = state if request.operation == ON_320 or not is_stoppable else sunfar.SunfarState.STOPPED
        return fake.ok()

    fake = FakeC320(on_command=races)
    bus, op = c320(fake)

    def show(ask: Any) -> None:
        if bus.effects():
            reads = len([one for one in bus.requests if isinstance(one.request, sunfar.ReadMonitor)])
            fake.output = shown[reads % 2] if fake.state == state else 0

    bus.on_request = show
    if found_hz is None:
        assert start(bus, op).status is OutcomeStatus.CONFIRMED
        return
    with pytest.raises(TargetNotReached) as caught:
        start(bus, op)
    assert (caught.value.key, caught.value.params["found_hz"]) == ("drives.overspeed", found_hz)
    assert caught.value.outcome.status is (OutcomeStatus.FAILED if is_stoppable else OutcomeStatus.UNKNOWN)
    assert bus.sent(sunfar.SunfarControl, operation=sunfar.SunfarOperation.STOP)


def test_a_start_whose_reply_says_ok_is_not_confirmed_by_it() -> None:
    """The drive accepts and does not move: failed, never confirmed."""
    bus, op = c320(FakeC320())
    outcome = start(bus, op)
    assert (outcome.status, outcome.key) == (OutcomeStatus.FAILED, "drives.start_ignored")
    assert len(bus.sent(sunfar.SunfarControl)) == 1
    assert 3.0 < bus.now < 4.0, "it has three seconds to report running"


def test_after_a_start_that_the_drive_ignored_the_next_one_reads_its_preconditions_again() -> None:
    bus, op = c320(FakeC320())
    start(bus, op)
    read = len(bus.sent(sunfar.SunfarReadParameter, group=0))
    assert start(bus, OperationContext(op.drive)).key == "drives.start_ignored"
    assert len(bus.sent(sunfar.SunfarReadParameter, group=0)) == 2 * read > 0


def test_a_start_after_which_the_readings_contradict_each_other_is_unknown() -> None:
    fake = FakeC320()
    bus, op = c320(fake)

    def flips(ask: Any) -> None:
        if bus.effects() and isinstance(ask.request, sunfar.ReadMonitor):
            fake.state = (
                sunfar.SunfarState.STOPPED if fake.state != sunfar.SunfarState.STOPPED else sunfar.SunfarState.FAULT
            )

    bus.on_request = flips
    outcome = start(bus, op)
    assert (outcome.status, outcome.key) == (OutcomeStatus.UNKNOWN, "drives.start_unknown")


def test_an_unanswered_start_is_resent_at_standstill_also_after_a_state_that_was_not_read() -> None:
    lost = [True]

    def first_is_lost(fake: FakeC320, request: sunfar.SunfarControl) -> Any:
        return None if lost and lost.pop() else starts(fake, request)

    fake = FakeC320(on_command=first_is_lost)
    bus, op = c320(fake)
    bus.on_request = lambda ask: setattr(fake, "silent", bool(bus.effects()) and bus.now < 0.8)
    assert start(bus, op).status is OutcomeStatus.CONFIRMED
    assert len(bus.sent(sunfar.SunfarControl)) == 2


def test_every_confirming_read_has_its_own_sync_probe_before_it() -> None:
    bus, op = c320(FakeC320(on_command=starts))
    start(bus, op)
    place = next(i for i, ask in enumerate(bus.requests) if isinstance(ask.request, sunfar.SunfarControl))
    after = [ask.request for ask in bus.requests[place + 1 :]]
    assert [type(r) for r in after] == [sunfar.SunfarReadParameter, sunfar.ReadMonitor] * 2
    probes = [r for r in after if isinstance(r, sunfar.SunfarReadParameter)]
    assert all(f.group != 0 for f in probes)
    assert probes[0] != probes[1]


def test_an_unanswered_start_is_resent_after_two_verified_reads_show_standstill() -> None:
    lost = [True]

    def first_is_lost(fake: FakeC320, request: sunfar.SunfarControl) -> Any:
        return None if lost and lost.pop() else starts(fake, request)

    bus, op = c320(FakeC320(on_command=first_is_lost))
    outcome = start(bus, op)
    assert outcome.status is OutcomeStatus.CONFIRMED
    places = [i for i, ask in enumerate(bus.requests) if isinstance(ask.request, sunfar.SunfarControl)]
    assert len(places) == 2
    between = [type(ask.request) for ask in bus.requests[places[0] + 1 : places[1]]]
    assert between == [sunfar.SunfarReadParameter, sunfar.ReadMonitor] * 2


def test_a_start_whose_reply_was_lost_is_not_sent_twice() -> None:
    """Executed, the reply lost: the reads show running and nothing is repeated."""

    def reply_lost(fake: FakeC320, request: sunfar.SunfarControl) -> Any:
        fake.state = sunfar.SunfarState.RUNNING_FORWARD

    bus, op = c320(FakeC320(on_command=reply_lost))
    outcome = start(bus, op)
    assert outcome.status is OutcomeStatus.CONFIRMED
    assert len(bus.sent(sunfar.SunfarControl)) == 1


@pytest.mark.parametrize(
    ("then", "key"),
    [
        (sunfar.SunfarState.STOPPED, "drives.started_and_stopped"),
        (sunfar.SunfarState.FAULT, "drives.started_and_tripped"),
        (sunfar.SunfarState.NOT_READY, "drives.started_and_tripped"),
    ],
)
def test_a_stop_at_the_keypad_is_never_undone_and_a_trip_is_not_called_one(then: sunfar.SunfarState, key: str) -> None:
    """Running was seen once after the unanswered start; then a person stops the drive, or it trips: no resend."""
    reads = []

    def reply_lost(fake: FakeC320, request: sunfar.SunfarControl) -> Any:
        fake.state = sunfar.SunfarState.RUNNING_FORWARD

    fake = FakeC320(on_command=reply_lost)
    bus, op = c320(fake)

    def person(ask: Any) -> None:
        if isinstance(ask.request, sunfar.ReadMonitor) and fake.state == sunfar.SunfarState.RUNNING_FORWARD:
            reads.append(ask)
            fake.state, fake.fault_code = then, 7 if then is sunfar.SunfarState.FAULT else fake.fault_code

    bus.on_request = person
    outcome = start(bus, op)
    assert reads
    assert (outcome.status, outcome.key) == (OutcomeStatus.FAILED, key)
    assert len(bus.sent(sunfar.SunfarControl)) == 1


def test_an_unanswered_start_is_not_resent_once_it_is_two_seconds_old() -> None:
    bus, op = c320(FakeC320(on_command=lambda fake, request: None))
    bus.silence_s = 2.1
    outcome = start(bus, op)
    assert outcome.status is not OutcomeStatus.CONFIRMED
    assert len(bus.sent(sunfar.SunfarControl)) == 1


def test_an_unanswered_start_is_sent_three_times_at_most() -> None:
    bus, op = c320(FakeC320(on_command=lambda fake, request: None))
    bus.silence_s = bus.transaction_s = 0.001
    outcome = start(bus, op)
    assert outcome.status is OutcomeStatus.FAILED
    assert len(bus.sent(sunfar.SunfarControl)) == 3


def test_a_stop_that_comes_while_a_start_waits_to_be_confirmed_ends_it() -> None:
    """The stop increments the stop epoch; the start is superseded and not resent."""
    bus, op = c320(FakeC320(on_command=lambda fake, request: None))

    def stop_comes(ask: Any) -> None:
        if isinstance(ask.request, sunfar.SunfarControl):
            from dataclasses import replace

            bus.conditions = replace(bus.conditions, stop_epoch=bus.conditions.stop_epoch + 1)

    bus.on_request = stop_comes
    with pytest.raises(Superseded) as caught:
        start(bus, op)
    assert caught.value.outcome.status is OutcomeStatus.UNKNOWN
    assert len(bus.sent(sunfar.SunfarControl)) == 1


def test_a_withdrawn_start_without_reply_is_not_resent_and_its_effect_is_still_read() -> None:
    bus, op = c320(FakeC320(on_command=lambda fake, request: None))

    def is_withdrawn(ask: Any) -> None:
        if isinstance(ask.request, sunfar.SunfarControl):
            op.drive.withdrawal = Superseded("drives.superseded")

    bus.on_request = is_withdrawn
    outcome = start(bus, op)
    assert (outcome.status, outcome.key) == (OutcomeStatus.FAILED, "drives.start_ignored")
    assert len(bus.sent(sunfar.SunfarControl)) == 1


def test_a_drive_that_falls_silent_after_the_start_leaves_the_outcome_unknown() -> None:
    def dies(fake: FakeC320, request: sunfar.SunfarControl) -> Any:
        fake.silent = True

    bus, op = c320(FakeC320(on_command=dies))
    outcome = start(bus, op)
    assert (outcome.status, outcome.key) == (OutcomeStatus.UNKNOWN, "drives.start_unknown")
    assert len(bus.sent(sunfar.SunfarControl)) == 1


def test_a_rejected_start_is_refused() -> None:
    bus, op = c320(FakeC320(on_command=reject_command))
    outcome = start(bus, op)
    assert (outcome.status, outcome.params["code"]) == (OutcomeStatus.REFUSED, 1)


def test_a_drive_that_trips_on_the_start_did_not_start() -> None:
    def trips(fake: FakeC320, request: sunfar.SunfarControl) -> Any:
        fake.state, fake.fault_code = sunfar.SunfarState.FAULT, 7
        return fake.ok()

    bus, op = c320(FakeC320(on_command=trips))
    outcome = start(bus, op)
    assert (outcome.status, outcome.key) == (OutcomeStatus.FAILED, "drives.start_failed")
    assert bus.now < 1.0
    [(key, params)] = outcome.notes
    assert (key, params["fault"].en) == ("drives.fault_named", "fault Fu.7: see the fault table of the C320 manual")
    assert (
        outcome.drive_status is not None
        and outcome.drive_status.fault is not None
        and outcome.drive_status.fault.code == 7
    )


@pytest.mark.parametrize("state", [sunfar.SunfarState.NOT_READY, sunfar.SunfarState.EMERGENCY_STOP])
def test_a_drive_without_supply_or_in_emergency_stop_after_the_start_is_reported_at_once(state: int) -> None:
    def refuses(fake: FakeC320, request: sunfar.SunfarControl) -> Any:
        fake.state = state
        return fake.ok()

    bus, op = c320(FakeC320(on_command=refuses))
    outcome = start(bus, op)
    assert (outcome.status, outcome.key) == (OutcomeStatus.FAILED, "drives.start_failed") and bus.now < 1.0


@pytest.mark.parametrize("direction", [None, Direction.FORWARD])
def test_a_drive_that_turns_the_other_way_is_a_failure(direction: Direction | None) -> None:
    """A start without a direction is a start forward."""

    def wrong(fake: FakeC320, request: sunfar.SunfarControl) -> Any:
        fake.state = sunfar.SunfarState.RUNNING_REVERSE
        return fake.ok()

    bus, op = c320(FakeC320(on_command=wrong))
    outcome = start(bus, op, direction=direction)
    assert (outcome.status, outcome.key) == (OutcomeStatus.FAILED, "drives.wrong_direction")


def test_vc660_that_reports_reverse_after_a_plain_start_is_a_failure() -> None:
    def wrong(fake: FakeModbus, word: int) -> bool:
        fake.registers[0x3000] = 0xC009
        return True

    bus, op = vc660(FakeModbus(on_command=wrong))
    outcome = start(bus, op)
    assert (outcome.key, outcome.params["expected"]) == ("drives.wrong_direction", Direction.FORWARD)


def test_a_drive_without_a_readable_setpoint_is_confirmed_without_a_note_about_it() -> None:
    bus, op = c320(FakeC320(on_command=starts))
    assert start(bus, op).notes == ()


def test_a_model_that_shows_neither_set_nor_output_frequency_is_confirmed_with_a_note_about_it() -> None:
    profile = profiles.load("c320")
    hidden = {name: signal for name, signal in profile.signals.items() if name != "output_frequency"}
    dialect = create_dialect(replace(profile, signals=hidden), 1, options={"setpoint_step": "0.01"})
    bus = PureBus(dialect=dialect, station=FakeC320(on_command=starts))
    outcome = start(bus, operation_for(dialect))
    assert outcome.status is OutcomeStatus.CONFIRMED
    assert outcome.notes == (("drives.setpoint_not_shown", {"frequency_hz": 10.0}),)


@pytest.mark.parametrize(
    ("hz", "limits", "key"),
    [
        (50.01, {}, "drives.above_maximum"),
        (30.0, {"maximum_hz": 25.0}, "drives.above_maximum"),
        (60.0, {"maximum_hz": 100.0}, "drives.above_maximum"),
        (4.99, {"minimum_hz": 5.0}, "drives.below_minimum"),
        (-1.0, {}, "drives.below_minimum"),
        (float("nan"), {}, "drives.above_maximum"),
        (float("inf"), {}, "drives.above_maximum"),
    ],
)
def test_a_frequency_outside_the_limits_is_refused_before_anything_is_sent(hz: float, limits: Any, key: str) -> None:
    bus, op = c320(FakeC320(), **limits)
    with pytest.raises(LimitError) as caught:
        start(bus, op, hz)
    assert caught.value.key == key
    assert not bus.requests


def test_a_forbidden_direction_is_refused_before_anything_is_sent() -> None:
    bus, op = c320(FakeC320(), reverse=False)
    with pytest.raises(LimitError):
        start(bus, op, 10.0, Direction.REVERSE)
    assert not bus.requests


def test_a_drive_that_can_not_tell_its_direction_is_not_started_where_one_is_forbidden() -> None:
    dialect = dialect_for("df800")
    bus = PureBus(dialect=dialect, station=FakeModbus())
    with pytest.raises(LimitError) as caught:
        start(bus, operation_for(dialect, limits=DriveLimits(reverse=False)))
    assert caught.value.key == "drives.direction_forbidden"
    assert not bus.requests


def test_what_the_drive_makes_of_a_frequency_is_within_the_limits_too() -> None:
    """In steps of 1 Hz 10.6 Hz is 11 Hz."""
    dialect = dialect_for("dzb100", setpoint_coding="hex-1")
    memory = context_for(dialect, DriveLimits(maximum_hz=10.6))
    assert memory.check_frequency(10.4) == (10, 10.0)
    with pytest.raises(LimitError) as caught:
        memory.check_frequency(10.6)
    assert caught.value.params["frequency_hz"] == 11.0


def test_a_drive_that_ignores_the_bus_is_named_with_its_keypad_step() -> None:
    bus, op = c320(FakeC320(parameters={(0, 1): 0}))
    with pytest.raises(PreflightError) as caught:
        start(bus, op)
    assert caught.value.params["parameters"] == ("F0.1",)
    unmet = {"notation": "F0.1", "found": 0, "keypad": bus.dialect.profile.preconditions[0].keypad}
    assert caught.value.params["steps"] == bilingual_text("drives.precondition_unmet", **unmet)
    assert str(caught.value) == (
        "c320 at station 1 does not accept commands from the bus: F0.1 reads 0: Set F0.1 = 2 (frequency from RS485)."
    )
    assert not bus.effects()


def test_a_drive_in_fault_is_not_started() -> None:
    bus, op = c320(FakeC320(state=sunfar.SunfarState.FAULT, fault_code=3))
    with pytest.raises(StartInhibited) as caught:
        start(bus, op)
    assert caught.value.params["state"] == "fault"
    assert not bus.effects()


def test_a_drive_whose_state_flickers_is_not_started() -> None:
    states = [sunfar.SunfarState.STOPPED, sunfar.SunfarState.FAULT]

    class Flickers(FakeC320):
        def __call__(self, request: Any) -> Any:
            if isinstance(request, sunfar.ReadMonitor):
                states.reverse()
                self.state = states[0]
            return super().__call__(request)

    bus, op = c320(Flickers())
    with pytest.raises(StartInhibited):
        start(bus, op)
    assert not bus.effects()


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
            bus.conditions = replace(bus.conditions, stop_epoch=bus.conditions.stop_epoch + 1)

    bus.on_request = stop_after_the_frequency
    with pytest.raises(Superseded, match="newer stop"):
        start(bus, op, hz=20.0)


def test_a_running_drive_is_not_turned_round() -> None:
    bus, op = c320(FakeC320(state=sunfar.SunfarState.RUNNING_FORWARD))
    with pytest.raises(StartInhibited) as caught:
        start(bus, op, 12.0, Direction.REVERSE)
    assert caught.value.key == "drives.turning"
    assert not bus.effects()


def test_vc660_sets_the_frequency_reads_it_back_and_only_then_starts() -> None:
    def obey(fake: FakeModbus, word: int) -> bool:
        if word & 1:
            fake.registers[0x3000] = 0x0009
        return True

    fake = FakeModbus(on_command=obey)
    bus, op = vc660(fake)
    outcome = start(bus, op)
    assert outcome.status is OutcomeStatus.CONFIRMED
    assert fake.written == [(0x2001, 1000), (0x2000, 0x0001), (0x2000, 0x0000)]
    place = next(i for i, ask in enumerate(bus.requests) if getattr(ask.request, "value", None) == 1)
    assert not [ask for ask in bus.requests[place:] if getattr(ask.request, "register", 0) == 0x3001], "once is enough"


def test_a_stop_between_the_frequency_and_the_start_ends_the_start() -> None:
    fake = FakeModbus()
    bus, op = vc660(fake)

    def stop_comes(ask: Any) -> None:
        if getattr(ask.request, "register", 0) == 0x2001:
            bus.conditions = replace(bus.conditions, stop_epoch=bus.conditions.stop_epoch + 1)

    bus.on_request = stop_comes
    with pytest.raises(Superseded, match="newer stop"):
        start(bus, op)
    assert [register for register, _ in fake.written] == [0x2001]


def test_a_drive_whose_maximum_frequency_changes_before_the_start_is_not_started() -> None:
    """SKF8000: its frequency is a share of P0-10, which is doubled at the keypad."""
    profile = profiles.load("skf8000")
    fake = FakeModbus(registers=keypad_registers(profile) | {0xF00A: 5000, 0x3000: 3, 0x7001: 1000})
    dialect = create_dialect(profile, 1)
    bus = PureBus(dialect=dialect, station=fake)
    bus.on_request = lambda ask: fake.registers.update({0xF00A: 10000}) if fake.written else None
    outcome = start(bus, operation_for(dialect))
    assert (outcome.status, outcome.key) == (OutcomeStatus.FAILED, "drives.not_started")
    assert outcome.params["why"].key == "drives.maximum_changed" and fake.written == [(0x1000, 2000)]


def test_vc660_that_does_not_take_the_frequency_is_not_started() -> None:
    class Deaf(FakeModbus):
        def __call__(self, request: Any) -> Any:
            reply = super().__call__(request)
            self.registers[0x3001] = 300
            return reply

    fake = Deaf()
    bus, op = vc660(fake)
    outcome = start(bus, op)
    assert (outcome.status, outcome.key) == (OutcomeStatus.FAILED, "drives.not_started")
    assert outcome.params["why"].key == "drives.setpoint_differs"
    assert [register for register, _ in fake.written] == [0x2001]
    assert Effect.MOTION not in bus.effects()


@pytest.mark.parametrize("model", ["vc660", "df800"])
def test_a_start_withheld_after_its_frequency_was_sent_has_an_outcome(model: str) -> None:
    """Expired and StartInhibited mean that nothing was sent; here the drive already has a new frequency."""
    fake = FakeModbus()
    bus, op = vc660(fake) if model == "vc660" else df800(fake)
    bus.on_request = lambda ask: bus.pass_time(6.0 if getattr(ask.request, "register", 0) == 0x2001 else 0.0)
    outcome = start(bus, op, 10.0)
    assert outcome.status is OutcomeStatus.FAILED and outcome.key == "drives.not_started"
    assert isinstance(outcome.params["why"], Expired)
    assert bus.sent(modbus.WriteRegister, register=0x2001) and not bus.sent(modbus.WriteRegister, register=0x2000)


def test_a_resend_that_is_not_allowed_any_more_does_not_hide_that_the_start_was_sent() -> None:
    """StartInhibited means that nothing was sent. Two reads showed standstill, so the start is known to have failed."""
    bus, op = c320(FakeC320(on_command=lambda fake, request: None))

    def seen(ask: Any) -> None:
        if isinstance(ask.request, sunfar.SunfarControl):
            bus.conditions = replace(bus.conditions, duplicate_address=True)

    bus.on_request = seen
    outcome = start(bus, op)
    assert (outcome.status, outcome.key) == (OutcomeStatus.FAILED, "drives.start_ignored")
    assert len(bus.sent(sunfar.SunfarControl)) == 1


def test_what_follows_a_pulse_may_be_withheld_without_hiding_the_pulse() -> None:
    """VC660: another drive shows up at its address between the pulse and its end; the start has left."""
    fake = FakeModbus(on_command=lambda fake, word: fake.registers.update({0x3000: 0x0009}) is None)
    bus, op = vc660(fake)

    def seen(ask: Any) -> None:
        if getattr(ask.request, "register", 0) == 0x2000:
            bus.conditions = replace(bus.conditions, duplicate_address=True)

    bus.on_request = seen
    assert start(bus, op).status is OutcomeStatus.CONFIRMED
    assert fake.written == [(0x2001, 1000), (0x2000, 0x0001)]


def test_the_end_of_a_pulse_that_expires_does_not_hide_the_pulse() -> None:
    """VC660: the reply to its pulse took longer than a start may be old."""
    fake = FakeModbus(on_command=lambda fake, word: fake.registers.update({0x3000: 0x0009}) is None)
    bus, op = vc660(fake)
    bus.on_request = lambda ask: bus.pass_time(2.1 if getattr(ask.request, "register", 0) == 0x2000 else 0.0)
    assert start(bus, op).status is OutcomeStatus.CONFIRMED
    assert fake.written == [(0x2001, 1000), (0x2000, 0x0001)]


def test_a_stop_between_a_pulse_and_its_end_leaves_a_start_of_which_the_outcome_is_unknown() -> None:
    fake = FakeModbus(on_command=lambda fake, word: fake.registers.update({0x3000: 0x0009}) is None)
    bus, op = vc660(fake)

    def stop_comes(ask: Any) -> None:
        if getattr(ask.request, "register", 0) == 0x2000:
            bus.conditions = replace(bus.conditions, stop_epoch=bus.conditions.stop_epoch + 1)

    bus.on_request = stop_comes
    with pytest.raises(Superseded) as caught:
        start(bus, op)
    assert caught.value.outcome.status is OutcomeStatus.UNKNOWN
    assert fake.written == [(0x2001, 1000), (0x2000, 0x0001)]


def test_an_unanswered_pulse_of_vc660_is_not_repeated_when_the_drive_runs() -> None:
    def obeys_silently(fake: FakeModbus, word: int) -> bool:
        if word & 1:
            fake.registers[0x3000] = 0x0009
            return False
        return True

    fake = FakeModbus(on_command=obeys_silently)
    bus, op = vc660(fake)
    assert start(bus, op).status is OutcomeStatus.CONFIRMED
    assert [value for register, value in fake.written if register == 0x2000] == [0x0001, 0x0000]


def test_df800_is_started_on_its_preflight_and_only_acknowledged() -> None:
    fake = FakeModbus()
    bus, op = df800(fake)
    outcome = start(bus, op)
    assert (outcome.status, outcome.key) == (OutcomeStatus.ACKNOWLEDGED, "drives.start_acknowledged")
    assert fake.written == [(0x2001, 1000), (0x2000, 0x0002)]
    assert outcome.drive_status is not None and outcome.drive_status.state == "unknown"


def test_df800_reads_its_preflight_before_every_start() -> None:
    fake = FakeModbus()
    bus, op = df800(fake)
    start(bus, op)
    fake.registers[102] = 0
    with pytest.raises(PreflightError) as caught:
        start(bus, OperationContext(op.drive))
    assert caught.value.params["parameters"] == ("F1.02",)


def test_an_unanswered_start_of_df800_is_never_resent() -> None:
    fake = FakeModbus(on_command=lambda fake, word: False)
    bus, op = df800(fake)
    outcome = start(bus, op)
    assert (outcome.status, outcome.key) == (OutcomeStatus.UNKNOWN, "drives.start_unknown")
    assert [value for register, value in fake.written if register == 0x2000] == [0x0002]


@pytest.mark.parametrize("direction", list(Direction))
def test_an_explicit_direction_on_df800_needs_its_calibration(direction: Direction) -> None:
    fake = FakeModbus()
    bus, op = df800(fake)
    with pytest.raises(StartInhibited) as caught:
        start(bus, op, 10.0, direction)
    assert caught.value.key == "drives.direction_uncalibrated"
    assert not bus.requests


def test_waiting_is_refused_where_nothing_shows_the_frequency() -> None:
    bus, op = df800(FakeModbus())
    with pytest.raises(CapabilityError) as caught:
        bus.run(run(op, 10.0, None, will_wait=True))
    assert caught.value.key == "drives.cannot_wait"
    assert not bus.requests
    assert bus.run(run(op, 10.0, None)).key == "drives.start_acknowledged"


def test_a_capability_that_the_model_lacks_is_refused_before_sending() -> None:
    from dataclasses import replace

    dialect = dialect_for("c320")
    dialect.profile = replace(dialect.profile, capabilities=frozenset({"status"}))
    bus = PureBus(dialect=dialect, station=FakeC320())
    with pytest.raises(CapabilityError):
        start(bus, OperationContext(context_for(dialect)))
    assert not bus.requests


def test_a_precondition_that_can_not_be_read_is_named_and_not_assumed() -> None:
    """VC660 F01.00: its address is unknown until the user supplies the group sizes."""

    def obey(fake: FakeModbus, word: int) -> bool:
        fake.registers[0x3000] = 0x0009
        return True

    bus, op = vc660(FakeModbus(on_command=obey))
    outcome = start(bus, op)
    assert [params["notation"] for key, params in outcome.notes if key == "drives.precondition_unread"] == ["F01.00"]


def test_a_drive_that_runs_at_another_set_frequency_is_not_confirmed() -> None:
    """A class-4 reply could say anything; what the drive shows counts (wrong scale, wrong drive)."""
    from drivebus.drives.operations.start import _check_setpoint

    fake = FakeModbus(registers={0x3001: 100})
    bus, op = vc660(fake)
    fake.registers[0x3001] = 100
    with pytest.raises(TargetNotReached):
        bus.run(
            _check_setpoint(
                op, op.outcome(OutcomeStatus.CONFIRMED, "drives.start_confirmed"), 1000, 10.0, has_lost=False
            )
        )


def test_modbus_errors_of_the_drive_are_refusals() -> None:
    class Refuses(FakeModbus):
        def __call__(self, request: Any) -> Any:
            if isinstance(request, modbus.WriteRegister) and request.register == 0x2000:
                return modbus.ExceptionReply(1, 6, None)
            return super().__call__(request)

    bus, op = df800(Refuses())
    outcome = start(bus, op)
    assert (outcome.status, outcome.key) == (OutcomeStatus.REFUSED, "drives.start_refused")
    assert "no such parameter, or it is locked" in outcome.text("en")


def test_a_rejected_set_frequency_is_named_and_no_start_is_sent() -> None:
    class Refuses(FakeModbus):
        def __call__(self, request: Any) -> Any:
            if isinstance(request, modbus.WriteRegister) and request.register == 0x2001:
                return modbus.ExceptionReply(1, 6, 3)
            return super().__call__(request)

    fake = Refuses()
    bus, op = vc660(fake)
    outcome = start(bus, op)
    assert (outcome.status, outcome.params["code"]) == (OutcomeStatus.REFUSED, 3)
    assert outcome.key == "drives.start_setpoint_refused"
    assert "rejected the set frequency of 10.0 Hz, and no start was sent" in outcome.text("en")
    assert ("drives.modbus_remedy_3", {}) in outcome.notes
    assert fake.written == []


def test_a_precondition_whose_read_is_rejected_is_no_wrong_setting() -> None:
    class Refuses(FakeC320):
        def __call__(self, request: Any) -> Any:
            if isinstance(request, sunfar.SunfarReadParameter) and request.group == 0:
                state = sunfar.SunfarState.STOPPED
                return sunfar.SunfarReply(
                    address=1, response=sunfar.SunfarResponse.RUNNING, state=state, group=0, item=1, data=0
                )
            return super().__call__(request)

    bus, op = c320(Refuses())
    with pytest.raises(PreflightError) as caught:
        start(bus, op)
    assert caught.value.key == "drives.preflight_refused"
    assert "the read of F0.1 was not answered with a value" in caught.value.text("en")
    assert "Set F0.1" not in caught.value.text("en") and not bus.effects()


class RejectsStatus(FakeModbus):
    """Fake Modbus registers whose status register 3000H is busy: exception 6."""

    def __call__(self, request: Any) -> Any:
        if isinstance(request, modbus.ReadRegisters) and request.register == 0x3000:
            return modbus.ExceptionReply(request.address, 3, 6)
        return super().__call__(request)


@pytest.mark.parametrize(
    ("station", "why"),
    [
        (RejectsStatus(), ("the drive rejected the request with exception 6", "变频器拒绝，异常码 6")),
        (FakeModbus(), ("bits that must be 0 are set", "应为 0 的位被置位")),
    ],
    ids=["exception 6", "reserved bit 9"],
)
def test_a_start_in_an_unknown_state_names_the_reason_and_no_report_of_the_drive(
    station: FakeModbus, why: tuple[str, str]
) -> None:
    bus, op = vc660(station)
    station.registers[0x3000] = 0x0200
    with pytest.raises(StartInhibited) as caught:
        start(bus, op)
    assert caught.value.key == "drives.state_not_known" and station.written == []
    texts = caught.value.text("en"), caught.value.text("zh")
    assert texts[0].startswith("no start is sent: the state of the drive is not known (")
    assert texts[1].startswith("不发送启动：变频器状态未知（")
    assert why[0] in texts[0] and why[1] in texts[1]


KEYPAD_DZB100 = {0: 2, 1: 3}  # frequency and commands from RS485


@dataclass
class FakeDzb100:
    """Fake DZB100: answers reads and queries, and takes each command unless ``on_command`` is another one."""

    items: dict[int, int] = field(default_factory=dict)
    on_command: Callable[[FakeDzb100, dzb100.Dzb100Control], bool] = lambda fake, request: True

    def __call__(self, request: Any) -> Any:
        if isinstance(request, dzb100.Dzb100Control):
            self.items |= {0: request.data, 1: request.data, 3: request.command << 12}
            if not self.on_command(self, request):
                return None
        if isinstance(request, dzb100.Dzb100Query):
            data = self.items.get(request.item, 0)
        else:
            data = (
                KEYPAD_DZB100.get(request.index, 0) if isinstance(request, dzb100.Dzb100ReadParameter) else request.data
            )
        return dzb100.Dzb100Reply(head=chr(request.head), address=1, index=request.index, data=data, accepted=True)


def start_dzb100(fake: FakeDzb100, **options: Any) -> tuple[PureBus, Outcome]:
    bus = PureBus(dialect=dialect_for("dzb100", **options), station=fake)
    return bus, start(bus, operation_for(bus.dialect), hz=0.5)


@pytest.mark.parametrize("is_shown", [True, False])
def test_the_frequency_of_a_dzb100_is_read_back_after_its_start_and_a_note_says_where_it_is_not_shown(
    is_shown: bool,
) -> None:
    def executes(fake: FakeDzb100, request: dzb100.Dzb100Control) -> bool:
        fake.items[0] = request.data if is_shown else 0x7777
        return True

    bus, outcome = start_dzb100(FakeDzb100(on_command=executes))
    assert outcome.status is OutcomeStatus.CONFIRMED
    assert ("drives.setpoint_not_shown" in dict(outcome.notes)) is not is_shown
    assert outcome.exchanges[-1].sent == bus.dialect.codec.encode_request(bus.requests[-1].request)


def test_the_frequency_of_a_start_that_a_dzb100_ignored_is_not_read_back() -> None:
    def ignores(fake: FakeDzb100, request: dzb100.Dzb100Control) -> bool:
        fake.items.clear()
        return True

    _, outcome = start_dzb100(FakeDzb100(on_command=ignores))
    assert (outcome.status, outcome.key, outcome.notes) == (OutcomeStatus.FAILED, "drives.start_ignored", ())


def test_an_unanswered_start_that_a_dzb100_shows_as_its_last_command_is_not_resent() -> None:
    """It has executed the start and was stopped at its keypad since."""

    def is_stopped_at_once(fake: FakeDzb100, request: dzb100.Dzb100Control) -> bool:
        fake.items[1] = 0
        return False

    bus, outcome = start_dzb100(FakeDzb100(on_command=is_stopped_at_once))
    assert outcome.status is OutcomeStatus.FAILED
    assert len(bus.sent(dzb100.Dzb100Control)) == 1


def test_a_frequency_of_a_dzb100_whose_coding_is_not_determined_stops_nothing() -> None:
    """The quality of such a frequency is uncertain: 100 may be 100 Hz, 10 Hz or 1 Hz."""

    def shows_another_coding(fake: FakeDzb100, request: dzb100.Dzb100Control) -> bool:
        fake.items[1] = 0x1000
        return True

    bus, outcome = start_dzb100(FakeDzb100(on_command=shows_another_coding))
    assert outcome.status is OutcomeStatus.CONFIRMED and len(bus.sent(dzb100.Dzb100Control)) == 1
