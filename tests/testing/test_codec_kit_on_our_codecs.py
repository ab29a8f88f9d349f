"""The codecs of this package obey the contract of the conformance kit: all five encodings, on known frames."""

from __future__ import annotations

from typing import Any

import pytest

from drivebus.protocols import dzb100, sunfar
from drivebus.protocols.modbus import (
    Diagnostics,
    DiagnosticsReply,
    ModbusAsciiCodec,
    ModbusRtuCodec,
    ReadRegisters,
    RegisterValues,
    WriteAck,
    WriteRegister,
)
from drivebus.testing.codec_kit import CodecExchange, check_codec
from fixtures.vectors import Vector, load_vectors


def asked_sunfar(fields: dict[str, Any]) -> sunfar.SunfarRequest:
    """Without the operation of the manual's reads and writes, which no request of ours has."""
    address, kind = fields["address"], fields["class"]
    if kind == 0:
        return sunfar.ReadIdentity(address, fields["group"])
    if kind == 1:
        return sunfar.ReadMonitor(address, fields["item"])
    if kind == 2:
        return sunfar.SunfarReadParameter(address, fields["group"], fields["item"])
    if kind == 4:
        return sunfar.SunfarControl(
            address, sunfar.SunfarOperation(fields["operation"]), fields["data"], expected_item=0
        )
    return sunfar.SunfarWriteParameter(address, fields["group"], fields["item"], fields["data"], save=kind == 5)


def answered_sunfar(fields: dict[str, Any]) -> sunfar.SunfarReply:
    item, data = (None, None) if "info" in fields else (fields["item"], fields["data"])
    state, response = sunfar.SunfarState(fields["state"]), sunfar.SunfarResponse(fields["response"])
    return sunfar.SunfarReply(fields["address"], response, state, fields["group"], item, data, info=fields.get("info"))


def asked_dzb(fields: dict[str, Any]) -> dzb100.Dzb100Request:
    address = fields["address"]
    if fields["head"] == "C":
        return dzb100.Dzb100Control(
            address, dzb100.Dzb100Command(fields["command"]), fields["data"], fields.get("broadcast", False)
        )
    if fields["head"] == "P":
        return dzb100.Dzb100WriteParameter(address, fields["parameter"], fields["data"])
    return dzb100.Dzb100ReadParameter(address, fields["parameter"])


def answered_dzb(fields: dict[str, Any]) -> dzb100.Dzb100Reply:
    index = fields["command"] if fields["head"] == "C" else fields["parameter"]
    return dzb100.Dzb100Reply(fields["head"], fields["address"], index, fields["data"], fields["accepted"])


def asked_modbus(fields: dict[str, Any]) -> Any:
    if fields["function"] == 3:
        return ReadRegisters(fields["address"], fields["register"], fields["count"])
    if fields["function"] == 8:
        return Diagnostics(fields["address"], fields["data"])
    return WriteRegister(fields["address"], fields["register"], fields["value"])


def answered_modbus(fields: dict[str, Any]) -> Any:
    if fields["function"] == 3:
        return RegisterValues(fields["address"], 3, tuple(fields["registers"]))
    if fields["function"] == 8:
        return DiagnosticsReply(fields["address"], fields["data"])
    return WriteAck(fields["address"], 6, fields["register"], fields["value"])


WORDS = {
    "c320": (asked_sunfar, answered_sunfar),
    "dzb100": (asked_dzb, answered_dzb),
    "vc660": (asked_modbus, answered_modbus),
    "df800": (asked_modbus, answered_modbus),
}


def sendable(vector: Vector) -> bytes:
    """What a correct sender emits for the fields of a vector."""
    return vector.canonical if vector.canonical is not None and vector.model == "c320" else vector.data


def exchanges(family: str, encoding: str) -> list[CodecExchange]:
    """Each request of a family's file with the reply that the file has for it."""
    asked, answered = WORDS[family]
    found = [vector for vector in load_vectors(family) if vector.encoding == encoding]
    replies = {vector.line["reply_to"]: vector for vector in found if "reply_to" in vector.line}
    made = []
    for vector in found:
        if vector.direction == "request":
            reply = replies.get(vector.id)
            fields = None if reply is None else reply.fields | reply.line.get("meant", {})
            message = None if fields is None else answered(fields)
            received = b"" if reply is None else reply.canonical or reply.data
            made.append(CodecExchange(vector.id, asked(vector.fields), sendable(vector), message, received))
    return made


CODECS: list[tuple[str, str, Any, Any]] = [
    ("c320", "ascii", sunfar.SunfarCodec("ascii"), lambda received: received.request),
    ("c320", "hex", sunfar.SunfarCodec("hex"), lambda received: received.request),
    ("vc660", "rtu", ModbusRtuCodec(), lambda request: request),
    ("df800", "rtu", ModbusRtuCodec("short"), lambda request: request),
    ("df800", "ascii", ModbusAsciiCodec("short"), lambda request: request),
]


@pytest.mark.parametrize(("family", "encoding", "codec", "received"), CODECS, ids=lambda value: str(value)[:6])
def test_a_codec_with_a_check_accepts_no_flip(family: str, encoding: str, codec: Any, received: Any) -> None:
    made = exchanges(family, encoding)
    assert made
    report = check_codec(codec, made, request_of=received, garbage_frames=60)
    assert not any(report.accepted_flips.values())


def test_dzb100_accepts_flips_and_the_kit_counts_them() -> None:
    """Nothing on its wire detects a flip: a read reply's data digits and the acknowledgement byte are open to them.

    A write and a command echo their data, so only byte 2 is left: 07H is an error reply, 02H and 04H are state digits.
    """
    report = check_codec(dzb100.Dzb100Codec(), exchanges("dzb100", "ascii"), detects_flips=False, garbage_frames=60)
    believed = {name: {place for place, _ in flips} for name, flips in report.accepted_flips.items() if flips}
    assert believed == {"dzb100-1-request": {2}, "dzb100-2-request": {2}, "dzb100-3-request": {2, 7, 8, 9, 10}}
    assert {name: len(flips) for name, flips in report.accepted_flips.items() if flips} == {
        "dzb100-1-request": 3,
        "dzb100-2-request": 1,
        "dzb100-3-request": 15,
    }
