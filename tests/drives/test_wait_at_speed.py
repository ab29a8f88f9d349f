"""Wait for the set frequency: by the drive's reports, with a time limit from its ramp."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Any

import pytest

from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.start import ramp_timeout_s, speed_tolerance_hz, wait_at_speed
from drivebus.drives.outcome import Outcome, OutcomeStatus
from drivebus.drives.state import Direction, DriveStatus
from drivebus.errors import Superseded, TargetNotReached
from drivebus.protocols import sunfar
from fixtures.drives import FakeC320, PureBus, SimulatedDrives, dialect_for, operation_for, run_virtual

STARTED = Outcome(status=OutcomeStatus.CONFIRMED, key="drives.start_confirmed")


def waiting(fake: FakeC320) -> tuple[PureBus, OperationContext]:
    bus = PureBus(dialect=dialect_for("c320"), station=fake)
    return bus, operation_for(bus.dialect)


def wait_for(bus: PureBus, op: OperationContext, hz: float = 10.0, timeout_s: float | None = 2.0) -> Outcome:
    return bus.run(wait_at_speed(op, hz, STARTED, timeout_s=timeout_s))


def test_it_is_there_when_the_drive_says_running_at_that_frequency() -> None:
    bus, op = waiting(FakeC320(state=sunfar.SunfarState.RUNNING_FORWARD, output=1000))
    outcome = wait_for(bus, op)
    assert (outcome.status, outcome.key) == (OutcomeStatus.CONFIRMED, "drives.running_at")
    assert outcome.params["output_hz"] == 10.0


def test_a_reverse_run_is_there_where_the_drive_reports_its_frequency_as_negative(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(OperationContext, "output_hz", lambda op: -10.0)
    bus, op = waiting(FakeC320(state=sunfar.SunfarState.RUNNING_REVERSE, output=1000))
    done = bus.run(wait_at_speed(op, 10.0, STARTED, timeout_s=2.0, direction=Direction.REVERSE))
    assert (done.status, done.params["output_hz"]) == (OutcomeStatus.CONFIRMED, -10.0)


def test_a_speed_that_is_reached_shows_the_frequency_that_could_not_be_read_back_and_other_notes_remain() -> None:
    bus, op = waiting(FakeC320(state=sunfar.SunfarState.RUNNING_FORWARD, output=1000))
    other = ("drives.precondition_unread", {"notation": "F0.1", "why": "drives.not_read"})
    started = replace(STARTED, notes=(("drives.setpoint_not_shown", {"frequency_hz": 10.0}), other))
    assert bus.run(wait_at_speed(op, 10.0, started, timeout_s=2.0)).notes == (other,)


def test_an_output_frequency_that_is_not_read_is_not_the_set_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(OperationContext, "output_hz", lambda op: None)
    bus, op = waiting(FakeC320(state=sunfar.SunfarState.RUNNING_FORWARD, output=1000))
    with pytest.raises(TargetNotReached) as caught:
        wait_for(bus, op)
    assert caught.value.params["found_hz"] is None


def test_it_is_not_there_while_the_drive_says_accelerating() -> None:
    bus, op = waiting(FakeC320(state=sunfar.SunfarState.ACCELERATING_FORWARD, output=1000))
    with pytest.raises(TargetNotReached) as caught:
        wait_for(bus, op)
    assert caught.value.params["state"] == "accelerating"


@pytest.mark.parametrize("output", [990, 1010])
def test_it_is_not_there_at_another_frequency(output: int) -> None:
    bus, op = waiting(FakeC320(state=sunfar.SunfarState.RUNNING_FORWARD, output=output))
    with pytest.raises(TargetNotReached) as caught:
        wait_for(bus, op)
    assert caught.value.params["found_hz"] == output / 100


def test_a_drive_that_reports_reverse_meanwhile_is_a_failure() -> None:
    bus, op = waiting(FakeC320(state=sunfar.SunfarState.RUNNING_REVERSE, output=1000))
    assert wait_for(bus, op).key == "drives.wrong_direction"


@pytest.mark.parametrize("model", ["vc660", "c320"])
def test_a_speed_that_falls_along_a_slow_ramp_is_waited_for_unless_a_time_is_given(model: str) -> None:
    """After the time of a fast ramp it was called not reached, and the motor stopped."""

    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            drive = bench.drive()
            await drive.run(40.0, wait=True)
            bench.station().set_ramps(10.0, 300.0)
            with pytest.raises(TargetNotReached):
                await drive.run(39.0, wait=True, timeout_s=3.0)
            began = asyncio.get_running_loop().time()
            assert (await drive.run(20.0, wait=True)).status is OutcomeStatus.CONFIRMED
            assert 100 < asyncio.get_running_loop().time() - began < 124
            assert bench.station().motor.output_hz == pytest.approx(20.0, abs=0.11)

    run_virtual(scenario())


def test_a_speed_that_still_approaches_is_not_waited_for_beyond_the_time_that_is_given() -> None:
    fake = FakeC320(state=sunfar.SunfarState.ACCELERATING_FORWARD, output=1000)
    bus, op = waiting(fake)
    bus.pass_time(100.0)
    bus.transaction_s = 0.031

    def rise(status: DriveStatus) -> None:
        fake.output += 10

    with pytest.raises(TargetNotReached) as caught:
        bus.run(wait_at_speed(op, 50.0, STARTED, timeout_s=5.26, on_progress=rise))
    assert caught.value.params["limit_s"] == caught.value.params["waited_s"] == 5.3
    assert bus.now == pytest.approx(105.276)


def test_a_speed_that_one_read_shows_at_the_end_of_the_time_has_one_more_read() -> None:
    fake = FakeC320(state=sunfar.SunfarState.ACCELERATING_FORWARD, output=1000)
    bus, op = waiting(fake)

    def arrive(status: DriveStatus) -> None:
        if bus.now > 1.8:
            fake.state, fake.output = sunfar.SunfarState.RUNNING_FORWARD, 5000

    assert (
        bus.run(wait_at_speed(op, 50.0, STARTED, timeout_s=2.0, on_progress=arrive)).status is OutcomeStatus.CONFIRMED
    )
    assert bus.now > 2.2


@pytest.mark.parametrize("held_at_s", [0.0, 90.0])
def test_a_speed_that_no_longer_approaches_is_not_waited_for(held_at_s: float) -> None:
    """At once after the time of the ramp, or 5 s after the speed came nearer for the last time."""
    fake = FakeC320(state=sunfar.SunfarState.ACCELERATING_FORWARD, output=1000)
    bus, op = waiting(fake)

    def rise(status: DriveStatus) -> None:
        fake.output = 1000 + round(min(bus.now, held_at_s) * 10)

    with pytest.raises(TargetNotReached) as caught:
        bus.run(wait_at_speed(op, 50.0, STARTED, timeout_s=None, on_progress=rise))
    assert bus.now == pytest.approx(max(60.0, held_at_s + 5.0), abs=1.0)
    assert caught.value.params["limit_s"] == pytest.approx(bus.now, abs=1.0)


def test_a_motor_that_only_passes_the_frequency_is_not_there() -> None:
    """A drive without a state of its own for a ramp reports "running" on its way to another frequency too."""
    fake = FakeC320(state=sunfar.SunfarState.RUNNING_FORWARD, output=1000)
    bus, op = waiting(fake)

    def pass_by(status: DriveStatus) -> None:
        fake.output = 2000

    with pytest.raises(TargetNotReached) as caught:
        bus.run(wait_at_speed(op, 10.0, STARTED, timeout_s=2.0, on_progress=pass_by))
    assert caught.value.params["found_hz"] == 20.0


def test_every_status_that_is_read_while_waiting_is_reported_as_progress() -> None:
    bus, op = waiting(FakeC320(state=sunfar.SunfarState.ACCELERATING_FORWARD, output=500))
    shown: list[Any] = []
    with pytest.raises(TargetNotReached):
        bus.run(wait_at_speed(op, 10.0, STARTED, timeout_s=2.0, on_progress=shown.append))
    assert 9 <= len(shown) <= 11 and {status.readings["output_frequency"].value for status in shown} == {5.0}


def test_a_drive_that_stops_ends_the_waiting_at_once() -> None:
    bus, op = waiting(FakeC320(state=sunfar.SunfarState.STOPPED))
    with pytest.raises(TargetNotReached) as caught:
        wait_for(bus, op, timeout_s=60.0)
    assert caught.value.key == "drives.off_before_reached" and bus.now < 1.0


def test_a_drive_without_replies_has_an_unknown_outcome() -> None:
    bus, op = waiting(FakeC320(silent=True))
    with pytest.raises(TargetNotReached) as caught:
        wait_for(bus, op)
    assert caught.value.key == "drives.not_reached_no_reply"
    assert caught.value.outcome.status is OutcomeStatus.UNKNOWN


def test_a_stop_that_comes_meanwhile_ends_the_waiting() -> None:
    bus, op = waiting(FakeC320(state=sunfar.SunfarState.ACCELERATING_FORWARD))

    bus.on_request = lambda ask: bus.count_stop()
    with pytest.raises(Superseded):
        wait_for(bus, op)


def test_the_time_limit_comes_from_the_ramp_where_it_is_known() -> None:
    assert ramp_timeout_s(10.0, None) == 17.0
    assert ramp_timeout_s(None, None) == 60.0
    assert ramp_timeout_s(10.0, 3.0) == 3.0


def test_near_is_half_a_percent_and_never_less_than_two_steps() -> None:
    op = operation_for(dialect_for("c320"))
    assert speed_tolerance_hz(op, 40.0) == pytest.approx(0.2)
    assert speed_tolerance_hz(op, 1.0) == pytest.approx(0.02)
