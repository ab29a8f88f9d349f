"""Readings, states, polls and sync probes of each family."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import pytest

from drivebus import i18n, profiles
from drivebus.bus import Bus
from drivebus.drives import Drive, MemoryStore, create_dialect
from drivebus.drives.dialects.base import UNNAMED_FAULT_CODE, Dialect, StopMode, reported_fault
from drivebus.drives.dialects.dzb100 import (
    Dzb100Dialect,
    decode_or_none,
    highest_safe_word,
    is_within_cap,
    possible_codings,
)
from drivebus.drives.readings import ReadingPairs
from drivebus.drives.state import DerivedState, Direction, DriveState
from drivebus.errors import ConfigurationError, LimitError
from drivebus.ports import open_port
from drivebus.protocols import dzb100, modbus, sunfar
from drivebus.protocols.dzb100 import FREQUENCY_CODINGS
from drivebus.values import Quality
from fixtures.drives import MODELS, dialect_for

# --- helpers ------------------------------------------------------------------------------------------------------


def book_of(dialect: Dialect, *replies: tuple[Any, Any]) -> ReadingPairs:
    book = ReadingPairs()
    for at, (request, reply) in enumerate(replies):
        book.add(dialect.decode_readings(request, reply, float(at)))
    return book


def c320_reply(
    state: sunfar.SunfarState, item: int | None = 0, data: int = 0, fault: int | None = None
) -> sunfar.SunfarReply:
    return sunfar.SunfarReply(
        address=1,
        response=sunfar.SunfarResponse.OK,
        state=state,
        group=0,
        item=None if fault is not None else item,
        data=data,
        fault_code=fault,
    )


def derived_c320(*states: sunfar.SunfarState) -> DerivedState | None:
    dialect = dialect_for("c320")
    replies = [
        (sunfar.ReadMonitor(1, 0), c320_reply(s, fault=7 if s == sunfar.SunfarState.FAULT else None)) for s in states
    ]
    return dialect.derive_state(book_of(dialect, *replies))


def derived_vc660(*words: int, faults: tuple[int, int] = (0, 0)) -> DerivedState | None:
    dialect = dialect_for("vc660")
    replies: list[tuple[Any, Any]] = [
        (modbus.ReadRegisters(1, 0x3000, 1), modbus.RegisterValues(1, 3, (word,))) for word in words
    ]
    replies += [(modbus.ReadRegisters(1, 0x3016, 2), modbus.RegisterValues(1, 3, faults))] * 2
    return dialect.derive_state(book_of(dialect, *replies))


def judged_dzb(outputs: tuple[int, int], words: tuple[int, int] = (0, 0), **settings: Any) -> DerivedState | None:
    dialect = dialect_for("dzb100", **settings)
    replies: list[tuple[Any, Any]] = []
    for output, word in zip(outputs, words, strict=True):
        replies.append(
            (dzb100.Dzb100Query(1, 1), dzb100.Dzb100Reply(head="Q", address=1, index=1, data=output, accepted=True))
        )
        replies.append(
            (dzb100.Dzb100Query(1, 3), dzb100.Dzb100Reply(head="Q", address=1, index=3, data=word, accepted=True))
        )
    return dialect.derive_state(book_of(dialect, *replies))


# --- states -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("state", [s for s in sunfar.SunfarState if s != sunfar.SunfarState.FAULT])
def test_every_c320_state_that_two_reads_agree_on_has_a_name(state: sunfar.SunfarState) -> None:
    derived = derived_c320(state, state)
    assert derived is not None and derived.state is not DriveState.UNKNOWN
    assert (derived.direction is Direction.REVERSE) is state.name.endswith("REVERSE")


def test_one_read_decides_nothing() -> None:
    assert derived_c320(sunfar.SunfarState.STOPPED) is None
    assert derived_vc660(0x0001) is None


def test_a_state_change_needs_two_reads_but_a_ramp_does_not_hide_that_it_turns() -> None:
    assert derived_c320(sunfar.SunfarState.RUNNING_FORWARD, sunfar.SunfarState.STOPPED) is None
    derived = derived_c320(sunfar.SunfarState.ACCELERATING_FORWARD, sunfar.SunfarState.RUNNING_FORWARD)
    assert derived is not None and derived.state is DriveState.RUNNING


def test_the_fault_code_of_c320_stands_where_the_item_stood() -> None:
    derived = derived_c320(sunfar.SunfarState.FAULT, sunfar.SunfarState.FAULT)
    assert derived == DerivedState(DriveState.FAULT, None, 7)
    fault = reported_fault(profiles.load("c320"), derived)
    assert fault is not None and (fault.code, fault.label) == (7, "Fu.7")


def test_a_command_reply_of_c320_is_no_fact_unless_its_item_is_known() -> None:
    """Class 4: the data are those of the monitor that F6.12 selects; unknown, they are not published."""
    plain = dialect_for("c320")
    stop = plain.stop(StopMode.STOP)
    assert stop[0].expected_item is None
    assert (
        plain.decode_readings(
            stop[0],
            sunfar.SunfarReply(address=1, response=sunfar.SunfarResponse.OK, state=sunfar.SunfarState.STOPPED, group=0),
            1.0,
        )
        == {}
    )
    known = dialect_for("c320", class4_item=0)
    request = known.reset()[0].request
    facts = known.decode_readings(request, c320_reply(sunfar.SunfarState.STOPPED, 0, 1234), 1.0)
    assert {name: reading.value for name, reading in facts.items()} == {"output_frequency": 12.34}


@pytest.mark.parametrize(
    ("word", "state"),
    [
        (0x0001, DriveState.STOPPED),
        (0x0000, DriveState.NOT_READY),
        (0x0005, DriveState.NOT_READY),
        (0x0009, DriveState.RUNNING),
        (0x0109, DriveState.JOGGING),
        (0x0089, DriveState.BRAKING),
        (0x0019, DriveState.DECELERATING),  # an emergency stop under way is no DC braking
        (0x0049, DriveState.RESTARTING),
        (0x0029, DriveState.PAUSED),
        (0x0002, DriveState.FAULT),
        (0x000A, DriveState.RUNNING),
    ],
)
def test_the_state_of_vc660_reports_motion_first(word: int, state: DriveState) -> None:
    derived = derived_vc660(word, word)
    assert derived is not None and derived.state is state


def test_vc660_direction_is_what_the_output_does() -> None:
    derived = derived_vc660(0x8009, 0x8009)
    assert derived is not None and derived.direction is Direction.REVERSE


@pytest.mark.parametrize("bit", range(9, 14))
def test_a_status_word_with_a_reserved_bit_is_rejected(bit: int) -> None:
    dialect = dialect_for("vc660")
    reply = modbus.RegisterValues(1, 3, (0x0001 | 1 << bit,))
    facts = dialect.decode_readings(modbus.ReadRegisters(1, 0x3000, 1), reply, 1.0)
    assert (facts["state"].quality, facts["state"].reason) == (Quality.BAD, "drives.reserved_bits")
    assert derived_vc660(0x0001 | 1 << bit, 0x0001 | 1 << bit) is None


def test_vc660_names_every_fault_bit_and_says_so_where_it_names_none() -> None:
    assert derived_vc660(0x0002, 0x0002, faults=(0x0001, 0)) == DerivedState(DriveState.FAULT, None, 0)
    assert derived_vc660(0x0002, 0x0002, faults=(0, 0x0004)) == DerivedState(DriveState.FAULT, None, 18)
    assert derived_vc660(0x0002, 0x0002) == DerivedState(DriveState.FAULT, None, UNNAMED_FAULT_CODE)
    unnamed = reported_fault(profiles.load("vc660"), DerivedState(DriveState.FAULT, None, UNNAMED_FAULT_CODE))
    assert unnamed is not None and unnamed.text.zh == "代码未知的故障"
    two = derived_vc660(0x0002, 0x0002, faults=(0x0021, 0))
    assert two == DerivedState(DriveState.FAULT, None, 0, further_fault_codes=(5,))
    fault = reported_fault(profiles.load("vc660"), two)
    assert fault is not None and fault.text.en.startswith("under-voltage; fault bit 5, ")
    assert reported_fault(profiles.load("vc660"), DerivedState(DriveState.STOPPED)) is None


def test_the_labels_of_several_faults_at_once_read_alike_in_every_language() -> None:
    state = DerivedState(DriveState.FAULT, None, 7, further_fault_codes=(8,))
    fault = reported_fault(profiles.load("c320"), state)
    assert fault is not None and fault.label == "Fu.7 + Fu.8"


def test_dzb100_is_stopped_only_when_q01_reads_zero_twice() -> None:
    assert judged_dzb((0, 0)) == DerivedState(DriveState.STOPPED)
    assert judged_dzb((5, 0)) is None
    assert judged_dzb((0, 5)) is None
    assert judged_dzb((5, 6)) == DerivedState(DriveState.RUNNING)


def test_dzb100_fault_needs_two_equal_codes() -> None:
    assert judged_dzb((0, 0), (0x0014, 0x0014)) == DerivedState(DriveState.FAULT, None, 14)
    assert judged_dzb((0, 0), (0x0000, 0x0014)) is None
    assert judged_dzb((0, 0), (0x000E, 0x000E), fault_coding="hex") == DerivedState(DriveState.FAULT, None, 14)


def test_dzb100_never_takes_the_command_echo_for_the_state() -> None:
    """T20: Q03's A is "run forward"; the output is 0, so the drive is stopped."""
    assert judged_dzb((0, 0), (0x1000, 0x1000)) == DerivedState(DriveState.STOPPED)


