"""Fault reset: an edge, sent while a fault is shown; repeated only unanswered, and while the fault is still there."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from drivebus.drives.operations.reset import reset_fault
from drivebus.drives.outcome import OutcomeStatus
from drivebus.errors import StartInhibited
from drivebus.protocols import sunfar
from fixtures.drives import FakeC320, FakeModbus, PureBus, dialect_for, operation_for

RESET = sunfar.SunfarControl(1, sunfar.SunfarOperation.RESET_FAULT)


def in_fault(**more: Any) -> PureBus:
    return PureBus(dialect=dialect_for("c320"), station=FakeC320(state=sunfar.SunfarState.FAULT, fault_code=5, **more))


def clears(fake: FakeC320, request: sunfar.SunfarControl) -> Any:
    fake.state = sunfar.SunfarState.STOPPED
    return fake.ok()


def test_a_reset_is_confirmed_by_later_reads_without_the_fault() -> None:
    bus = in_fault(on_command=clears)
    outcome = bus.run(reset_fault(operation_for(bus.dialect)))
    assert (outcome.status, outcome.key) == (OutcomeStatus.CONFIRMED, "drives.reset_confirmed")
    assert bus.sent(sunfar.SunfarControl) == [RESET]


def test_nothing_is_sent_where_there_is_no_fault() -> None:
    bus = PureBus(dialect=dialect_for("c320"), station=FakeC320())
    assert bus.run(reset_fault(operation_for(bus.dialect))).key == "drives.no_fault"
    assert not bus.effects()


def test_a_drive_whose_state_is_unknown_is_not_called_free_of_faults() -> None:
    """Found by the campaign ``statements``: "Confirmed: the drive reports no fault (unknown)"."""
    bus = PureBus(dialect=dialect_for("vc660"), station=FakeModbus(registers={0x3000: 0x0201}))
    with pytest.raises(StartInhibited) as caught:
        bus.run(reset_fault(operation_for(bus.dialect)))
    assert caught.value.key == "drives.fault_unknown"
    assert "bits that must be 0 are set" in str(caught.value)
    assert not bus.effects()


def test_an_answered_reset_is_sent_once_although_the_fault_remains() -> None:
    bus = in_fault()
    outcome = bus.run(reset_fault(operation_for(bus.dialect)))
    assert (outcome.status, outcome.key) == (OutcomeStatus.FAILED, "drives.fault_remains")
    assert bus.sent(sunfar.SunfarControl) == [RESET]


def test_an_unanswered_reset_is_sent_again_while_the_fault_is_shown() -> None:
    lost = [1]

    def second(fake: FakeC320, request: sunfar.SunfarControl) -> Any:
        return None if lost and lost.pop() else clears(fake, request)

    bus = in_fault(on_command=second)
    assert bus.run(reset_fault(operation_for(bus.dialect))).status is OutcomeStatus.CONFIRMED
    assert bus.sent(sunfar.SunfarControl) == [RESET] * 2


def test_a_repetition_that_is_not_allowed_any_more_does_not_hide_that_the_reset_was_sent() -> None:
    """StartInhibited means that nothing was sent."""
    bus = in_fault(on_command=lambda fake, request: None)

    def seen(ask: Any) -> None:
        if ask.request == RESET:
            bus.conditions = replace(bus.conditions, duplicate_address=True)

    bus.on_request = seen
    outcome = bus.run(reset_fault(operation_for(bus.dialect)))
    assert (outcome.status, outcome.key) == (OutcomeStatus.FAILED, "drives.fault_remains")
    assert bus.sent(sunfar.SunfarControl) == [RESET]


def test_an_unanswered_reset_that_was_done_is_not_repeated() -> None:
    def silently(fake: FakeC320, request: sunfar.SunfarControl) -> Any:
        fake.state = sunfar.SunfarState.STOPPED

    bus = in_fault(on_command=silently)
    assert bus.run(reset_fault(operation_for(bus.dialect))).status is OutcomeStatus.CONFIRMED
    assert bus.sent(sunfar.SunfarControl) == [RESET]


def test_a_drive_that_turns_is_not_reset_although_it_reports_a_fault() -> None:
    fake = FakeModbus(registers={0x3000: 0x000B, 0x3016: 0x0002})
    bus = PureBus(dialect=dialect_for("vc660"), station=fake)
    with pytest.raises(StartInhibited) as caught:
        bus.run(reset_fault(operation_for(bus.dialect)))
    assert caught.value.key == "drives.reset_while_turning"
    assert not fake.written


def test_df800_shows_no_fault_so_its_reset_is_only_acknowledged() -> None:
    fake = FakeModbus()
    bus = PureBus(dialect=dialect_for("df800"), station=fake)
    outcome = bus.run(reset_fault(operation_for(bus.dialect)))
    assert (outcome.status, outcome.key) == (OutcomeStatus.ACKNOWLEDGED, "drives.reset_acknowledged")
    assert fake.written == [(0x2000, 0x0010)]


def test_an_unanswered_reset_of_a_drive_that_shows_no_fault_is_unknown() -> None:
    bus = PureBus(dialect=dialect_for("df800"), station=FakeModbus(on_command=lambda fake, word: False))
    outcome = bus.run(reset_fault(operation_for(bus.dialect)))
    assert (outcome.status, outcome.key) == (OutcomeStatus.UNKNOWN, "drives.reset_unknown")


@pytest.mark.parametrize(
    ("after", "key"),
    [
        ([], "drives.reset_unknown"),
        ([sunfar.SunfarState.STOPPED, sunfar.SunfarState.FAULT], "drives.reset_unknown"),
        ([sunfar.SunfarState.STOPPED], "drives.reset_confirmed"),
        ([sunfar.SunfarState.FAULT], "drives.fault_remains"),
    ],
)
def test_a_reset_is_unknown_where_no_later_reads_agree(after: list[sunfar.SunfarState], key: str) -> None:
    """The drive answers the reset; then it falls silent, flickers, or shows one state."""

    def answers(fake: FakeC320, request: sunfar.SunfarControl) -> Any:
        bus.station = flickers if after else lambda request: None
        return fake.ok()

    def flickers(request: Any) -> Any:
        if isinstance(request, sunfar.ReadMonitor):
            after.append(after.pop(0))
        return FakeC320(state=after[-1], fault_code=5)(request)

    bus = in_fault(on_command=answers)
    outcome = bus.run(reset_fault(operation_for(bus.dialect)))
    assert outcome.key == key
