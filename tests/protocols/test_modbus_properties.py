"""Any request, any reply, any bytes: host and station understand each other and nothing else gets through."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivebus.errors import LengthError, ProtocolError
from drivebus.protocols.codec import Complete, DecodeResult, Incomplete
from drivebus.protocols.modbus import (
    BitValues,
    Diagnostics,
    DiagnosticsReply,
    ExceptionReply,
    IllegalRequest,
    ModbusAsciiCodec,
    ModbusRequest,
    ModbusRtuCodec,
    ReadBits,
    ReadRegisters,
    RegisterValues,
    WriteAck,
    WriteBit,
    WriteBits,
    WriteRegister,
    WriteRegisters,
    registers_written,
)

CODECS = [ModbusRtuCodec(), ModbusAsciiCodec(), ModbusRtuCodec("short"), ModbusAsciiCodec("short")]
every_codec = pytest.mark.parametrize("codec", CODECS, ids=["rtu", "ascii", "rtu-short", "ascii-short"])
Codec = ModbusRtuCodec | ModbusAsciiCodec
quick = settings(max_examples=60, derandomize=True)

station = st.integers(1, 247)
word = st.integers(0, 0xFFFF)
words = st.lists(word, min_size=1, max_size=20).map(tuple)
bits = st.lists(st.booleans(), min_size=1, max_size=40).map(tuple)
low = st.integers(0, 0xF000)
request_strategy: st.SearchStrategy[Any] = st.one_of(
    st.builds(ReadRegisters, station, low, st.integers(1, 125), st.sampled_from((3, 4))),
    st.builds(ReadBits, station, low, st.integers(1, 2000), st.sampled_from((1, 2))),
    st.builds(WriteRegister, station, word, word),
    st.builds(WriteRegisters, station, low, words),
    st.builds(WriteBit, station, word, st.booleans()),
    st.builds(WriteBits, station, low, bits),
    st.builds(Diagnostics, station, word),
)


def answer_to(request: ModbusRequest, draw: Any) -> Any:
    """A reply that a station may give."""
    address = request.address
    match request:
        case ReadRegisters(count=count, function=function):
            return RegisterValues(address, function, tuple(draw(st.lists(word, min_size=count, max_size=count))))
        case ReadBits(count=count, function=function):
            number = draw(st.integers(0, 2**count - 1))
            return BitValues(address, function, tuple(bool(number >> place & 1) for place in range(count)))
        case WriteBit(register=register, value=value):
            return WriteAck(address, 5, register, 0xFF00 if value else 0)
        case WriteRegister(register=register, value=value):
            return WriteAck(address, 6, register, value)
        case WriteRegisters(register=register, values=values) | WriteBits(register=register, values=values):
            return WriteAck(address, request.function, register, len(values))
        case Diagnostics(data=data):
            return DiagnosticsReply(address, data)


@every_codec
@quick
@given(request_strategy)
def test_a_station_decodes_what_the_master_sends(codec: Codec, request: Any) -> None:
    sent = codec.encode_request(request)
    assert codec.decode_request(sent) == Complete(request, len(sent))
    if not isinstance(request, WriteRegister | WriteRegisters | WriteBit | WriteBits):
        assert registers_written(sent, codec.encoding) == ()


@every_codec
@quick
@given(st.data(), request_strategy)
def test_the_master_reads_what_the_station_answers_in_pieces_or_whole(
    codec: Codec, data: st.DataObject, request: Any
) -> None:
    reply = answer_to(request, data.draw)
    received = codec.encode_reply(reply)
    assert codec.decode_reply(request, received) == Complete(reply, len(received))
    assert codec.reply_size(request) == len(received)
    cut = data.draw(st.integers(0, len(received) - 1))
    assert not isinstance(codec.decode_reply(request, received[:cut]), Complete)


@every_codec
@quick
@given(st.data(), request_strategy)
def test_a_reply_to_another_request_is_accepted_only_where_both_are_answered_alike(
    codec: Codec, data: st.DataObject, request: Any
) -> None:
    """A reply to function 03 carries no register; every field that a reply carries is compared."""
    other = data.draw(request_strategy)
    received = codec.encode_reply(answer_to(other, data.draw))
    try:
        verdict = codec.decode_reply(request, received)
    except ProtocolError:
        return
    if isinstance(verdict, Complete) and not isinstance(verdict.message, ExceptionReply):
        assert codec.encode_reply(verdict.message) == received[: verdict.size]
        assert (request.address, request.function) == (other.address, other.function)
        assert codec.reply_size(request) == codec.reply_size(other)


def fed_by_need(codec: Codec, request: Any, data: bytes) -> object:
    """The first verdict beyond Incomplete when bytes come one by one and the codec is asked when it wants to be."""
    need = 0
    for end in range(len(data) + 1):
        if end < need:
            continue
        outcome = outcome_of(codec, request, data[:end])
        if not isinstance(outcome, Incomplete):
            return outcome
        need = outcome.need
        assert need > end
    return "waits"


def outcome_of(codec: Codec, request: Any, data: bytes) -> DecodeResult | tuple[object, ...]:
    try:
        return codec.decode_request(data) if request is None else codec.decode_reply(request, data)
    except ProtocolError as error:
        return type(error), error.key, error.expected, error.found, error.size


garbage = st.one_of(
    st.binary(max_size=80),
    st.text("0123456789ABCDEFabcdef:\r\n *", max_size=80).map(lambda text: b":" + text.encode()),
    st.binary(max_size=20).map(lambda data: b"\x01\x03" + data),
    st.binary(max_size=20).map(lambda data: b"\x01\x06\x00" + data),
)


@every_codec
@settings(max_examples=300, derandomize=True)
@given(data=garbage, request=st.one_of(st.none(), request_strategy))
def test_garbage_raises_protocol_errors_only_whole_and_byte_by_byte_alike(
    codec: Codec, data: bytes, request: Any
) -> None:
    whole = outcome_of(codec, request, data)
    stepped = fed_by_need(codec, request, data)
    assert stepped == whole or (isinstance(whole, Incomplete) and stepped == "waits")


@every_codec
@quick
@given(st.integers(1, 127), st.binary(max_size=20), station)
def test_any_function_gets_an_answer_or_an_exception(codec: Codec, function: int, body: bytes, address: int) -> None:
    """A station can always say no: IllegalRequest names its code, and that reply can be encoded."""
    from drivebus.protocols.modbus.ascii import build_frame as ascii_frame
    from drivebus.protocols.modbus.rtu import build_frame as rtu_frame

    octets = bytes((address, function)) + body
    data = rtu_frame(octets) if codec.encoding == "rtu" else ascii_frame(octets)
    try:
        codec.decode_request(data)
    except IllegalRequest as error:
        assert codec.encode_reply(ExceptionReply(error.address, error.function, error.code))
    except ProtocolError as error:
        assert function in (1, 2, 3, 4, 5, 6, 8, 15, 16), error


@every_codec
def test_a_request_without_an_end_is_rejected_alike_however_much_follows(codec: Codec) -> None:
    """The length of an unknown function is not known; the error counts the bytes that a frame may have."""
    head, largest = (b"\x01\x63", 256) if codec.encoding == "rtu" else (b":0163", 513)
    refusals = {outcome_of(codec, None, (head + b"0" * 600)[:size]) for size in (largest, largest + 1, 600)}
    assert refusals == {(LengthError, "modbus.too_long", largest, largest, 0)}
