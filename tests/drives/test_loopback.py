"""Loop-back test: what the drive returns unchanged is counted, and what it does not."""

from __future__ import annotations

import contextlib
from typing import Any

import pytest

from drivebus.bus.messages import BusResult
from drivebus.drives.operations.loopback import loopback_test
from drivebus.errors import CapabilityError, NoReply, TrailingError
from drivebus.protocols import modbus
from fixtures.drives import FakeC320, FakeModbus, PureBus, dialect_for, operation_for


def test_each_loopback_has_another_number_and_its_round_trip() -> None:
    bus = PureBus(dialect=dialect_for("vc660"), station=FakeModbus())
    report = bus.run(loopback_test(operation_for(bus.dialect), 20))
    numbers = [request.data for request in bus.sent(modbus.Diagnostics)]
    assert len(set(numbers)) == len(numbers) == 21, "20, and the sync probe before them"
    assert (report.requests, report.error) == (20, None)
    assert report.round_trips_s == pytest.approx([bus.transaction_s] * 20)


def test_a_loopback_that_is_not_returned_is_counted_with_its_error() -> None:
    count = [0]

    class Loses(FakeModbus):
        def __call__(self, request: Any) -> Any:
            count[0] += 1
            return None if count[0] == 3 else super().__call__(request)

    bus = PureBus(dialect=dialect_for("vc660"), station=Loses())
    report = bus.run(loopback_test(operation_for(bus.dialect), 5))
    assert len(report.round_trips_s) == 4 and isinstance(report.error, NoReply)


def test_a_silent_drive_and_a_model_without_loopback_are_errors() -> None:
    silent = PureBus(dialect=dialect_for("vc660"), station=FakeModbus(silent=True))
    with pytest.raises(NoReply):
        silent.run(loopback_test(operation_for(silent.dialect), 5))
    other = PureBus(dialect=dialect_for("c320"), station=FakeC320())
    with pytest.raises(CapabilityError):
        other.run(loopback_test(operation_for(other.dialect), 5))
    assert not other.requests


@pytest.mark.parametrize(("sent_first", "is_repeated"), [(True, True), (False, False)])
def test_a_loop_back_that_is_received_twice_may_be_the_echo_of_the_adapter(sent_first: bool, is_repeated: bool) -> None:
    """Regression: behind an echoing adapter a first write to a register that can't be read was never sent, because
    "its reply was received twice". A read shows whether the port has an echo, and the loop-back is sent again."""
    dialect = dialect_for("vc660")
    steps = operation_for(dialect).sync()
    probe = next(steps)
    sent = dialect.codec.encode_request(probe.request)
    received = sent * 2 if sent_first else b"\x01" + sent * 2
    error = TrailingError("bus.second_reply", station=1)
    following: list[Any] = []
    with contextlib.suppress(StopIteration):
        following.append(steps.send(BusResult(bus_request=probe, error=error, sent=sent, received=received)))
    assert [step.request for step in following] == [dialect.echo_test_read()] * is_repeated