def test_an_undocumented_fault_code_is_rejected() -> None:
    dialect = dialect_for("dzb100")
    facts = dialect.decode_readings(
        dzb100.Dzb100Query(1, 3), dzb100.Dzb100Reply(head="Q", address=1, index=3, data=0x0099, accepted=True), 1.0
    )
    assert facts["fault"].quality is Quality.BAD
    state = facts["state"]
    assert (state.raw, state.quality, state.reason) == (0x0099, Quality.BAD, "drives.not_documented"), "it was missing"
    assert judged_dzb((0, 0), (0x0099, 0x0099)) is None


def test_df800_has_no_state_to_judge() -> None:
    dialect = dialect_for("df800")
    assert not dialect.reports_run_state
    assert dialect.state_reads() == ()
    assert dialect.derive_state(ReadingPairs()) is None


# --- readings -----------------------------------------------------------------------------------------------------


def test_a_value_outside_its_range_is_uncertain() -> None:
    dialect = dialect_for("vc660")
    facts = dialect.decode_readings(modbus.ReadRegisters(1, 0x3006, 1), modbus.RegisterValues(1, 3, (1300,)), 1.0)
    assert (facts["dc_bus_voltage"].value, facts["dc_bus_voltage"].reason) == (1300.0, "drives.implausible")


