"""Frames of coils, input registers and numbers in two registers, described with the facts of a profile."""

from __future__ import annotations

from typing import Any, get_args

import pytest

from drivebus import i18n, profiles
from drivebus.commissioning.decode import labels
from drivebus.commissioning.decode.modbus import describe
from drivebus.profiles.schema import StatusName
from drivebus.protocols import modbus

CODEC = modbus.ModbusRtuCodec()


def request_fields(model: str, request: Any) -> Any:
    frame = CODEC.encode_request(request)
    return describe(profiles.load(model), frame, "rtu", "request", None)


def reply_fields(model: str, request: Any, reply: Any) -> Any:
    sent = CODEC.encode_request(request)
    return describe(profiles.load(model), CODEC.encode_reply(reply), "rtu", "response", sent).fields


@pytest.mark.parametrize(
    ("model", "request_", "commands"),
    [
        ("wj200", modbus.WriteBits(1, 0, (True, True, False, False)), ["start_reverse"]),
        ("wj200", modbus.WriteBits(1, 0, (False, False, False, False)), ["stop"]),
        ("h100", modbus.WriteBit(1, 0x4B, True), ["stop"]),
        ("h100", modbus.WriteBit(1, 0x49, True), ["start_forward"]),
    ],
)
def test_a_command_in_coils_is_named(model: str, request_: Any, commands: list[str]) -> None:
    assert request_fields(model, request_).fields["commands"] == commands


@pytest.mark.parametrize(
    "request_", [modbus.WriteBit(1, 0, True), modbus.WriteBits(1, 0, (True, False)), modbus.WriteBit(1, 6, True)]
)
def test_a_part_of_a_command_or_an_unknown_coil_is_not_named(request_: Any) -> None:
    assert "commands" not in request_fields("wj200", request_).fields


def test_a_setpoint_in_two_registers_is_shown_in_hertz() -> None:
    shown = request_fields("wj200", modbus.WriteRegisters(1, 0, (1, 0x1170)))
    assert shown.fields["frequency_hz"] == 700.0 and not shown.errata


def test_a_number_in_two_registers_has_its_value_in_the_row_of_the_first() -> None:
    fields = reply_fields("wj200", modbus.ReadRegisters(1, 0x1000, 2), modbus.RegisterValues(1, 3, (1, 0x86A0)))
    first, second = fields["values"]
    assert (first["name"], first["value"], first["unit"]) == ("output_frequency", 1000.0, "Hz")
    assert second == {"notation": "1001H", "raw": 0x86A0}


def test_an_input_register_is_not_described_as_the_holding_register_of_its_number() -> None:
    for function, name in ((4, "output_frequency"), (3, None)):
        request = modbus.ReadRegisters(1, 0, 1, function)
        (row,) = reply_fields("h100", request, modbus.RegisterValues(1, function, (123,)))["values"]
        assert row.get("name") == name


def test_a_reply_with_a_byte_count_of_two_bytes_is_described_with_its_values() -> None:
    """Frames of FluidNC, H2AProtocol.md."""
    profile, sent = profiles.load("huanyang_h2a"), bytes.fromhex("01 03 70 0C 00 02 1E C8")
    reply = bytes.fromhex("01 03 00 04 09 5D 00 00 D1 49")
    for request in (sent, None):
        shown = describe(profile, reply, "rtu", "response" if request else None, request)
        assert shown.valid and shown.direction == "response" and shown.fields["registers"] == [2397, 0]
    first, _ = describe(profile, reply, "rtu", "response", sent).fields["values"]
    assert (first["name"], first["value"], first["unit"]) == ("output_speed", 2397, "rpm")


@pytest.mark.parametrize(
    ("model", "reply"),
    [("huanyang_h2a", "01 03 04 09 5D 00 00 A8 65"), ("skf8000", "01 03 00 04 09 5D 00 00 D1 49")],
)
def test_a_reply_of_the_other_form_is_described_as_invalid(model: str, reply: str) -> None:
    sent = bytes.fromhex("01 03 70 0C 00 02 1E C8")
    for request in (sent, None):
        assert not describe(profiles.load(model), bytes.fromhex(reply), "rtu", "response", request).valid


