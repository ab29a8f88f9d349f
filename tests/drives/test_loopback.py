"""Loop-back test: what the drive returns unchanged is counted, and what it does not."""

from __future__ import annotations

from typing import Any

import pytest

from drivebus.drives.operations.loopback import loopback_test
from drivebus.errors import CapabilityError, NoReply
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