def test_an_unpublished_scale_makes_a_reading_uncertain() -> None:
    dialect = dialect_for("c320")
    facts = dialect.decode_readings(sunfar.ReadMonitor(1, 1), c320_reply(sunfar.SunfarState.STOPPED, 1, 380), 1.0)
    assert facts["output_voltage"].quality is Quality.UNCERTAIN


def test_in_a_fault_a_monitor_reply_without_its_item_is_uncertain() -> None:
    dialect = dialect_for("c320")
    facts = dialect.decode_readings(
        sunfar.ReadMonitor(1, 0), c320_reply(sunfar.SunfarState.FAULT, data=500, fault=2), 1.0
    )
    reading = facts["output_frequency"]
    assert (reading.value, reading.quality, reading.reason) == (5.0, Quality.UNCERTAIN, "drives.item_not_echoed")


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        (1, "drives.modbus_exception_1"),
        (2, "drives.modbus_exception_2"),
        (3, "drives.modbus_exception_3"),
        (4, "drives.modbus_exception_4"),
        (5, "drives.modbus_exception_5"),  # from here on no words of the manual, but the code to look up
        (6, "drives.modbus_exception_6"),
        (7, "drives.modbus_exception_7"),
        (8, "drives.modbus_exception_8"),
        (10, "drives.modbus_exception_10"),
        (11, "drives.modbus_exception_11"),
        (None, "drives.read_refused"),  # a shortened rejection
    ],
)
def test_a_rejected_read_has_the_meaning_of_its_exception(code: int | None, reason: str) -> None:
    dialect: Any = dialect_for("vc660")
    request = modbus.ReadRegisters(1, 0x3000, 1)
    assert dialect.decode_readings(request, modbus.ExceptionReply(1, 3, code), 0.0)["state"].reason == reason