def test_a_read_that_the_drive_rejects_is_no_mistake_of_its_master() -> None:
    request, rejection = bytes.fromhex("01 03 FD 00 00 02 F5 A7"), bytes.fromhex("01 83 03 01 31")
    shown = describe(profiles.load("vf_s11"), request, "rtu", "request", None)
    assert shown.valid and not shown.errata
    assert [key for key, _ in describe(profiles.load("vf_s15"), request, "rtu", "request", None).errata] == [
        "explain.too_many"
    ]
    answer = describe(profiles.load("vf_s11"), rejection, "rtu", "response", request)
    assert answer.valid and answer.fields["exception"] == 3


def keys(notes: Any) -> list[str]:
    return [key for key, _ in notes]


def test_the_bits_of_a_status_word_and_of_the_fault_words_are_named() -> None:
    fields = reply_fields("vc660", modbus.ReadRegisters(1, 0x3000, 1), modbus.RegisterValues(1, 3, (0x4013,)))
    (row,) = fields["values"]
    assert row["status_bits"] == ["ready", "fault", "emergency_stopping", "set_reverse"]
    assert labels.value_text("status_bits", "emergency_stopping", "zh") == "紧急停车过程中"
    fields = reply_fields("vc660", modbus.ReadRegisters(1, 0x3016, 3), modbus.RegisterValues(1, 3, (1, 0x8000, 3)))
    first, second, warning = fields["values"]
    assert [fault.en for fault in first["faults"]] == ["under-voltage"]
    assert [fault.en.split()[:3] for fault in second["faults"]] == [["fault", "bit", "31,"]]
    assert "faults" not in warning and "status_bits" not in warning


def test_every_status_bit_of_the_profiles_has_its_text() -> None:
    names = get_args(StatusName)
    assert names and all(i18n.known(f"drives.bit_{name}") for name in names)


@pytest.mark.parametrize(
    ("model", "word", "bits"),
    [("vc660", 0x8400, (10, 15)), ("vc660", 0x03FF, ()), ("df800", 0x0021, (5,)), ("df800", 0x001F, ())],
)
def test_bits_that_the_manual_reserves_in_a_command_word_are_named(model: str, word: int, bits: Any) -> None:
    errata = request_fields(model, modbus.WriteRegister(1, 0x2000, word)).errata
    assert errata == ((("explain.undescribed_bits", {"word": word, "bits": bits}),) if bits else ())


def test_a_command_word_without_a_command_says_so() -> None:
    fields = request_fields("vc660", modbus.WriteRegister(1, 0x2000, 0)).fields
    assert fields["commands"] == [] and labels.value_text("commands", [], "en") == "none"


@pytest.mark.parametrize("register", [0x2002, 0x2003, 0x2004, 0x2005])
def test_a_write_of_input_terminals_is_named_with_its_hazard(register: int) -> None:
    shown = request_fields("vc660", modbus.WriteRegister(1, register, 1))
    assert "virtual inputs" in shown.fields["meaning"].en and keys(shown.hazards) == ["explain.terminals"]


@pytest.mark.parametrize(("register", "word", "errata"), [(0x2006, 8, ["explain.value_range"]), (0x2006, 7, [])])
def test_a_value_outside_the_range_of_the_manual_is_named(register: int, word: int, errata: list[str]) -> None:
    shown = request_fields("vc660", modbus.WriteRegister(1, register, word))
    assert keys(shown.errata) == errata and keys(shown.hazards) == []


def test_a_value_is_not_compared_with_a_range_that_the_manual_prints_wrong() -> None:
    assert request_fields("vc660", modbus.WriteRegister(1, 0x2008, 0xFFFF)).errata == ()


def test_a_written_choice_is_named() -> None:
    fields = request_fields("vc660", modbus.WriteRegister(1, 1, 4)).fields
    assert (fields["parameter"], fields["choice"].en) == ("F00.01", "serial port")
    assert "choice" not in request_fields("vc660", modbus.WriteRegister(1, 1, 2)).fields


def test_a_loop_back_of_another_sub_function_is_no_valid_frame_in_either_direction() -> None:
    frame = bytes.fromhex("01 08 00 01 5A A5 4B 10")
    for direction in (None, "request", "response"):
        shown = describe(profiles.load("vc660"), frame, "rtu", direction, None)  # type: ignore[arg-type]
        assert not shown.valid and keys(shown.problems) == ["modbus.sub_function"]
