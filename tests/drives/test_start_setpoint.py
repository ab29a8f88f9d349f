"""Start of a drive whose frequency is a write of its own: set, read back, and only then started."""

from __future__ import annotations

from typing import Any

import pytest

from drivebus import profiles
from drivebus.drives import create_dialect
from drivebus.drives.outcome import OutcomeStatus
from drivebus.errors import Expired, Superseded, TargetNotReached
from drivebus.protocols import modbus
from drivebus.protocols.codec import Effect
from fixtures.drives import FakeModbus, PureBus, keypad_registers, operation_for
from fixtures.starts import df800, start, vc660


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
            bus.count_stop()

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


def test_a_rejected_set_frequency_is_named_and_no_start_is_sent() -> None:
    fake = FakeModbus(rejections={0x2001: 3})
    bus, op = vc660(fake)
    outcome = start(bus, op)
    assert (outcome.status, outcome.params["code"]) == (OutcomeStatus.REFUSED, 3)
    assert outcome.key == "drives.start_setpoint_refused"
    assert "rejected the set frequency of 10.0 Hz, and no start was sent" in outcome.text("en")
    assert ("drives.modbus_remedy_3", {}) in outcome.notes
    assert fake.written == []
