"""Every field of a C320 frame at its limits, and every rejection with its key, the expected and the found value."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from drivebus.errors import (
    AddressError,
    AlphabetError,
    ChecksumError,
    CodeError,
    EchoError,
    HeaderError,
    ProtocolError,
    TerminatorError,
)
from drivebus.protocols import sunfar
from drivebus.protocols.checksum import STRICT_HEX_DIGITS
from drivebus.protocols.codec import Complete, Incomplete
from drivebus.protocols.sunfar import SunfarCodec, SunfarOperation, SunfarReply, SunfarResponse, SunfarState
from drivebus.protocols.sunfar.frame import (
    CONTROL_LAYOUT,
    IDENTITY_LAYOUT,
    READ_LAYOUT,
    SHORT_LAYOUT,
    WRITE_LAYOUT,
    AsciiFormat,
    FrameLayout,
    PackedFormat,
)
from drivebus.protocols.sunfar.messages import UnknownItemError, error_reply
from fixtures.sunfar_messages import CODECS, ENCODINGS, Encoding

BUILD: dict[str, Any] = {"ascii": AsciiFormat(STRICT_HEX_DIGITS), "hex": PackedFormat()}
both = pytest.mark.parametrize("encoding", ENCODINGS)

AT_THE_LIMIT: list[sunfar.SunfarRequest] = [
    *(sunfar.ReadIdentity(address, group) for address in (0, 30) for group in (0, 15)),
    *(sunfar.ReadMonitor(address, item) for address in (0, 30) for item in (0, 255)),
    *(sunfar.SunfarReadParameter(30, group, item) for group in (0, 15) for item in (0, 255)),
    *(sunfar.SunfarWriteParameter(address, 15, 255, 65535, save) for address in (0, 31) for save in (False, True)),
    *(sunfar.SunfarControl(address, SunfarOperation.SET_FREQUENCY, data) for address in (0, 31) for data in (0, 65535)),
]


@both
@pytest.mark.parametrize("asked", AT_THE_LIMIT, ids=str)
def test_the_last_valid_value_of_every_field_is_decoded_as_it_was_sent(encoding: Encoding, asked: Any) -> None:
    codec = CODECS[encoding]
    data = codec.encode_request(asked)
    verdict = codec.decode_request(data)
    assert isinstance(verdict, Complete) and (verdict.message.request, verdict.size) == (asked, len(data))
    assert codec.reply_size(asked) == codec.largest_reply(asked) == (0 if asked.address == 31 else 18)


SENTENCES: list[tuple[Any, str]] = [
    (sunfar.ReadMonitor(32, 0), "address 32: expected 0 to 31"),
    (sunfar.ReadMonitor(-1, 0), "address -1: expected 0 to 31"),
    (sunfar.ReadMonitor(31, 0), "address 31 is the broadcast address: no station answers a read"),
    (sunfar.ReadMonitor(1, 256), "item 256: expected 0 to 255"),
    (sunfar.ReadIdentity(1, 16), "group 16: expected 0 to 15"),
    (sunfar.SunfarReadParameter(1, -1, 0), "group -1: expected 0 to 15"),
    (sunfar.SunfarWriteParameter(1, 16, 0, 0), "group 16: expected 0 to 15"),
    (sunfar.SunfarWriteParameter(1, 0, 256, 0), "item 256: expected 0 to 255"),
    (sunfar.SunfarWriteParameter(1, 0, 0, 65536), "data 65536: expected 0 to 65535"),
    (sunfar.SunfarControl(1, SunfarOperation.SET_FREQUENCY, 65536), "data 65536: expected 0 to 65535"),
    (sunfar.SunfarControl(1, SunfarOperation.RUN_FORWARD, 1), "operation 01H takes no data, 1 given"),
    (
        SunfarReply(address=31, response=SunfarResponse.OK, state=SunfarState.STOPPED, group=0, item=0, data=0),
        "address 31: expected 0 to 30",
    ),
    (
        SunfarReply(address=1, response=SunfarResponse.OK, state=SunfarState.STOPPED, group=16, item=0, data=0),
        "group 16: expected 0 to 15",
    ),
    (
        SunfarReply(address=1, response=SunfarResponse.OK, state=SunfarState.STOPPED, group=0, item=256, data=0),
        "item 256: expected 0 to 255",
    ),
    (
        SunfarReply(address=1, response=SunfarResponse.OK, state=SunfarState.STOPPED, group=0, item=0, data=65536),
        "data 65536: expected 0 to 65535",
    ),
]


@both
@pytest.mark.parametrize(("message", "sentence"), SENTENCES, ids=str)
def test_a_field_out_of_range_is_named_with_its_limits(encoding: Encoding, message: Any, sentence: str) -> None:
    codec = CODECS[encoding]
    with pytest.raises(ValueError, match=f"^{sentence}$"):
        codec.encode_reply(message) if isinstance(message, SunfarReply) else codec.encode_request(message)


def spoiled(frame: bytes, place: int, byte: int) -> bytes:
    at = place % len(frame)
    return frame[:at] + bytes((byte,)) + frame[at + 1 :]


REJECTED_REQUESTS: list[tuple[FrameLayout, tuple[int, ...], type[ProtocolError], str, object, object]] = [
    (READ_LAYOUT, (32, 1, 0, 0, 0), AddressError, "protocols.sunfar.address_range", 31, 32),
    (READ_LAYOUT, (30, 1, 7, 0, 0), CodeError, "protocols.sunfar.operation", ("00-06", "10-16", "20", "21"), 7),
    (READ_LAYOUT, (30, 1, 0, 15, 0), UnknownItemError, "protocols.sunfar.unused.group", 0, 15),
    (READ_LAYOUT, (30, 0, 0, 0, 255), UnknownItemError, "protocols.sunfar.unused.item", 0, 255),
    (READ_LAYOUT, (30, 6, 0, 0, 0), CodeError, "protocols.sunfar.class", "0-5", 6),
    (CONTROL_LAYOUT, (30, 15, 0, 0), CodeError, "protocols.sunfar.class", "0-5", 15),
    (WRITE_LAYOUT, (30, 7, 0, 0, 0, 0), CodeError, "protocols.sunfar.class", "0-5", 7),
]


@both
@pytest.mark.parametrize(("layout", "values", "kind", "key", "expected", "found"), REJECTED_REQUESTS)
def test_a_station_rejects_with_key_and_both_numbers_and_answers_whom_it_can(
    encoding: Encoding,
    layout: FrameLayout,
    values: tuple[int, ...],
    kind: Any,
    key: str,
    expected: object,
    found: object,
) -> None:
    with pytest.raises(kind) as caught:
        CODECS[encoding].decode_request(BUILD[encoding].build(layout, *values))
    error = caught.value
    assert (error.key, error.expected, error.found) == (key, expected, found)
    if kind is not AddressError:
        answer = error_reply(error)
        assert answer is not None and answer.address == 30
        assert answer.response is (SunfarResponse.BAD_CODE if kind is UnknownItemError else SunfarResponse.BAD_COMMAND)


def test_only_stations_0_to_30_send_an_error_reply() -> None:
    for address, answers in ((0, True), (30, True), (31, False), (-1, False), (None, False), ("1", False)):
        found = error_reply(CodeError("protocols.sunfar.class", address=address))
        assert (found is not None) is answers
    assert error_reply(ChecksumError("protocols.checksum", address=1)) is None


@both
@pytest.mark.parametrize("layout", [READ_LAYOUT, CONTROL_LAYOUT, WRITE_LAYOUT])
def test_the_length_of_a_request_is_decided_by_its_class(encoding: Encoding, layout: FrameLayout) -> None:
    kind = {READ_LAYOUT: 2, CONTROL_LAYOUT: 4, WRITE_LAYOUT: 5}[layout]
    data = BUILD[encoding].build(layout, 1, kind, 0, *([0] * (len(layout.widths) - 3)))
    codec = CODECS[encoding]
    assert [codec.decode_request(data[:end]) for end in (0, 1, 3)] == [Incomplete(14)] * 3
    for end in range(4, len(data)):
        assert codec.decode_request(data[:end]) == Incomplete(len(data))


@both
def test_an_unknown_class_is_waited_for_length_by_length(encoding: Encoding) -> None:
    data = BUILD[encoding].build(WRITE_LAYOUT, 1, 9, 0, 0, 0, 0)
    codec = CODECS[encoding]
    needs = [codec.decode_request(data[:end]).need for end in range(len(data))]
    assert needs == [14] * 14 + [15] + [18] * 3
    with pytest.raises(ChecksumError) as caught:
        codec.decode_request(spoiled(data, -2, data[-2] ^ 1))
    assert (caught.value.key, caught.value.expected, caught.value.found) == (
        "protocols.sunfar.no_length",
        "0-5",
        data[3],
    )


READ = sunfar.SunfarReadParameter(5, 1, 10)
WRITE, SAVE = (sunfar.SunfarWriteParameter(5, 1, 2, 7, save=save) for save in (False, True))
STOP, STOP_ALL = (sunfar.SunfarControl(address, SunfarOperation.STOP) for address in (5, 31))
REPLY = SunfarReply(address=5, response=SunfarResponse.OK, state=SunfarState.STOPPED, group=1, item=10, data=0)
REJECTED_REPLIES: list[
    tuple[sunfar.SunfarRequest, FrameLayout, tuple[int, ...], type[ProtocolError], str, object, object, int]
] = [
    (READ, WRITE_LAYOUT, (6, 0, 3, 1, 10, 0), AddressError, "protocols.address", 5, 6, 18),
    (READ, SHORT_LAYOUT, (4, 6, 0), AddressError, "protocols.address", 5, 4, 11),
    (READ, WRITE_LAYOUT, (5, 5, 3, 1, 10, 0), CodeError, "protocols.sunfar.response", ("0-4", "6-8"), 5, 0),
    (READ, WRITE_LAYOUT, (5, 9, 3, 1, 10, 0), CodeError, "protocols.sunfar.response", ("0-4", "6-8"), 9, 0),
    (
        READ,
        WRITE_LAYOUT,
        (5, 0, 6, 1, 10, 0),
        CodeError,
        "protocols.sunfar.state",
        ("00-05", "11-16", "20", "21"),
        6,
        0,
    ),
    (READ, SHORT_LAYOUT, (5, 7, 1), CodeError, "protocols.sunfar.short_state", 0, 1, 0),
    (READ, WRITE_LAYOUT, (5, 0, 3, 2, 10, 0), EchoError, "protocols.sunfar.echo.group", 1, 2, 0),
    (READ, WRITE_LAYOUT, (5, 0, 3, 1, 11, 0), EchoError, "protocols.sunfar.echo.item", 10, 11, 0),
    (sunfar.ReadMonitor(5, 3), WRITE_LAYOUT, (5, 0, 3, 1, 3, 0), EchoError, "protocols.sunfar.echo.group", 0, 1, 0),
    (sunfar.ReadMonitor(5, 3), WRITE_LAYOUT, (5, 0, 3, 0, 4, 0), EchoError, "protocols.sunfar.echo.item", 3, 4, 0),
    (sunfar.ReadIdentity(5, 2), IDENTITY_LAYOUT, (6, 0, 3, 2, 0, 0, 0), AddressError, "protocols.address", 5, 6, 18),
    (
        sunfar.ReadIdentity(5, 2),
        IDENTITY_LAYOUT,
        (5, 0, 3, 1, 0, 0, 0),
        EchoError,
        "protocols.sunfar.echo.group",
        2,
        1,
        0,
    ),
    (STOP, WRITE_LAYOUT, (5, 0, 3, 1, 0, 0), EchoError, "protocols.sunfar.echo.group", 0, 1, 0),
    (WRITE, WRITE_LAYOUT, (5, 0, 3, 1, 2, 8), EchoError, "protocols.sunfar.echo.data", 7, 8, 0),
    (WRITE, WRITE_LAYOUT, (5, 3, 0, 1, 2, 7), EchoError, "protocols.sunfar.own_echo", 0, 7, 0),
    (SAVE, WRITE_LAYOUT, (5, 3, 0, 1, 2, 7), EchoError, "protocols.sunfar.refused_data", 0, 7, 0),
    (WRITE, WRITE_LAYOUT, (5, 3, 3, 1, 2, 7), EchoError, "protocols.sunfar.refused_data", 0, 7, 0),
    (WRITE, WRITE_LAYOUT, (5, 2, 0, 1, 2, 7), EchoError, "protocols.sunfar.refused_data", 0, 7, 0),
    (WRITE, WRITE_LAYOUT, (5, 3, 0, 1, 2, 8), EchoError, "protocols.sunfar.refused_data", 0, 8, 0),
    (STOP_ALL, WRITE_LAYOUT, (5, 0, 3, 0, 0, 0), AddressError, "protocols.sunfar.broadcast_answered", 30, 5, 0),
]


@both
@pytest.mark.parametrize(("sent", "layout", "values", "kind", "key", "expected", "found", "size"), REJECTED_REPLIES)
def test_a_host_rejects_with_key_and_both_numbers(
    encoding: Encoding,
    sent: Any,
    layout: FrameLayout,
    values: tuple[int, ...],
    kind: Any,
    key: str,
    expected: object,
    found: object,
    size: int,
) -> None:
    data = BUILD[encoding].build(layout, *values)
    with pytest.raises(kind) as caught:
        CODECS[encoding].decode_reply(sent, data + b"\x00")
    error = caught.value
    assert (error.key, error.expected, error.found, error.size) == (key, expected, found, size)


@both
def test_a_rejection_without_data_is_a_reply_whatever_its_code(encoding: Encoding) -> None:
    codec, sent = CODECS[encoding], WRITE
    for response in (
        SunfarResponse.OUT_OF_RANGE,
        SunfarResponse.RUNNING,
        SunfarResponse.PASSWORD,
        SunfarResponse.RESERVED,
    ):
        reply = SunfarReply(address=5, response=response, state=SunfarState.STOPPED, group=1, item=2, data=0)
        assert codec.decode_reply(sent, codec.encode_reply(reply)) == Complete(reply, 18)
    for response in (SunfarResponse.BAD_CODE, SunfarResponse.BAD_ASCII, SunfarResponse.BAD_COMMAND):
        reply = SunfarReply(address=5, response=response)
        assert codec.decode_reply(sent, codec.encode_reply(reply)) == Complete(reply, 11)


@both
def test_the_length_of_a_reply_is_decided_by_its_fourth_byte(encoding: Encoding) -> None:
    codec = CODECS[encoding]
    full = codec.encode_reply(REPLY)
    short = codec.encode_reply(SunfarReply(address=5, response=SunfarResponse.BAD_CODE))
    assert [codec.decode_reply(READ, full[:end]).need for end in range(18)] == [11] * 4 + [18] * 14
    assert [codec.decode_reply(READ, short[:end]).need for end in range(11)] == [11] * 11


@both
def test_head_sum_and_end_mark_are_rejected_with_both_numbers(encoding: Encoding) -> None:
    codec = CODECS[encoding]
    head = {"ascii": 0x2A, "hex": 0x5A}[encoding]
    full = codec.encode_reply(REPLY)
    total = sum(full[1:-5])
    other = (b"%04X" % (total ^ 1)) if encoding == "ascii" else (total ^ 1).to_bytes(4, "big")
    for data, kind, key, expected, found in (
        (b"\x00", HeaderError, "protocols.header", head, 0),
        (spoiled(full, -1, 0x0A), TerminatorError, "protocols.terminator", 0x0D, 0x0A),
        (full[:-5] + other + b"\r", ChecksumError, "protocols.checksum", total, total ^ 1),
    ):
        with pytest.raises(kind) as caught:
            codec.decode_reply(READ, data)
        assert (caught.value.key, caught.value.expected, caught.value.found) == (key, expected, found)
        if kind is TerminatorError:
            assert caught.value.params["position"] == 17


@pytest.mark.parametrize("place", [1, 2, 4, 9, 13, 16])
def test_the_place_of_a_byte_that_is_no_ascii_digit_is_reported(place: int) -> None:
    full = CODECS["ascii"].encode_reply(REPLY)
    with pytest.raises(AlphabetError) as caught:
        CODECS["ascii"].decode_reply(READ, spoiled(full, place, ord("g")))
    assert (caught.value.found, caught.value.params["position"]) == (ord("g"), place)
    with pytest.raises(AlphabetError) as caught:
        CODECS["ascii"].decode_reply(READ, spoiled(full, 3, ord("g")))
    assert caught.value.params["position"] == 3


@pytest.mark.parametrize(("place", "byte"), [(1, 1), (4, 0x10), (6, 0x10), (7, 1), (9, 1), (10, 255)])
def test_the_place_of_a_bit_that_a_packed_field_leaves_0_is_reported(place: int, byte: int) -> None:
    full = CODECS["hex"].encode_reply(REPLY)
    with pytest.raises(AlphabetError) as caught:
        CODECS["hex"].decode_reply(READ, spoiled(full, place, byte))
    assert (caught.value.key, caught.value.expected) == ("protocols.sunfar.stray", 0)
    assert (caught.value.found, caught.value.params["position"]) == (byte, place)
    with pytest.raises(AlphabetError) as caught:
        CODECS["hex"].decode_reply(READ, spoiled(full, 3, 0x10))
    assert (caught.value.key, caught.value.expected, caught.value.found) == ("protocols.sunfar.digit", 15, 16)
    assert caught.value.params["position"] == 3


def test_a_monitor_is_requested_in_binary_or_as_printed() -> None:
    for index, coding, item in (
        (0, "binary", 0),
        (255, "binary", 255),
        (0, "bcd", 0),
        (99, "bcd", 0x99),
        (15, "bcd", 0x15),
    ):
        assert sunfar.monitor_item(index, coding) == item  # type: ignore[arg-type]
        assert sunfar.monitor_index(item, coding) == index  # type: ignore[arg-type]
    for index, coding, limit in ((256, "binary", 255), (-1, "binary", 255), (100, "bcd", 99), (-1, "bcd", 99)):
        with pytest.raises(ValueError, match=f"^monitor d.{index}: expected d.0 to d.{limit}$"):
            sunfar.monitor_item(index, coding)  # type: ignore[arg-type]
    assert sunfar.monitor_index(0x1A, "bcd") is None


def test_the_enumerated_values_are_those_of_the_manual() -> None:
    """2.4.4 to 2.4.6: one moved number and a stop is a run."""
    assert [int(operation) for operation in SunfarOperation] == [*range(7), *range(0x10, 0x17), 0x20, 0x21]
    assert [int(state) for state in SunfarState] == [*range(6), *range(0x11, 0x17), 0x20, 0x21]
    assert [int(response) for response in SunfarResponse] == [0, 1, 2, 3, 4, 6, 7, 8]
    assert (SunfarOperation.STOP, SunfarOperation.RUN_FORWARD) == (3, 1)
    assert (SunfarOperation.EMERGENCY_STOP, SunfarOperation.RESET_FAULT) == (0x21, 0x20)
    assert [operation for operation in SunfarOperation if operation.sets_frequency] == list(range(0x10, 0x17))
    assert [response for response in SunfarResponse if response.is_short] == [6, 7, 8]
    assert sunfar.BROADCAST == 31


def test_an_encoding_is_one_of_two() -> None:
    for encoding in ("ASCII", "", "rtu"):
        with pytest.raises(ValueError, match="expected ascii or hex"):
            SunfarCodec(encoding)  # type: ignore[arg-type]


def test_a_codec_names_its_family_and_encoding() -> None:
    for encoding in ENCODINGS:
        codec = SunfarCodec(encoding)
        assert (codec.family, codec.encoding, codec.broadcast_address) == ("sunfar", encoding, 31)
        assert (codec.digits, codec.nibble) == ("strict", False)


@pytest.mark.parametrize("place", range(-5, -1))
def test_every_byte_of_a_packed_sum_counts_also_where_nibbles_are_read(place: int) -> None:
    codec = SunfarCodec("hex", nibble=True)
    full = codec.encode_reply(REPLY)
    assert codec.decode_reply(READ, full) == Complete(REPLY, 18)
    with pytest.raises(ProtocolError):
        codec.decode_reply(READ, spoiled(full, place, full[place] ^ 1))


def test_a_one_byte_field_is_one_digit_also_where_nibbles_are_read() -> None:
    body = bytes((0, 5, 0, 0, 3, 0x10, 0, 10, 0, 0, 0, 0))
    frame = b"Z" + body + sum(body).to_bytes(4, "big") + b"\r"
    with pytest.raises(AlphabetError) as caught:
        SunfarCodec("hex", nibble=True).decode_reply(READ, frame)
    assert (caught.value.key, caught.value.expected, caught.value.found) == ("protocols.sunfar.digit", 15, 16)
    assert caught.value.params["position"] == 6


@both
def test_an_identity_in_a_fault_is_sent_with_the_fault_code_in_its_place(encoding: Encoding) -> None:
    reply = SunfarReply(
        address=5, response=SunfarResponse.OK, state=SunfarState.FAULT, group=2, fault_code=0x1F, info="--ABCD"
    )
    data = CODECS[encoding].encode_reply(reply)
    assert data == BUILD[encoding].build(WRITE_LAYOUT, 5, 0, 0x20, 2, 0x1F, 0xABCD)
    plain = SunfarReply(address=5, response=SunfarResponse.OK, state=SunfarState.STOPPED, group=2, info="F0ABCD")
    assert CODECS[encoding].encode_reply(plain) == BUILD[encoding].build(IDENTITY_LAYOUT, 5, 0, 3, 2, 15, 0, 0xABCD)


@both
@pytest.mark.parametrize("info", ["12345", "1234567", "12345x", "12345g", "12345a", ""])
def test_an_identity_has_six_digits(encoding: Encoding, info: str) -> None:
    with pytest.raises(ValueError, match=f"^info '{info}': expected six digits$"):
        CODECS[encoding].encode_reply(
            SunfarReply(address=5, response=SunfarResponse.OK, state=SunfarState.STOPPED, group=2, info=info)
        )


@both
def test_a_full_reply_needs_all_its_fields(encoding: Encoding) -> None:
    no_group, no_data = (
        "a full reply has a state and a group",
        "a full reply has data and an item, or in a fault its code",
    )
    for change, sentence in (
        ({"group": None}, no_group),
        ({"state": None}, no_group),
        ({"item": None}, no_data),
        ({"data": None}, no_data),
        ({"state": SunfarState.FAULT, "item": 7}, no_data),
    ):
        with pytest.raises(ValueError, match=f"^{sentence}$"):
            CODECS[encoding].encode_reply(replace(REPLY, **change))


@pytest.mark.parametrize(("place", "address"), [(1, None), (2, None), (5, 5), (6, 5)])
def test_a_station_complains_of_a_bad_digit_in_its_own_name_or_not_at_all(place: int, address: int | None) -> None:
    data = CODECS["ascii"].encode_request(READ)
    with pytest.raises(AlphabetError) as caught:
        CODECS["ascii"].decode_request(spoiled(data, place, ord("g")))
    assert (caught.value.params["position"], caught.value.params["address"]) == (place, address)
