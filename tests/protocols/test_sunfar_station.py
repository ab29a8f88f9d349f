"""Requests that a Sunfar station decodes and answers, and frames with one nibble a byte."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest
from hypothesis import given

from drivebus.errors import (
    ChecksumError,
    ProtocolError,
)
from drivebus.protocols import sunfar
from drivebus.protocols.codec import Effect, Incomplete
from drivebus.protocols.sunfar import SunfarOperation, SunfarReply, SunfarResponse, SunfarState
from drivebus.protocols.sunfar.frame import CONTROL_LAYOUT, READ_LAYOUT, WRITE_LAYOUT
from fixtures.sunfar_messages import (
    CODECS,
    ENCODINGS,
    FORMS,
    Encoding,
    addresses,
    decode_accepted,
    groups,
    items,
    states,
    words,
)


def nibble_reply(state: int, item: int, data: int, packed_sum: bool) -> bytes:
    """A reply as the manual misprints it."""
    digits = f"050{state:02X}2{item:02X}{data:04X}"
    body = bytes(int(digit, 16) for digit in digits)
    total = sum(body)
    seal = total.to_bytes(4, "big") if packed_sum else bytes(int(digit, 16) for digit in f"{total:04X}")
    return b"Z" + body + seal + b"\r"


@pytest.mark.parametrize(
    ("state", "item", "data", "packed_sum", "read", "other"),
    [
        (0x03, 0x01, 0x1234, True, 0x1234, None),  # first bytes say nibbles
        (0x11, 0x01, 0x0016, True, 0x0016, None),  # the state says nibbles
        (0x03, 0x1A, 0x0016, True, 0x0016, None),  # the item says nibbles
        (0x03, 0x0F, 0x0016, False, 0x0016, None),  # only the nibble sum fits
        (0x03, 0x01, 0x0016, True, 0x0106, 0x0016),  # nothing decides: packed, and said to be ambiguous
        (0x03, 0x01, 0x0006, True, 0x0006, None),  # both readings agree
    ],
)
def test_each_field_or_the_others_decide_how_it_is_written(
    state: int, item: int, data: int, packed_sum: bool, read: int, other: int | None
) -> None:
    frame = nibble_reply(state, item, data, packed_sum)
    found = decode_accepted(sunfar.SunfarReadParameter(5, 2, item), frame, "hex", nibble=True)
    assert (found.state, found.item, found.data, found.nibble_data) == (state, item, read, other)


def test_data_stay_packed_and_ambiguous_where_the_other_fields_disagree() -> None:
    body = bytes.fromhex("00 10 00 01 01 02 00 01 00 00 01 06")  # the address says packed, the state says nibbles
    frame = b"Z" + body + sum(body).to_bytes(4, "big") + b"\r"
    found = decode_accepted(sunfar.SunfarReadParameter(16, 2, 1), frame, "hex", nibble=True)
    assert (found.state, found.data, found.nibble_data) == (SunfarState.ACCELERATING_FORWARD, 0x0106, 0x16)


@given(addresses, states, groups, items, words)
def test_a_packed_frame_is_read_as_packed_whatever_its_data(
    address: int, state: SunfarState, group: int, item: int, data: int
) -> None:
    reply = SunfarReply(address=address, response=SunfarResponse.OK, state=state, group=group, item=item, data=data)
    frame = CODECS["hex"].encode_reply(reply)
    found = decode_accepted(sunfar.SunfarReadParameter(address, group, item), frame, "hex", nibble=True)
    assert dataclasses.replace(found, nibble_data=None) == reply
    if found.nibble_data is not None:
        assert data & 0xF0F0 == 0
        assert data >> 8


def test_527_volts_are_ambiguous_with_nibbles_and_plain_without() -> None:
    frame = CODECS["hex"].encode_reply(
        SunfarReply(address=5, response=SunfarResponse.OK, state=SunfarState.STOPPED, group=0, item=4, data=527)
    )
    assert decode_accepted(sunfar.ReadMonitor(5, 4), frame, "hex").nibble_data is None
    assert decode_accepted(sunfar.ReadMonitor(5, 4), frame, "hex", nibble=True).nibble_data == 0x2F


def answer(data: bytes, encoding: Encoding = "ascii") -> SunfarReply | None:
    with pytest.raises(ProtocolError) as caught:
        CODECS[encoding].decode_request(data)
    return sunfar.error_reply(caught.value)


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("kind", range(6))
@pytest.mark.parametrize("operation", list(SunfarOperation), ids=lambda operation: operation.name)
def test_a_station_decodes_the_operation_in_every_class(
    encoding: Encoding, kind: int, operation: SunfarOperation
) -> None:
    form = FORMS[encoding]
    if kind == 4:
        frame = form.build(CONTROL_LAYOUT, 7, kind, operation, 0)
    else:
        frame = form.build(
            *(
                (WRITE_LAYOUT, 7, kind, operation, 0, 0, 9)
                if kind in (3, 5)
                else (READ_LAYOUT, 7, kind, operation, 0, 0)
            )
        )
    received = CODECS[encoding].decode_request(frame).message
    assert (received.operation, received.request.frame_class, received.request.address) == (operation, kind, 7)
    moves = operation.name.startswith(("RUN", "JOG")) and "STOP" not in operation.name
    assert (sunfar.frame_effect(frame) is Effect.MOTION) is moves


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("kind", range(6, 16))
@pytest.mark.parametrize("layout", [(READ_LAYOUT, (0, 0, 0)), (CONTROL_LAYOUT, (0, 0)), (WRITE_LAYOUT, (0, 0, 0, 0))])
def test_an_unknown_class_of_any_length_is_answered_with_code_8(encoding: Encoding, kind: int, layout: Any) -> None:
    shape, rest = layout
    frame = FORMS[encoding].build(shape, 7, kind, *rest)
    assert answer(frame, encoding) == SunfarReply(address=7, response=SunfarResponse.BAD_COMMAND)
    for end in range(len(frame)):
        assert isinstance(CODECS[encoding].decode_request(frame[:end]), Incomplete)


def test_an_unknown_class_that_fits_no_length_is_not_answered() -> None:
    assert answer(b"*0560000000000000000") is None


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_an_unknown_operation_is_answered_with_code_8(encoding: Encoding) -> None:
    known = {int(operation) for operation in SunfarOperation}
    for operation in set(range(256)) - known:
        assert answer(FORMS[encoding].build(CONTROL_LAYOUT, 7, 4, operation, 0), encoding) == SunfarReply(
            address=7, response=SunfarResponse.BAD_COMMAND
        )


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_a_group_or_item_that_the_class_does_not_have_is_answered_with_code_6(encoding: Encoding) -> None:
    assert answer(FORMS[encoding].build(READ_LAYOUT, 7, 1, 0, 3, 0), encoding) == SunfarReply(
        address=7, response=SunfarResponse.BAD_CODE
    )
    assert answer(FORMS[encoding].build(READ_LAYOUT, 7, 0, 0, 0, 9), encoding) == SunfarReply(
        address=7, response=SunfarResponse.BAD_CODE
    )


def test_an_illegal_character_is_answered_with_code_7_where_the_address_can_be_read() -> None:
    assert answer(b"*0710000x0188\r") == SunfarReply(address=7, response=SunfarResponse.BAD_ASCII)
    assert answer(b"*0x1000000188\r") is None


@pytest.mark.parametrize(
    "frame", [b"#071000000188\r", b"*071000000189\r", b"*071000000188\n", b"*2010000001 3\r", b"*3F100000019A\r"]
)
def test_a_wrong_head_sum_or_end_and_a_foreign_address_are_not_answered(frame: bytes) -> None:
    assert answer(frame) is None


def test_an_error_that_is_no_requests_gets_no_short_reply() -> None:
    assert sunfar.error_reply(ChecksumError("protocols.checksum", expected=1, found=2, address=7)) is None


def test_no_station_sends_an_error_reply_to_a_broadcast() -> None:
    assert answer(FORMS["ascii"].build(CONTROL_LAYOUT, 31, 4, 0x30, 0)) is None


@pytest.mark.parametrize(
    "reply",
    [
        SunfarReply(address=31, response=SunfarResponse.BAD_CODE),
        SunfarReply(address=5, response=SunfarResponse.OK, state=SunfarState.STOPPED, group=0, item=1),
        SunfarReply(address=5, response=SunfarResponse.OK, state=None, group=0, item=1, data=2),
        SunfarReply(address=5, response=SunfarResponse.OK, state=SunfarState.STOPPED, group=0, item=256, data=2),
        SunfarReply(address=5, response=SunfarResponse.OK, state=SunfarState.STOPPED, group=0, info="40-022"),
        SunfarReply(address=5, response=SunfarResponse.OK, state=SunfarState.FAULT, group=0, item=1, data=2),
    ],
    ids=repr,
)
def test_a_reply_that_is_no_reply_is_not_emitted(reply: SunfarReply) -> None:
    with pytest.raises(ValueError, match=r"expected|full reply"):
        CODECS["ascii"].encode_reply(reply)
