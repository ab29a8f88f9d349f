"""The codecs of Sunfar, DZB100 and Modbus obey the contract of the conformance kit, on known frames."""

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


def sunfar_request(fields: dict[str, Any]) -> sunfar.SunfarRequest:
    """Return a request without the operation of the manual's reads and writes, which drivebus never sends."""
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


def sunfar_reply(fields: dict[str, Any]) -> sunfar.SunfarReply:
    item, data = (None, None) if "info" in fields else (fields["item"], fields["data"])
    state, response = sunfar.SunfarState(fields["state"]), sunfar.SunfarResponse(fields["response"])
    return sunfar.SunfarReply(
        address=fields["address"],
        response=response,
        state=state,
        group=fields["group"],
        item=item,
        data=data,
        info=fields.get("info"),
    )


def dzb100_request(fields: dict[str, Any]) -> dzb100.Dzb100Request:
    address = fields["address"]
    if fields["head"] == "C":
        return dzb100.Dzb100Control(
            address, dzb100.Dzb100Command(fields["command"]), fields["data"], fields.get("broadcast", False)
        )
    if fields["head"] == "P":
        return dzb100.Dzb100WriteParameter(address, fields["parameter"], fields["data"])
    return dzb100.Dzb100ReadParameter(address, fields["parameter"])


def dzb100_reply(fields: dict[str, Any]) -> dzb100.Dzb100Reply:
    index = fields["command"] if fields["head"] == "C" else fields["parameter"]
    return dzb100.Dzb100Reply(
        head=fields["head"], address=fields["address"], index=index, data=fields["data"], accepted=fields["accepted"]
    )


def modbus_request(fields: dict[str, Any]) -> Any:
    if fields["function"] == 3:
        return ReadRegisters(fields["address"], fields["register"], fields["count"])
    if fields["function"] == 8:
        return Diagnostics(fields["address"], fields["data"])
    return WriteRegister(fields["address"], fields["register"], fields["value"])


def modbus_reply(fields: dict[str, Any]) -> Any:
    if fields["function"] == 3:
        return RegisterValues(fields["address"], 3, tuple(fields["registers"]))
    if fields["function"] == 8:
        return DiagnosticsReply(fields["address"], fields["data"])
    return WriteAck(fields["address"], 6, fields["register"], fields["value"])


WORDS = {
    "c320": (sunfar_request, sunfar_reply),
    "dzb100": (dzb100_request, dzb100_reply),
    "vc660": (modbus_request, modbus_reply),
    "df800": (modbus_request, modbus_reply),
}


def sendable(vector: Vector) -> bytes:
    """Return the bytes of a correct sender for the fields of a vector."""
    return vector.canonical if vector.canonical is not None and vector.model == "c320" else vector.data


def exchanges(family: str, encoding: str) -> list[CodecExchange]:
    """Return each request of a family's file with its reply in the file."""
    make_request, make_reply = WORDS[family]
    found = [vector for vector in load_vectors(family) if vector.encoding == encoding]
    replies = {vector.line["reply_to"]: vector for vector in found if "reply_to" in vector.line}
    made = []
    for vector in found:
        if vector.direction == "request":
            reply = replies.get(vector.id)
            fields = None if reply is None else reply.fields | reply.line.get("meant", {})
            message = None if fields is None else make_reply(fields)
            received = b"" if reply is None else reply.canonical or reply.data
            made.append(
                CodecExchange(
                    name=vector.id,
                    request=make_request(vector.fields),
                    sent=sendable(vector),
                    reply=message,
                    received=received,
                )
            )
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
    """DZB100 has no checksum: flips in the data digits of a reply and in the acknowledgement byte are not detected.

    A write and a command echo their data, so only byte 2 is left: 07H is an error reply, 02H and 04H are state digits.
    """
    report = check_codec(dzb100.Dzb100Codec(), exchanges("dzb100", "ascii"), detects_flips=False, garbage_frames=60)
    accepted = {name: {place for place, _ in flips} for name, flips in report.accepted_flips.items() if flips}
    assert accepted == {"dzb100-1-request": {2}, "dzb100-2-request": {2}, "dzb100-3-request": {2, 7, 8, 9, 10}}
    assert {name: len(flips) for name, flips in report.accepted_flips.items() if flips} == {
        "dzb100-1-request": 3,
        "dzb100-2-request": 1,
        "dzb100-3-request": 15,
    }
