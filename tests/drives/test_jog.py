"""Jog: begun once, stopped at once where it is unknown whether the motor turns."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import pytest

from drivebus import profiles
from drivebus.drives.operations.jog import MAX_JOG_LEASE_S, begin_jog, check_jog_lease, end_jog
from drivebus.drives.outcome import OutcomeStatus
from drivebus.drives.state import Direction
from drivebus.errors import CapabilityError, LimitError, StartInhibited
from drivebus.protocols import sunfar
from drivebus.protocols.codec import Effect
from fixtures.drives import MODELS, FakeC320, FakeModbus, PureBus, dialect_for, operation_for, reject_command

FORWARD = Direction.FORWARD


def operations(bus: PureBus) -> list[sunfar.SunfarOperation]:
    return [request.operation for request in bus.sent(sunfar.SunfarControl)]


def test_a_jog_is_one_frame_that_carries_its_frequency() -> None:
    bus = PureBus(dialect=dialect_for("c320"), station=FakeC320())
    outcome = bus.run(begin_jog(operation_for(bus.dialect), 5.0, Direction.REVERSE))
    assert (outcome.status, outcome.key) == (OutcomeStatus.ACKNOWLEDGED, "drives.jog_begun")
    assert bus.sent(sunfar.SunfarControl) == [sunfar.SunfarControl(1, sunfar.SunfarOperation.JOG_REVERSE_AT, 500)]


def test_an_unanswered_jog_is_never_repeated_but_stopped_at_once() -> None:
    def lost(fake: FakeC320, request: sunfar.SunfarControl) -> Any:
        if request.operation is sunfar.SunfarOperation.JOG_FORWARD_AT:
            fake.state = sunfar.SunfarState.JOGGING_FORWARD
            return None
        fake.state = sunfar.SunfarState.STOPPED
        return fake.ok()

    bus = PureBus(dialect=dialect_for("c320"), station=FakeC320(on_command=lost))
    outcome = bus.run(begin_jog(operation_for(bus.dialect), 5.0, FORWARD))
    assert (outcome.status, outcome.key) == (OutcomeStatus.UNKNOWN, "drives.jog_unknown")
    assert outcome.text("en").endswith("Its stop: the drive reports stopped")
    first, second, *_ = operations(bus)
    assert (first, second) == (sunfar.SunfarOperation.JOG_FORWARD_AT, sunfar.SunfarOperation.JOG_STOP)
    assert operations(bus).count(sunfar.SunfarOperation.JOG_FORWARD_AT) == 1


def test_the_end_of_a_jog_is_its_own_stop_and_then_an_ordinary_one_until_it_stands() -> None:
    def only_plain(fake: FakeC320, request: sunfar.SunfarControl) -> Any:
        if request.operation is sunfar.SunfarOperation.STOP:
            fake.state = sunfar.SunfarState.STOPPED
        return fake.ok()

    bus = PureBus(
        dialect=dialect_for("c320"), station=FakeC320(state=sunfar.SunfarState.JOGGING_FORWARD, on_command=only_plain)
    )
    outcome = bus.run(end_jog(operation_for(bus.dialect)))
    assert outcome.status is OutcomeStatus.CONFIRMED
    assert operations(bus)[:2] == [sunfar.SunfarOperation.JOG_STOP, sunfar.SunfarOperation.STOP]
    assert set(bus.effects()) == {Effect.STOP}


def test_a_jog_begins_at_standstill() -> None:
    bus = PureBus(dialect=dialect_for("c320"), station=FakeC320(state=sunfar.SunfarState.RUNNING_FORWARD))
    with pytest.raises(StartInhibited):
        bus.run(begin_jog(operation_for(bus.dialect), 5.0, FORWARD))
    assert not bus.effects()


def test_a_refused_jog_is_not_stopped_because_it_never_began() -> None:
    bus = PureBus(dialect=dialect_for("c320"), station=FakeC320(on_command=reject_command))
    outcome = bus.run(begin_jog(operation_for(bus.dialect), 5.0, FORWARD))
    assert (outcome.status, outcome.key) == (OutcomeStatus.REFUSED, "drives.sunfar_response_1")
    assert operations(bus) == [sunfar.SunfarOperation.JOG_FORWARD_AT]


def test_a_jog_of_df800_needs_its_calibration() -> None:
    fake = FakeModbus(registers={101: 5, 102: 2})
    bus = PureBus(dialect=dialect_for("df800"), station=fake)
    with pytest.raises(StartInhibited) as caught:
        bus.run(begin_jog(operation_for(bus.dialect), None, FORWARD))
    assert caught.value.key == "drives.direction_uncalibrated"
    assert not fake.written


def test_a_jog_above_the_limit_or_without_a_frequency_where_it_needs_one_is_refused() -> None:
    bus = PureBus(dialect=dialect_for("c320"), station=FakeC320())
    with pytest.raises(LimitError):
        bus.run(begin_jog(operation_for(bus.dialect), 51.0, FORWARD))
    dzb = PureBus(dialect=dialect_for("dzb100"), station=FakeC320())
    with pytest.raises(CapabilityError) as caught:
        dzb.run(begin_jog(operation_for(dzb.dialect), None, FORWARD))
    assert caught.value.key == "drives.jog_needs_frequency"
    assert not bus.requests and not dzb.requests


def test_a_frequency_that_a_jog_can_not_carry_is_refused_with_the_keypad_as_its_place() -> None:
    bus = PureBus(dialect=dialect_for("vc660"), station=FakeModbus(registers={0x3000: 1, 1: 4}))
    with pytest.raises(CapabilityError) as caught:
        bus.run(begin_jog(operation_for(bus.dialect), 5.0, FORWARD))
    assert caught.value.key == "drives.jog_frequency_keypad"
    assert not bus.requests
    assert bus.run(begin_jog(operation_for(bus.dialect), None, FORWARD)).key == "drives.jog_begun"


@pytest.mark.parametrize("lease_s", [0.0, -1.0, MAX_JOG_LEASE_S + 0.001, float("nan"), float("inf")])
def test_a_lease_is_above_zero_and_at_most_half_a_second(lease_s: float) -> None:
    with pytest.raises(LimitError) as caught:
        check_jog_lease(lease_s)
    assert caught.value.key == "drives.lease_too_long"
    assert check_jog_lease(MAX_JOG_LEASE_S) == MAX_JOG_LEASE_S


@pytest.mark.parametrize("model", [*MODELS, "c300", "e300", "e350", "e500", "e550"])
def test_the_jog_frequency_of_a_model_agrees_with_its_frames(model: str) -> None:
    """No user interface offers a frequency that is refused afterwards."""
    dialect = dialect_for(model, **({"direction_calibrated": True} if model == "df800" else {}))

    def takes(word: int | None) -> bool:
        with suppress(CapabilityError):
            return bool(dialect.jog(FORWARD, word))
        return False

    takes_one, takes_none = takes(5), takes(None)
    says = {(True, True): "either", (True, False): "command", (False, True): "drive"}[takes_one, takes_none]
    assert profiles.load(model).jog_frequency == says