@pytest.mark.parametrize("code", [1, 2, 3, 4])
def test_the_next_step_after_a_documented_modbus_exception_is_apart_from_its_meaning(code: int) -> None:
    """The meaning is also the reason of a reading and a part of the sentence about a stop."""
    rejection = dialect_for("vc660").rejection(modbus.ExceptionReply(1, 6, code))
    assert rejection.remedy_key == f"drives.modbus_remedy_{code}" and i18n.known(rejection.remedy_key)
    for language, words in (("en", ("check", "compare")), ("zh", ("请",))):
        assert any(word in i18n.text(rejection.remedy_key, language) for word in words)
        assert not any(word in i18n.text(rejection.key, language) for word in words)


@pytest.mark.parametrize("code", [5, 6, 7, 8, 10, 11])
def test_an_exception_whose_meaning_differs_between_makers_names_the_manual(code: int) -> None:
    rejection = dialect_for("vc660").rejection(modbus.ExceptionReply(1, 6, code))
    assert rejection.remedy_key is None and "see the manual" in i18n.text(rejection.key)


SUNFAR_REJECTIONS = {
    1: "drives.sunfar_response_1",
    2: "drives.sunfar_response_2",
    3: "drives.sunfar_response_3",
    4: "drives.sunfar_response_4",
    6: "drives.sunfar_response_6",
    7: "drives.sunfar_response_7",
    8: "drives.sunfar_response_8",
}


@pytest.mark.parametrize("response", list(sunfar.SunfarResponse))
def test_each_response_of_a_c320_but_the_accepting_one_is_named_as_its_rejection(
    response: sunfar.SunfarResponse,
) -> None:
    found = dialect_for("c320").rejection(replace(c320_reply(sunfar.SunfarState.STOPPED), response=response))
    assert (found and found.key) == SUNFAR_REJECTIONS.get(response)
    assert found is None or (found.code == response and str(found.code) in i18n.text(found.key, "zh"))


@pytest.mark.parametrize(("accepted", "key"), [(True, None), (False, "drives.dzb100_rejected"), (None, None)])
def test_only_the_rejecting_reply_of_a_dzb100_is_named_a_rejection(accepted: bool | None, key: str | None) -> None:
    """A reply to a query has no code."""
    found = dialect_for("dzb100").rejection(dzb100.Dzb100Reply(head="C", address=1, index=1, data=0, accepted=accepted))
    assert (found and found.key) == key


@pytest.mark.parametrize("code", [6, 7, 8])
def test_a_rejection_without_a_state_names_its_response_code(code: int) -> None:
    dialect: Any = dialect_for("c320")
    reply = sunfar.SunfarReply(address=1, response=sunfar.SunfarResponse(code))
    state = dialect.decode_readings(sunfar.ReadMonitor(1, 0), reply, 0.0)["state"]
    assert (state.value, state.reason) == (None, f"drives.sunfar_response_{code}")
    assert f"({code})" in i18n.text(state.reason) and i18n.text(state.reason, "zh") != i18n.text(state.reason)


def test_a_refused_monitor_has_no_value_and_is_never_zero() -> None:
    dialect = dialect_for("c320")
    reply = sunfar.SunfarReply(
        address=1, response=sunfar.SunfarResponse.RESERVED, state=sunfar.SunfarState.STOPPED, group=0, item=37, data=0
    )
    facts = dialect.decode_readings(sunfar.ReadMonitor(1, 37), reply, 1.0)
    assert facts["last_fault_temperature"].value is None
    assert facts["last_fault_temperature"].reason == "drives.sunfar_response_4"
    assert "state" in facts


@pytest.mark.parametrize(
    ("coding", "word", "hz"), [("hex-0.1", 0x7B, 12.3), ("hex-0.01", 0x4CE, 12.3), ("decimal-0.1", 0x123, 12.3)]
)
def test_dzb100_reads_frequencies_by_its_query_coding(coding: str, word: int, hz: float) -> None:
    dialect = dialect_for("dzb100", query_coding=coding)
    reading = dialect.decode_readings(
        dzb100.Dzb100Query(1, 1), dzb100.Dzb100Reply(head="Q", address=1, index=1, data=word, accepted=True), 1.0
    )["output_frequency"]
    assert (reading.value, reading.quality) == (hz, Quality.GOOD)


