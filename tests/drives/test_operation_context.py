"""Parts of every operation: sync probes, the allow-list of frames, bounded evidence."""

from __future__ import annotations

import json
from typing import Any

import pytest

from drivebus import i18n
from drivebus.bus.core import UntrustedReply
from drivebus.bus.messages import BusRequest, BusResult, RetryPolicy
from drivebus.drives.dialects.base import CommandFrame
from drivebus.drives.eeprom_budget import EepromBudget
from drivebus.drives.operations.context import VERIFICATION_ROUNDS
from drivebus.drives.operations.exchange_log import MAX_READ_EXCHANGES, frame_exchange
from drivebus.drives.operations.start import run
from drivebus.drives.operations.steps import UpdateStore, Wait, run_pure
from drivebus.drives.outcome import OutcomeStatus
from drivebus.drives.permissives import CommandKind
from drivebus.drives.state import DriveState
from drivebus.errors import ChecksumError, NoReply, NotPermitted
from drivebus.protocols import modbus, sunfar
from drivebus.service.api.errors import exchange_json
from fixtures.drives import FakeC320, FakeModbus, PureBus, dialect_for, operation_for

STATUS, FAULT_CODE, FAULT_BIT = 0x2520, 0x2521, 8  # of teco_e510, which reports a fault and its code in two registers


@pytest.mark.parametrize("register", [0x200B, 0xA002, 0x3000, 0x0200])
def test_no_operation_sends_a_frame_outside_the_allow_list(register: int) -> None:
    bus = PureBus(dialect=dialect_for("vc660"), station=FakeModbus())
    op = operation_for(bus.dialect)
    command = op.drive.create_command(CommandKind.WRITE, bus.conditions)
    with pytest.raises(NotPermitted) as caught:
        bus.run(
            op.send_command(command, CommandFrame(modbus.WriteRegister(1, register, 1), RetryPolicy.EDGE_TRIGGERED))
        )
    assert caught.value.key == "drives.not_listed"
    assert not bus.requests


def test_a_damaged_reply_to_the_read_that_shows_an_echo_is_named() -> None:
    """Regression: where every read had a wrong CRC, the remedy of ``status`` was to read a value from a drive first."""
    damaged = ChecksumError("modbus.crc", expected=0x8479, found=0x7984)
    mirrored = UntrustedReply("bus.own_echo", station=1)

    def station(request: Any) -> Any:
        return mirrored if isinstance(request, modbus.Diagnostics) else damaged

    bus = PureBus(dialect=dialect_for("vc660"), station=station)
    op = operation_for(bus.dialect)
    assert bus.run(op.read_verified_state()) is damaged
    silent = PureBus(
        dialect=bus.dialect, station=lambda request: mirrored if isinstance(request, modbus.Diagnostics) else None
    )
    assert silent.run(operation_for(silent.dialect).read_verified_state()) is mirrored


def test_a_rejected_sync_probe_is_no_valid_sync_reply() -> None:
    """A short reply (6, 7, 8) echoes the address only: it could be a late reply to any request."""

    class Refuses(FakeC320):
        def __call__(self, request: Any) -> Any:
            if isinstance(request, sunfar.SunfarReadParameter):
                return sunfar.SunfarReply(address=1, response=sunfar.SunfarResponse.BAD_CODE)
            return super().__call__(request)

    bus = PureBus(dialect=dialect_for("c320"), station=Refuses())
    op = operation_for(bus.dialect)
    error = bus.run(op.read_verified_state())
    assert isinstance(error, NotPermitted) and error.key == "drives.sync_probe_rejected"
    assert all("drivebus scan" in i18n.text(f"hint.{error.key}", language) for language in ("en", "zh"))
    assert op.derived.state is DriveState.UNKNOWN
    with pytest.raises(NotPermitted):
        bus.run(run(operation_for(bus.dialect), 10.0, None))
    assert not bus.effects()


@pytest.mark.parametrize("language", i18n.LANGUAGES)
def test_evidence_says_what_went_wrong_with_a_frame_in_a_whole_sentence(language: str) -> None:
    silence = NoReply("bus.no_reply", station=1, attempt=2, bytes=0, milliseconds=50)
    frame = json.loads(
        json.dumps(
            exchange_json(frame_exchange(BusResult(bus_request=BusRequest(station=1, request=None), error=silence)))
        )
    )
    message = i18n.text(frame["error"], language, **frame["params"])
    assert message == silence.text(language) and "{" not in message
    assert exchange_json(frame_exchange(BusResult(bus_request=BusRequest(station=1, request=None))))["error"] is None


