"""Sentences about a drive that need a case of their own: each is used in its case, and not in the one beside it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from drivebus import i18n, profiles
from drivebus.drives import create_dialect
from drivebus.drives.dialects.base import frequency_word
from drivebus.drives.dialects.command_word import make_command_word
from drivebus.drives.dialects.dzb100 import STATE_ITEM
from drivebus.drives.dialects.modbus_reads import sync_spans
from drivebus.drives.operations.dzb100_calibration import calibrate_query_coding
from drivebus.drives.operations.parameter_write import check_writes
from drivebus.drives.operations.setpoint import set_frequency
from drivebus.drives.operations.stop import stop
from drivebus.drives.state import Direction
from drivebus.errors import CapabilityError, ConfigurationError, LimitError, TargetNotReached
from drivebus.profiles.words import CommandMap
from drivebus.protocols.dzb100.messages import Dzb100Query, Dzb100Reply
from fixtures.drives import FakeModbus, PureBus, dialect_for, keypad_registers, operation_for


def test_a_frequency_that_no_word_holds_is_refused_and_the_largest_one_is_not() -> None:
    profile = profiles.load("vc660")
    with pytest.raises(LimitError) as caught:
        frequency_word(profile, 655.36)
    assert caught.value.key == "drives.no_word"
    assert frequency_word(profile, 655.35) == 0xFFFF


@pytest.mark.parametrize(("address", "key"), [(40.0, "drives.write_address"), (0.0, "drives.write_broadcast")])
def test_an_address_that_the_model_lacks_is_not_called_the_broadcast_address(address: float, key: str) -> None:
    """The range of the parameter may be unknown or wider than the addresses that a master reaches."""
    profile = profiles.load("dzb100")
    parameter = replace(profile.parameters["78"], minimum=None, maximum=None)
    wider = replace(profile, parameters={**profile.parameters, "78": parameter})
    with pytest.raises(LimitError) as caught:
        check_writes(create_dialect(wider, 1), {"78": address})
    assert caught.value.key == key


def test_a_direction_that_the_command_word_lacks_is_named() -> None:
    commands = profiles.load("vc660").commands
    assert commands is not None
    forward_only: CommandMap = replace(commands, bits={n: b for n, b in commands.bits.items() if n != "reverse"})
    word = make_command_word(forward_only)
    with pytest.raises(CapabilityError) as caught:
        word.start(Direction.REVERSE)
    assert (caught.value.key, caught.value.params["what"]) == ("drives.no_command_bit", "reverse")
    assert word.start(Direction.FORWARD)


def test_a_profile_without_two_neighbouring_registers_has_no_sync_probe() -> None:
    profile = profiles.load("skf8000")
    alone = replace(profile, signals={}, parameters={}, preconditions=())
    with pytest.raises(ConfigurationError) as caught:
        sync_spans(alone)
    assert caught.value.key == "drives.no_sync_probe"
    assert sync_spans(profile)


@pytest.mark.parametrize(("word", "is_documented"), [(0x0000, True), (0x00FF, False)])
def test_a_dzb100_state_outside_the_manual_is_shown_as_not_documented(word: int, is_documented: bool) -> None:
    dialect: Any = dialect_for("dzb100")
    request = dialect.query(STATE_ITEM)
    reply = Dzb100Reply(head="Q", address=1, index=STATE_ITEM, data=word, accepted=True)
    readings = dialect.decode_readings(request, reply, 0.0)
    reasons = {name: reading.reason for name, reading in readings.items() if reading.value is not None}
    if is_documented:
        assert reasons == {"state": "drives.bits_not_published", "command": None, "fault": None}
    else:
        assert reasons == {"state": "drives.not_documented", "fault": "drives.not_documented"}


def test_words_of_a_query_that_differ_each_time_have_no_agreement() -> None:
    words = iter(range(0x100, 0x200))

    def station(request: Any) -> Any:
        is_query = isinstance(request, Dzb100Query)
        index, data = (request.item, next(words)) if is_query else (request.parameter, 1)
        return Dzb100Reply(head=chr(request.head), address=1, index=index, data=data, accepted=True)

    bus = PureBus(dialect=dialect_for("dzb100"), station=station)
    with pytest.raises(TargetNotReached) as caught:
        bus.run(calibrate_query_coding(operation_for(bus.dialect), 12.3))
    assert caught.value.key == "drives.no_agreement"


@pytest.mark.parametrize(("word", "is_foreign"), [(9, True), (3, False)])
def test_a_status_that_the_model_does_not_have_is_named_and_no_stop_is_sent(word: int, is_foreign: bool) -> None:
    drive = FakeModbus(registers={0x2100: word})
    bus = PureBus(dialect=create_dialect(profiles.load("gd10"), 1), station=drive)
    outcome = bus.run(stop(operation_for(bus.dialect)))
    assert (i18n.text("drives.foreign_status") in outcome.text("en")) is is_foreign
    assert bool(drive.written) is not is_foreign


@pytest.mark.parametrize(("model", "is_listed"), [("gd300", True), ("gd35", True), ("gd350", True), ("gd10", False)])
def test_a_goodrive_that_pre_excites_its_motor_is_turning_and_is_sent_the_stop(model: str, is_listed: bool) -> None:
    """2100H = 6 in the manuals of these three: taken for the status of another model, the stop was withheld."""
    drive = FakeModbus(registers={0x2100: 6})
    bus = PureBus(dialect=create_dialect(profiles.load(model), 1), station=drive)
    outcome = bus.run(stop(operation_for(bus.dialect)))
    assert (i18n.text("drives.foreign_status") in outcome.text("en")) is not is_listed
    assert bool(drive.written) is is_listed


def test_a_setpoint_whose_maximum_is_not_read_again_is_unknown() -> None:
    profile = profiles.load("skf8000")
    drive = FakeModbus(registers=keypad_registers(profile) | {profile.parameters["P0-10"].locator[1]: 5000, 0x3000: 3})

    def station(request: Any) -> Any:
        return None if drive.written else drive(request)

    bus = PureBus(dialect=create_dialect(profile, 1), station=station, on_request=None)
    outcome = bus.run(set_frequency(operation_for(bus.dialect), 10.0))
    assert (outcome.key, drive.written) == ("drives.maximum_unconfirmed", [(0x1000, 2000)])