def test_dzb100_readings_are_uncertain_until_the_coding_is_determined() -> None:
    dialect = dialect_for("dzb100")
    reading = dialect.decode_readings(
        dzb100.Dzb100Query(1, 1), dzb100.Dzb100Reply(head="Q", address=1, index=1, data=0x7B, accepted=True), 1.0
    )["output_frequency"]
    assert (reading.value, reading.quality, reading.reason) == (12.3, Quality.UNCERTAIN, "drives.coding_undetermined")


def test_a_decimal_word_with_a_hexadecimal_digit_is_bad() -> None:
    dialect = dialect_for("dzb100", query_coding="decimal-0.1")
    reading = dialect.decode_readings(
        dzb100.Dzb100Query(1, 1), dzb100.Dzb100Reply(head="Q", address=1, index=1, data=0x7B, accepted=True), 1.0
    )["output_frequency"]
    assert (reading.value, reading.reason) == (None, "drives.not_decimal")


@pytest.mark.parametrize(
    ("coding", "raw", "seconds"), [("hex-0.1", 0x96, 15.0), ("decimal-0.1", 0x150, 15.0), ("hex-0.01", 0x5DC, 15.0)]
)
def test_dzb100_parameters_have_a_coding_of_their_own(coding: str, raw: int, seconds: float) -> None:
    dialect = dialect_for("dzb100", parameter_coding=coding)
    parameter = dialect.profile.parameters["10"]
    assert dialect.parameter_reading(parameter, raw, None).value == seconds
    assert dialect.parameter_word(parameter, seconds) == raw


# --- the tenfold trap ---------------------------------------------------------------------------------------------


def test_no_word_below_the_cap_is_more_than_five_hertz_under_any_coding() -> None:
    """Every word, with every set of codings that may be left."""
    for count in range(1, 1 << len(FREQUENCY_CODINGS)):
        left = tuple(c for place, c in enumerate(FREQUENCY_CODINGS) if count >> place & 1)
        for word in range(highest_safe_word(left) + 1):
            if is_within_cap(word, left):
                assert all((decode_or_none(word, c) or 0.0) <= 5.0 for c in left)
        assert not is_within_cap(highest_safe_word(left) + 1, left) or highest_safe_word(left) == 4000


def test_the_cap_is_five_while_one_hertz_a_digit_is_possible() -> None:
    assert highest_safe_word(FREQUENCY_CODINGS) == 5
    assert highest_safe_word(("hex-0.1", "hex-0.01", "decimal-0.1")) == 0x32
    assert highest_safe_word(("hex-0.1",)) == 50


@pytest.mark.parametrize(("hz", "word"), [(0.1, 1), (0.5, 5)])
def test_an_uncalibrated_dzb100_accepts_frequencies_below_the_cap(hz: float, word: int) -> None:
    assert dialect_for("dzb100").setpoint_word(hz) == word and dialect_for("dzb100").setpoint_cap_hz == 0.5


@pytest.mark.parametrize("hz", [0.6, 5.0, 10.0, 50.0])
def test_an_uncalibrated_dzb100_refuses_frequencies_above_the_cap(hz: float) -> None:
    with pytest.raises(LimitError) as caught:
        dialect_for("dzb100").setpoint_word(hz)
    assert (caught.value.key, caught.value.params["cap"]) == ("drives.coding_cap", "0005H")
    known = dialect_for("dzb100", setpoint_coding="hex-0.1")
    assert known.setpoint_word(hz) == round(hz * 10) and known.setpoint_cap_hz is None


@pytest.mark.parametrize(
    ("coding", "word"), [("hex-0.1", 0x64), ("hex-0.01", 0x3E8), ("decimal-0.1", 0x100), ("hex-1", 0x0A)]
)
def test_a_calibrated_dzb100_gets_ten_hertz_in_its_own_coding(coding: str, word: int) -> None:
    dialect = dialect_for("dzb100", setpoint_coding=coding)
    assert dialect.setpoint_word(10.0) == word
    assert dialect.setpoint_frequency(word) == 10.0
    assert isinstance(dialect, Dzb100Dialect) and possible_codings(dialect.options) == (coding,)


