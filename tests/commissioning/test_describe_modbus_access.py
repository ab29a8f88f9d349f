"""Frames of coils, input registers and numbers in two registers, described with the facts of a profile."""

from __future__ import annotations

from typing import Any

import pytest

from drivebus import profiles
from drivebus.commissioning.decode.modbus import describe
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
