"""Every golden frame of VC660 and DF800 through the codecs, with its verdict."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import pytest

from drivebus.errors import ChecksumError, ProtocolError
from drivebus.protocols.codec import Complete, CompleteIfSilent, Incomplete
from drivebus.protocols.modbus import (
    Diagnostics,
    DiagnosticsReply,
    ExceptionReply,
    ModbusAsciiCodec,
    ModbusRtuCodec,
    ReadRegisters,
    RegisterValues,
    WriteAck,
    WriteRegister,
)
from drivebus.testing.codec_kit import CodecExchange, check_codec
from fixtures.vectors import Vector, load_vectors

VECTORS = (*load_vectors("vc660"), *load_vectors("df800"))
REQUESTS = [each for each in VECTORS if each.direction == "request"]
REPLIES = [each for each in VECTORS if each.direction == "response"]
ANSWERED = [each for each in REPLIES if each.request is not None and each.plain]


def codec_for(vector: Vector) -> ModbusRtuCodec | ModbusAsciiCodec:
    form = "short" if vector.model == "df800" else "exception"
    return ModbusRtuCodec(form, max_read=4) if vector.encoding == "rtu" else ModbusAsciiCodec(form, max_read=4)


def request_message(fields: dict[str, Any]) -> ReadRegisters | WriteRegister | Diagnostics:
    address = fields["address"]
    if fields["function"] == 3:
        return ReadRegisters(address, fields["register"], fields["count"])
    if fields["function"] == 8:
        return Diagnostics(address, fields["data"])
    return WriteRegister(address, fields["register"], fields["value"])


def reply_message(fields: dict[str, Any]) -> Any:
    address, function = fields["address"], fields["function"]
    if fields.get("error") or "exception" in fields:
        return ExceptionReply(address, function, fields.get("exception"))
    if function == 3:
        return RegisterValues(address, 3, tuple(fields["registers"]))
    if function == 8:
        return DiagnosticsReply(address, fields["data"])
    return WriteAck(address, function, fields["register"], fields["value"])


def names(vectors: list[Vector]) -> list[str]:
    return [each.id for each in vectors]


@pytest.mark.parametrize("vector", REQUESTS, ids=names(REQUESTS))
def test_a_request_vector_is_encoded_and_decoded(vector: Vector) -> None:
    codec, message = codec_for(vector), request_message(vector.fields)
    assert codec.decode_request(vector.data) == Complete(message, len(vector.data))
    assert codec.encode_request(message) == vector.data


@pytest.mark.parametrize("vector", REPLIES, ids=names(REPLIES))
def test_a_station_encodes_the_reply_of_a_vector(vector: Vector) -> None:
    """The misprinted reply encodes to its canonical bytes, which is what its fields say."""
    assert codec_for(vector).encode_reply(reply_message(vector.fields)) == (vector.canonical or vector.data)


@pytest.mark.parametrize("vector", ANSWERED, ids=names(ANSWERED))
def test_a_reply_vector_is_taken_for_the_reply_to_its_request(vector: Vector) -> None:
    asked = vector.request
    assert asked is not None
    verdict = codec_for(vector).decode_reply(request_message(asked.fields), vector.data)
    assert verdict == Complete(reply_message(vector.fields), len(vector.data))


def test_the_misprinted_reply_fails_its_crc_with_both_numbers() -> None:
    """VC660 §6.2 prints C3 for 13."""
    vector = next(each for each in VECTORS if each.id == "vc660-read-f00-response")
    with pytest.raises(ChecksumError) as caught:
        codec_for(vector).decode_reply(ReadRegisters(1, 0, 4), vector.data)
    assert (caught.value.found, caught.value.expected) == (0xA821, 0xF42C)
    assert vector.canonical is not None
    whole = codec_for(vector).decode_reply(ReadRegisters(1, 0, 4), vector.canonical)
    assert whole == Complete(RegisterValues(1, 3, (5000, 2, 5000, 0)), 13)


SHORT_ERRORS = [each for each in REPLIES if each.fields.get("error")]


@pytest.mark.parametrize("vector", SHORT_ERRORS, ids=names(SHORT_ERRORS))
def test_a_short_error_is_the_reply_to_any_request_of_its_function(vector: Vector) -> None:
    function = vector.fields["function"]
    asked = ReadRegisters(1, 101, 2) if function == 3 else WriteRegister(1, 101, 5)
    verdict = codec_for(vector).decode_reply(asked, vector.data)
    assert verdict == Complete(ExceptionReply(1, function, None), len(vector.data))


def exchanges(family: str, encoding: str) -> list[CodecExchange]:
    found = [each for each in load_vectors(family) if each.encoding == encoding]
    answered = {each.line["reply_to"]: each for each in found if "reply_to" in each.line and each.plain}
    made = []
    for vector in found:
        if vector.direction == "request":
            reply = answered.get(vector.id)
            message = None if reply is None else reply_message(reply.fields)
            received = b"" if reply is None else reply.data
            made.append(
                CodecExchange(
                    name=vector.id,
                    request=request_message(vector.fields),
                    sent=vector.data,
                    reply=message,
                    received=received,
                )
            )
        elif vector.fields.get("error"):
            asked = ReadRegisters(1, 101, 2) if vector.fields["function"] == 3 else WriteRegister(1, 101, 5)
            sent = codec_for(vector).encode_request(asked)
            made.append(
                CodecExchange(
                    name=vector.id,
                    request=asked,
                    sent=sent,
                    reply=reply_message(vector.fields),
                    received=vector.data,
                    is_normal_reply=False,
                )
            )
    return made


@pytest.mark.parametrize(("family", "encoding"), [("vc660", "rtu"), ("df800", "rtu"), ("df800", "ascii")])
def test_the_codec_kit_finds_no_fault_and_no_accepted_flip(family: str, encoding: str) -> None:
    """Whole, byte by byte, glued, noise, every single-bit flip, sizes, foreign exceptions."""
    made = exchanges(family, encoding)
    codec = codec_for(next(each for each in load_vectors(family) if each.encoding == encoding))
    report = check_codec(codec, made, garbage_frames=120)
    assert set(report.accepted_flips) == {each.name for each in made if each.received}
    assert not any(report.accepted_flips.values())


RTU = [each for each in (*REQUESTS, *ANSWERED) if each.encoding == "rtu"]
"""A CRC lets no 2 and no 3 flipped bits through; ASCII's LRC lets some."""