# --- polls --------------------------------------------------------------------------------------------------------


def registers_of(polls: Any) -> set[int]:
    return {request.register + n for request, _ in polls for n in range(request.count)}


def test_vc660_reads_the_requested_registers_at_most_four_at_once() -> None:
    dialect = dialect_for("vc660")
    polls = dialect.polls(tuple(dialect.profile.signals))
    assert registers_of(polls) == {signal.locator[1] for signal in dialect.profile.signals.values()}
    assert max(request.count for request, _ in polls) == 4
    few = dialect.polls(("output_frequency", "output_voltage"))
    assert registers_of(few) == {0x3000, 0x3002, 0x3004}


def test_touching_registers_share_one_read() -> None:
    dialect = dialect_for("vc660")
    polls = dialect.polls(("set_frequency", "output_frequency", "output_current"))
    assert [(request.register, request.count) for request, _ in polls] == [(0x3000, 4)]


def test_a_register_wanted_every_ten_seconds_is_not_read_twice_a_second() -> None:
    dialect = dialect_for("vc660")
    periods = {request.register: period for request, period in dialect.polls(("output_current", "input_terminals"))}
    assert periods[0x3007] == 10.0


@pytest.mark.parametrize("model", MODELS)
def test_polls_only_read(model: str) -> None:
    from drivebus.protocols.codec import Effect

    dialect = dialect_for(model)
    for request, period in dialect.polls(tuple(dialect.profile.signals)):
        assert dialect.station_config.effect_of(dialect.codec.encode_request(request)) is Effect.NONE
        assert period > 0


@pytest.mark.parametrize(("model", "cap_hz", "step_hz"), [("c320", 0.5, 0.01), ("c300", 0.5, 0.01), ("e300", 5.0, 0.1)])
def test_a_frequency_is_capped_until_the_step_of_the_drive_is_known(model: str, cap_hz: float, step_hz: float) -> None:
    """No read-back shows a wrong step: word 50 is 0.5 Hz to a C320 and 5 Hz to an E300."""
    dialect = dialect_for(model, setpoint_step="unknown")
    assert dialect.setpoint_word(cap_hz) == 50 and dialect.setpoint_cap_hz == cap_hz
    with pytest.raises(LimitError) as caught:
        dialect.setpoint_word(cap_hz + step_hz)
    assert caught.value.key == "drives.step_cap" and caught.value.params["cap_hz"] == cap_hz
    known = dialect_for(model, setpoint_step=f"{step_hz:g}")
    assert known.setpoint_word(50.0) == round(50.0 / step_hz) and known.setpoint_cap_hz is None
    with pytest.raises(LimitError, match="does not fit this drive"):
        dialect_for(model, setpoint_step="0.1" if step_hz == 0.01 else "0.01").setpoint_word(0.1)


@pytest.mark.parametrize(("index", "item"), [("binary", 37), ("bcd", 0x37)])
def test_the_item_of_a_c320_monitor_follows_its_option(index: str, item: int) -> None:
    dialect = dialect_for("c320", monitor_index=index)
    request = dialect.polls(("last_fault_temperature",))[0][0]
    assert request.item == item
    facts = dialect.decode_readings(request, c320_reply(sunfar.SunfarState.STOPPED, item, 60), 1.0)
    assert facts["last_fault_temperature"].value == 60


def test_polls_follow_a_reloaded_profile_that_changes_or_lacks_a_signal() -> None:
    """The output frequency is read for the state as well, where the new profile does not describe it."""
    dialect, name = dialect_for("dzb100"), "output_frequency"
    signals = dict(dialect.profile.signals)
    dialect.profile = replace(dialect.profile, signals=signals | {name: replace(signals[name], period_s=7.0)})
    assert dict(dialect.polls((name,)))[dzb100.Dzb100Query(1, 1)] == 7.0
    del signals[name]
    dialect.profile = replace(dialect.profile, signals=signals)
    assert dzb100.Dzb100Query(1, 1) in dict(dialect.polls((name,)))


# --- probes --------------------------------------------------------------------------------------------


def bus_sync_probes(dialect: Dialect, count: int) -> list[Any]:
    return [dialect.station_config.sync_request(n) for n in range(count)]