def test_what_was_read_before_a_command_never_shows_its_effect() -> None:
    bus = PureBus(dialect=dialect_for("c320"), station=FakeC320(state=sunfar.SunfarState.RUNNING_FORWARD))
    op = operation_for(bus.dialect)
    bus.run(op.read_verified_state())
    assert op.derived.state is DriveState.RUNNING
    bus.station = FakeC320(silent=True)
    bus.run(op.read_verified_state())
    assert op.derived.state is DriveState.UNKNOWN
    assert not op.reading_pairs.latest


def test_evidence_is_bounded_and_in_order() -> None:
    bus = PureBus(dialect=dialect_for("c320"), station=FakeC320())
    op = operation_for(bus.dialect)
    for _ in range(100):
        bus.run(op.read_verified_state())
    evidence = op.outcome(OutcomeStatus.CONFIRMED, "x").exchanges
    assert len(evidence) == MAX_READ_EXCHANGES
    times = [exchange.sent_at or 0.0 for exchange in evidence]
    assert times == sorted(times)


def test_a_drive_that_never_agrees_with_itself_is_unknown_and_says_why() -> None:
    turn = [0]

    class Flickers(FakeC320):
        def __call__(self, request: Any) -> Any:
            if isinstance(request, sunfar.ReadMonitor):
                turn[0] += 1
                self.state = sunfar.SunfarState.STOPPED if turn[0] % 2 else sunfar.SunfarState.EMERGENCY_STOP
            return super().__call__(request)

    bus = PureBus(dialect=dialect_for("c320"), station=Flickers())
    op = operation_for(bus.dialect)
    assert bus.run(op.read_verified_state()) is None
    assert (op.derived.state, op.derived.reason) == (DriveState.UNKNOWN, "drives.disagree")


def test_a_state_whose_read_is_refused_or_has_reserved_bits_says_so() -> None:
    """Not "the reads do not agree": each model that refuses, and a VC660 whose status word has undocumented bits."""

    class RefusingModbus(FakeModbus):
        def __call__(self, request: Any) -> Any:
            refused = isinstance(request, modbus.ReadRegisters) and request.register == 0x3000
            return modbus.ExceptionReply(1, 3, 2) if refused else super().__call__(request)

    class RefusingC320(FakeC320):
        def __call__(self, request: Any) -> Any:
            if isinstance(request, sunfar.ReadMonitor):
                return sunfar.SunfarReply(address=1, response=sunfar.SunfarResponse(6))
            return super().__call__(request)

    cases = [
        ("vc660", RefusingModbus(), "drives.modbus_exception_2"),
        ("vc660", FakeModbus(registers={0x3000: 0x1000}), "drives.reserved_bits"),
        ("c320", RefusingC320(), "drives.sunfar_response_6"),
    ]
    for model, station, reason in cases:
        bus = PureBus(dialect=dialect_for(model), station=station)
        op = operation_for(bus.dialect)
        bus.run(op.read_verified_state())
        assert (op.derived.state, op.derived.reason) == (DriveState.UNKNOWN, reason), model


def test_one_failed_round_is_forgiven_and_two_are_not() -> None:
    lost = [1]

    class Loses(FakeC320):
        def __call__(self, request: Any) -> Any:
            if isinstance(request, sunfar.ReadMonitor) and lost:
                lost.pop()
                return None
            return super().__call__(request)

    bus = PureBus(dialect=dialect_for("c320"), station=Loses())
    op = operation_for(bus.dialect)
    assert bus.run(op.read_verified_state()) is None
    assert op.derived.state is DriveState.STOPPED
    lost[:] = [1, 1]
    assert bus.run(op.read_verified_state()) is not None
    assert op.derived.state is DriveState.UNKNOWN


def test_an_operation_yields_values_as_steps() -> None:
    """Sans-IO: storing is a step, and waiting too."""
    from drivebus.drives.store import MemoryStore

    steps = []

    def bus(step: Any) -> Any:
        steps.append(step)

    run_pure(EepromBudget(MemoryStore(), "k").consume("F0.2", "2026-01-01"), bus)
    assert [type(step) for step in steps] == [UpdateStore]
    assert not isinstance(steps[0], Wait)


def test_the_fault_code_is_read_again_where_one_of_its_replies_was_lost() -> None:
    """A lost reply made a fault with a code one whose code is not known."""
    bus = PureBus(dialect=dialect_for("teco_e510"), station=FakeModbus({STATUS: FAULT_BIT, FAULT_CODE: 6}))
    replies = bus.station
    lost = iter([True])
    is_fault_read = {modbus.ReadRegisters(1, FAULT_CODE, 1)}.__contains__
    bus.station = lambda request: None if is_fault_read(request) and next(lost, False) else replies(request)
    op = operation_for(bus.dialect)
    bus.run(op.read_verified_state())
    assert (op.derived.state, op.derived.fault_code) == (DriveState.FAULT, 6)
    assert len([ask for ask in bus.requests if is_fault_read(ask.request)]) == VERIFICATION_ROUNDS + 1