def believed(vector: Vector, flips: int) -> list[tuple[int, ...]]:
    codec, bits = codec_for(vector), 8 * len(vector.data)
    number = int.from_bytes(vector.data, "big")
    asked = None if vector.request is None else request_message(vector.request.fields)
    found = []
    for places in combinations(range(bits), flips):
        flipped = (number ^ sum(1 << place for place in places)).to_bytes(bits // 8, "big")
        try:
            verdict = codec.decode_request(flipped) if asked is None else codec.decode_reply(asked, flipped)
        except ProtocolError:
            continue
        if not isinstance(verdict, Incomplete):
            found.append(places)
    return found


@pytest.mark.parametrize("vector", RTU, ids=names(RTU))
def test_no_two_flipped_bits_of_an_rtu_vector_are_accepted(vector: Vector) -> None:
    assert believed(vector, 2) == []


@pytest.mark.parametrize("name", ["vc660-stop", "vc660-start-reply", "df800-start-rtu"])
def test_no_three_flipped_bits_of_a_command_are_accepted(name: str) -> None:
    assert believed(next(each for each in RTU if each.id == name), 3) == []


def test_only_a_write_of_a0xxh_to_0023h_awaits_silence_at_address_1() -> None:
    """The 5-byte error is decided by its request; 22 * 256 * 3 writes around the one case are tried."""
    codec, error = ModbusRtuCodec("short"), bytes.fromhex("01 06 00 23 A0")
    waiting = set()
    for register in range(0x15, 0x2B):
        for high in range(256):
            for value in (high << 8, high << 8 | 0x5A, high << 8 | 0xFF):
                verdict = codec.decode_reply(WriteRegister(1, register, value), error)
                if isinstance(verdict, CompleteIfSilent):
                    waiting.add((register, high))
                    assert verdict == CompleteIfSilent(ExceptionReply(1, 6, None), 5, 8)
                else:
                    assert verdict == Complete(ExceptionReply(1, 6, None), 5)
    assert waiting == {(0x23, 0xA0)}


@pytest.mark.parametrize("size", range(5, 8))
def test_an_error_that_may_be_an_echo_waits_for_the_rest_of_it(size: int) -> None:
    codec, asked = ModbusRtuCodec("short"), WriteRegister(1, 0x23, 0xA012)
    echo = codec.encode_request(asked)
    assert codec.decode_reply(asked, echo[:size]) == CompleteIfSilent(ExceptionReply(1, 6, None), 5, 8)
    assert codec.decode_reply(asked, echo) == Complete(WriteAck(1, 6, 0x23, 0xA012), 8)
    with pytest.raises(ChecksumError):
        codec.decode_reply(asked, echo[:5] + b"\xff\xff\xff")


def test_each_address_has_one_echo_that_begins_like_its_error() -> None:
    """Computed for all stations: the register's low byte and the value's high byte are the error's CRC."""
    codec = ModbusRtuCodec("short")
    for address in range(1, 248):
        error = codec.encode_reply(ExceptionReply(address, 6, None))
        register, value = error[3], error[4] << 8
        verdict = codec.decode_reply(WriteRegister(address, register, value), error)
        assert isinstance(verdict, CompleteIfSilent)
        assert codec.decode_reply(WriteRegister(address, register ^ 1, value), error) == Complete(
            ExceptionReply(address, 6, None), 5
        )