@pytest.mark.parametrize("model", MODELS)
def test_sync_probes_only_read(model: str) -> None:
    from drivebus.protocols.codec import Effect

    dialect = dialect_for(model)
    for probe in [*bus_sync_probes(dialect, 100), *(dialect.sync_request() for _ in range(100))]:
        assert dialect.station_config.effect_of(dialect.codec.encode_request(probe)) is Effect.NONE


def test_a_c320_sync_probe_reads_a_group_other_than_0_and_neighbours_differ_in_group() -> None:
    dialect = dialect_for("c320")
    for probes in (bus_sync_probes(dialect, 9), [dialect.sync_request() for _ in range(9)]):
        assert all(isinstance(f, sunfar.SunfarReadParameter) and f.group != 0 for f in probes)
        assert all(a.group != b.group for a, b in itertools.pairwise(probes))


def test_bus_and_operations_never_use_the_same_sync_probe_on_c320_and_dzb100() -> None:
    for model in ("c320", "dzb100"):
        dialect = dialect_for(model)
        ours = {dialect.sync_request() for _ in range(200)}
        assert not ours & set(bus_sync_probes(dialect, 200))


@pytest.mark.parametrize("model", ["c320", "dzb100"])
def test_a_sync_probe_never_equals_the_read_after_it(model: str) -> None:
    dialect = dialect_for(model)
    for parameter in dialect.profile.parameters.values():
        request = dialect.read_parameter(parameter)
        dialect.on_sent(request)
        for _ in range(50):
            assert dialect.sync_request(avoid=request) != request
        assert request not in bus_sync_probes(dialect, 100)


def test_a_dzb100_sync_probe_is_reused_only_after_the_longest_reply_lateness() -> None:
    """40 tags, each a transaction of 22 characters of 11 bits at 4800 baud at least: 2 s, lateness is 0.5 s."""
    dialect = dialect_for("dzb100")
    probes = [dialect.sync_request().parameter for _ in range(200)]
    apart = min(
        later - first
        for first in range(len(probes))
        for later in range(first + 1, len(probes))
        if probes[first] == probes[later]
    )
    assert apart * 22 * 11 / 4800 > dialect.profile.timing.max_reply_lateness_s
    assert all(0 <= number <= 80 for number in probes)


def test_vc660_sync_probes_have_a_nonce_that_is_not_reused() -> None:
    dialect = dialect_for("vc660")
    nonces = [f.data for f in [*bus_sync_probes(dialect, 5000), *(dialect.sync_request() for _ in range(5000))]]
    assert len(set(nonces)) == len(nonces)


def probes_of_a_new_drive(url: str, **options: Any) -> list[int]:
    """Return the nonces of the first 20 sync probes of the bus and of the operations of a VC660."""
    drive = Drive(Bus(open_port(url)), "vc660", 1, store=MemoryStore(), **options)
    return [f.data for f in [*bus_sync_probes(drive.dialect, 20), *(drive.dialect.sync_request() for _ in range(20))]]


def test_vc660_nonces_differ_between_processes_so_that_a_late_reply_to_the_last_one_fits_no_probe() -> None:
    """Every process began with the same nonces: a reply that was still under way at a restart fitted the new probe."""
    starts = {tuple(probes_of_a_new_drive("/dev/ttyUSB9")) for _ in range(4)}
    assert len(starts) > 1
    words = iter((0, 0xFFFF, 0x1234))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("drivebus.drives.drive.random_word", lambda: next(words))
        assert [probes_of_a_new_drive("/dev/ttyUSB9")[0] for _ in range(3)] == [0, 0xFFFF, 0x1234]


def test_vc660_nonces_repeat_on_a_simulated_port_and_with_a_given_start() -> None:
    """A campaign and a replay repeat to the last byte."""
    assert probes_of_a_new_drive("sim://vc660@1") == probes_of_a_new_drive("sim://vc660@1")
    assert probes_of_a_new_drive("/dev/ttyUSB9", nonce_start=7)[0] == 7


def test_only_df800_sync_probes_read_two_registers_at_once() -> None:
    dialect = dialect_for("df800")
    probes = [*bus_sync_probes(dialect, 20), *(dialect.sync_request() for _ in range(20))]
    assert {(f.register, f.count) for f in probes} == {(100, 2), (107, 2)}
    reads = [request for request, _ in dialect.polls(tuple(dialect.profile.signals))]
    reads += [dialect.read_parameter(p) for p in dialect.profile.parameters.values()]
    assert all(request.count != 2 for request in reads)


