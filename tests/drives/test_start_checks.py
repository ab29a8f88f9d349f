"""Checks before a start: what they refuse is refused before a frame that acts is sent."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from drivebus.drives.context import DriveLimits
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.start import run
from drivebus.drives.state import Direction
from drivebus.errors import CapabilityError, LimitError, PreflightError, StartInhibited
from drivebus.protocols import modbus, sunfar
from drivebus.values import bilingual_text
from fixtures.drives import FakeC320, FakeModbus, PureBus, context_for, dialect_for, operation_for
from fixtures.starts import c320, df800, start, vc660


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


def test_df800_reads_its_preflight_before_every_start() -> None:
    fake = FakeModbus()
    bus, op = df800(fake)
    start(bus, op)
    fake.registers[102] = 0
    with pytest.raises(PreflightError) as caught:
        start(bus, OperationContext(op.drive))
    assert caught.value.params["parameters"] == ("F1.02",)


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
