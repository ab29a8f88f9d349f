"""What a C320 station hears and answers (T01), and nibble frames (T03)."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest
from hypothesis import given

from drivebus.errors import (
    ChecksumError,
    ProtocolError,
)
from drivebus.message import Effect, Incomplete
from drivebus.protocols import sifang
from drivebus.protocols.sifang import Operation, Reply, Response, State
from drivebus.protocols.sifang.frame import CONTROL, READ, WRITE
from protocols.sifangkit import (
    CODECS,
    ENCODINGS,
    FORMS,
    Encoding,
    accepted,
    addresses,
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
def test_t03_each_field_tells_how_it_is_written_or_the_others_do(
    state: int, item: int, data: int, packed_sum: bool, read: int, other: int | None
) -> None:
    frame = nibble_reply(state, item, data, packed_sum)
    found = accepted(sifang.ReadParameter(5, 2, item), frame, "hex", nibble=True)
    assert (found.state, found.item, found.data, found.other_data) == (state, item, read, other)


def test_t03_data_stay_packed_and_ambiguous_where_the_other_fields_disagree() -> None:
    body = bytes.fromhex("00 10 00 01 01 02 00 01 00 00 01 06")  # the address says packed, the state says nibbles
    frame = b"Z" + body + sum(body).to_bytes(4, "big") + b"\r"
    found = accepted(sifang.ReadParameter(16, 2, 1), frame, "hex", nibble=True)
    assert (found.state, found.data, found.other_data) == (State.ACCELERATING_FORWARD, 0x0106, 0x16)


@given(addresses, states, groups, items, words)
def test_t03_a_packed_frame_is_read_as_packed_whatever_its_data(
    address: int, state: State, group: int, item: int, data: int
) -> None:
    reply = Reply(address, Response.OK, state, group, item, data)
    frame = CODECS["hex"].encode_reply(reply)
    found = accepted(sifang.ReadParameter(address, group, item), frame, "hex", nibble=True)
    assert dataclasses.replace(found, other_data=None) == reply
    if found.other_data is not None:
        assert data & 0xF0F0 == 0
        assert data >> 8


def test_t03_527_volts_are_ambiguous_with_nibbles_and_plain_without() -> None:
    frame = CODECS["hex"].encode_reply(Reply(5, Response.OK, State.STOPPED, 0, 4, 527))
    assert accepted(sifang.ReadMonitor(5, 4), frame, "hex").other_data is None
    assert accepted(sifang.ReadMonitor(5, 4), frame, "hex", nibble=True).other_data == 0x2F


def answer(data: bytes, encoding: Encoding = "ascii") -> Reply | None:
    with pytest.raises(ProtocolError) as caught:
        CODECS[encoding].decode_request(data)
    return sifang.short_reply(caught.value)


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("kind", range(6))
@pytest.mark.parametrize("operation", list(Operation), ids=lambda operation: operation.name)
def test_t01_a_station_hears_the_operation_in_every_class(encoding: Encoding, kind: int, operation: Operation) -> None:
    form = FORMS[encoding]
    if kind == 4:
        frame = form.build(CONTROL, 7, kind, operation, 0)
    else:
        frame = form.build(
            *((WRITE, 7, kind, operation, 0, 0, 9) if kind in (3, 5) else (READ, 7, kind, operation, 0, 0))
        )
    heard = CODECS[encoding].decode_request(frame).message
    assert (heard.operation, heard.request.kind, heard.request.address) == (operation, kind, 7)
    moves = operation.name.startswith(("RUN", "JOG")) and "STOP" not in operation.name
    assert (sifang.effect(frame) is Effect.MOTION) is moves


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("kind", range(6, 16))
@pytest.mark.parametrize("layout", [(READ, (0, 0, 0)), (CONTROL, (0, 0)), (WRITE, (0, 0, 0, 0))])
def test_an_unknown_class_of_any_length_is_answered_with_code_8(encoding: Encoding, kind: int, layout: Any) -> None:
    shape, rest = layout
    frame = FORMS[encoding].build(shape, 7, kind, *rest)
    assert answer(frame, encoding) == Reply(7, Response.BAD_COMMAND)
    for end in range(len(frame)):
        assert isinstance(CODECS[encoding].decode_request(frame[:end]), Incomplete)


def test_an_unknown_class_that_fits_no_length_is_not_answered() -> None:
    assert answer(b"*0560000000000000000") is None


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_an_unknown_operation_is_answered_with_code_8(encoding: Encoding) -> None:
    known = {int(operation) for operation in Operation}
    for operation in set(range(256)) - known:
        assert answer(FORMS[encoding].build(CONTROL, 7, 4, operation, 0), encoding) == Reply(7, Response.BAD_COMMAND)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_a_group_or_item_that_the_class_does_not_have_is_answered_with_code_6(encoding: Encoding) -> None:
    assert answer(FORMS[encoding].build(READ, 7, 1, 0, 3, 0), encoding) == Reply(7, Response.BAD_CODE)
    assert answer(FORMS[encoding].build(READ, 7, 0, 0, 0, 9), encoding) == Reply(7, Response.BAD_CODE)


def test_an_illegal_character_is_answered_with_code_7_where_the_address_can_be_read() -> None:
    assert answer(b"*0710000x0188\r") == Reply(7, Response.BAD_ASCII)
    assert answer(b"*0x1000000188\r") is None


@pytest.mark.parametrize(
    "frame", [b"#071000000188\r", b"*071000000189\r", b"*071000000188\n", b"*2010000001 3\r", b"*3F100000019A\r"]
)
def test_a_wrong_head_sum_or_end_and_nobodys_address_are_not_answered(frame: bytes) -> None:
    assert answer(frame) is None


def test_an_error_that_is_no_requests_gets_no_short_reply() -> None:
    assert sifang.short_reply(ChecksumError("protocols.checksum", expected=1, found=2, address=7)) is None


def test_nobody_complains_about_a_broadcast() -> None:
    assert answer(FORMS["ascii"].build(CONTROL, 31, 4, 0x30, 0)) is None


@pytest.mark.parametrize(
    "reply",
    [
        Reply(31, Response.BAD_CODE),
        Reply(5, Response.OK, State.STOPPED, 0, 1),
        Reply(5, Response.OK, None, 0, 1, 2),
        Reply(5, Response.OK, State.STOPPED, 0, 256, 2),
        Reply(5, Response.OK, State.STOPPED, 0, info="40-022"),
        Reply(5, Response.OK, State.FAULT, 0, 1, 2),
    ],
    ids=repr,
)
def test_a_reply_that_is_no_reply_is_not_emitted(reply: Reply) -> None:
    with pytest.raises(ValueError, match=r"expected|full reply"):
        CODECS["ascii"].encode_reply(reply)