def test_two_adjacent_registers_are_read_apart_where_a_read_of_two_is_a_sync_probe() -> None:
    profile = profiles.load("df800")
    current = profile.signals["output_current"]
    beside = replace(current, name="beside", locator=("holding", current.locator[1] + 1))
    third = replace(current, name="third", locator=("holding", current.locator[1] + 2))
    two = create_dialect(replace(profile, signals={"output_current": current, "beside": beside}), 1)
    assert [r.count for r, _ in two.polls(("output_current", "beside"))] == [1, 1]
    signals = {"output_current": current, "beside": beside, "third": third}
    three = create_dialect(replace(profile, signals=signals), 1)
    assert [r.count for r, _ in three.polls(tuple(signals))] == [3]


def test_a_reply_that_echoes_too_little_is_no_valid_sync_reply() -> None:
    assert not dialect_for("c320").is_valid_sync_reply(
        sunfar.SunfarReply(address=1, response=sunfar.SunfarResponse.BAD_CODE)
    )
    assert not dialect_for("vc660").is_valid_sync_reply(modbus.ExceptionReply(1, 8, 1))


def test_a_rejected_read_of_a_c320_is_the_reason_of_its_signal_and_of_the_state() -> None:
    """The signals showed a missing reply, although the drive had rejected each read."""
    dialect = dialect_for("c320")
    rejected = sunfar.SunfarReply(address=1, response=sunfar.SunfarResponse.BAD_CODE)
    [(request, _)] = dialect.polls(("dc_bus_voltage",))
    found = dialect.decode_readings(request, rejected, 1.0)
    assert set(found) == {"state", "dc_bus_voltage"}
    for reading in found.values():
        assert (reading.value, reading.reason) == (None, "drives.sunfar_response_6")
    assert dialect.decode_readings(sunfar.SunfarReadParameter(1, 0, 1), rejected, 1.0) == {}


# --- making one ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("model", "address"), [("c320", 31), ("dzb100", 0), ("vc660", 0)])
def test_a_drive_at_the_broadcast_address_is_refused(model: str, address: int) -> None:
    with pytest.raises(ConfigurationError) as caught:
        create_dialect(profiles.load(model), address)
    assert caught.value.key == "drives.address_broadcast"


@pytest.mark.parametrize(
    ("given", "key", "found"),
    [
        ({"address": 32}, "drives.address", 32),
        ({"address": 31}, "drives.address_broadcast", 31),
        ({"encoding": "rtu"}, "drives.encoding", "rtu"),
        ({"options": {"colour": 1}}, "drives.option", "colour"),
    ],
)
def test_an_address_encoding_or_option_unknown_to_the_model_is_refused(
    given: dict[str, Any], key: str, found: Any
) -> None:
    with pytest.raises(ConfigurationError) as caught:
        create_dialect(profiles.load("c320"), **({"address": 1} | given))
    assert (caught.value.key, caught.value.params["found"]) == (key, found)


@pytest.mark.parametrize("model", profiles.models())
def test_every_profile_that_comes_with_drivebus_makes_a_dialect(model: str) -> None:
    profile = profiles.load(model)
    for encoding in profile.encodings:
        dialect = create_dialect(profile, profile.addresses[0] or 1, encoding=encoding)
        assert dialect.codec.encoding == encoding
        assert dialect.codec.encode_request(dialect.station_config.sync_request(0))


def test_an_emergency_stop_of_c320_that_still_shows_a_frequency_is_no_standstill() -> None:
    """Manual 2.4.6 does not state that the output is off in it."""
    dialect = dialect_for("c320")
    for state, data, seen in (
        (sunfar.SunfarState.EMERGENCY_STOP, 300, False),
        (sunfar.SunfarState.EMERGENCY_STOP, 0, True),
        (sunfar.SunfarState.STOPPED, 0, True),
    ):
        shown = (sunfar.ReadMonitor(1, 0), c320_reply(state, data=data))
        assert dialect.confirms_stop(book_of(dialect, shown, shown)) is seen
