"""The C320 protocol beyond its golden frames: what cannot be sent, what is not believed, who answers what."""

from __future__ import annotations

import dataclasses
from typing import Any, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

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
from drivebus.message import Complete, Effect, Incomplete
from drivebus.protocols import sifang
from drivebus.protocols.sifang import Operation, Reply, Response, SifangCodec, State
from drivebus.protocols.sifang.frame import CONTROL, READ, WRITE, AsciiForm, PackedForm

Encoding = Literal["ascii", "hex"]
ENCODINGS: tuple[Encoding, ...] = ("ascii", "hex")
CODECS = {encoding: SifangCodec(encoding) for encoding in ENCODINGS}
FORMS = {"ascii": AsciiForm(bytes(range(256))), "hex": PackedForm()}
STOPS = (Operation.STOP, Operation.JOG_STOP, Operation.EMERGENCY_STOP)

encodings = st.sampled_from(ENCODINGS)
addresses, groups, items, words = st.integers(0, 30), st.integers(0, 15), st.integers(0, 255), st.integers(0, 0xFFFF)
reads = st.one_of(
    st.builds(sifang.ReadIdentity, addresses, groups),
    st.builds(sifang.ReadMonitor, addresses, items),
    st.builds(sifang.ReadParameter, addresses, groups, items),
)
writes = st.builds(sifang.WriteParameter, st.integers(0, 31), groups, items, words, st.booleans())
with_frequency = st.sampled_from([operation for operation in Operation if operation.sets_frequency])
without = st.sampled_from([operation for operation in Operation if not operation.sets_frequency])
controls = st.builds(sifang.Control, st.integers(0, 31), with_frequency, words) | st.builds(
    sifang.Control, st.integers(0, 31), without
)
requests = st.one_of(reads, writes, controls)
states = st.sampled_from([state for state in State if state is not State.FAULT])


reads_one = sifang.ReadMonitor(5, 0)


def accepted(request: sifang.Request, data: bytes, encoding: Encoding = "ascii", **options: Any) -> Reply:
    verdict = SifangCodec(encoding, **options).decode_reply(request, data)
    assert isinstance(verdict, Complete)
    reply: Reply = verdict.message
    return reply


# -- what a host can send ------------------------------------------------------------------------------------------


@given(encodings, reads)
def test_t01_bytes_4_and_5_of_a_read_are_always_the_digits_00(encoding: Encoding, request: sifang.Request) -> None:
    frame = CODECS[encoding].encode_request(request)
    assert frame[4:6] == (b"00" if encoding == "ascii" else b"\x00\x00")
    assert sifang.effect(frame) is Effect.NONE


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_t01_no_read_that_there_is_carries_an_operation(encoding: Encoding) -> None:
    """Every address, group and item: 135,408 frames."""
    none = b"00" if encoding == "ascii" else b"\x00\x00"
    encode = CODECS[encoding].encode_request
    for address in range(31):
        assert all(encode(sifang.ReadIdentity(address, group))[4:6] == none for group in range(16))
        assert all(encode(sifang.ReadMonitor(address, item))[4:6] == none for item in range(256))
        for group in range(16):
            assert all(encode(sifang.ReadParameter(address, group, item))[4:6] == none for item in range(256))


@given(encodings, writes)
def test_t07_a_write_carries_no_operation(encoding: Encoding, request: sifang.WriteParameter) -> None:
    frame = CODECS[encoding].encode_request(request)
    assert frame[4:6] == (b"00" if encoding == "ascii" else b"\x00\x00")
    assert sifang.effect(frame) is Effect.SETTING


@pytest.mark.parametrize(
    "message", [sifang.ReadIdentity, sifang.ReadMonitor, sifang.ReadParameter, sifang.WriteParameter]
)
def test_t01_only_control_has_a_field_for_an_operation(message: Any) -> None:
    assert "operation" not in {field.name for field in dataclasses.fields(message)}
    assert "operation" in {field.name for field in dataclasses.fields(sifang.Control)}


@given(encodings, requests)
def test_a_station_hears_what_a_host_sends(encoding: Encoding, request: sifang.Request) -> None:
    frame = CODECS[encoding].encode_request(request)
    operation = request.operation if isinstance(request, sifang.Control) else Operation.NONE
    assert CODECS[encoding].decode_request(frame) == Complete(sifang.Heard(request, operation), len(frame))


@given(encodings, st.integers(0, 31), st.sampled_from(STOPS), st.integers())
def test_a_stop_is_never_refused_and_carries_0000(
    encoding: Encoding, address: int, operation: Operation, data: int
) -> None:
    frame = CODECS[encoding].encode_request(sifang.Control(address, operation, data))
    assert CODECS[encoding].decode_request(frame).message.request == sifang.Control(address, operation)
    assert sifang.effect(frame) is Effect.STOP


@pytest.mark.parametrize(
    "request_",
    [
        sifang.ReadMonitor(31, 0),
        sifang.ReadIdentity(31, 0),
        sifang.ReadParameter(31, 1, 2),
        sifang.ReadMonitor(32, 0),
        sifang.ReadMonitor(-1, 0),
        sifang.ReadMonitor(1, 256),
        sifang.ReadParameter(1, 16, 0),
        sifang.WriteParameter(1, 0, 0, 0x10000),
        sifang.Control(1, Operation.SET_FREQUENCY, 0x10000),
        sifang.Control(1, Operation.RUN_FORWARD, 1),
        sifang.Control(1, Operation.RESET_FAULT, 1),
        sifang.Control(1, 0x30),  # type: ignore[arg-type]
    ],
    ids=repr,
)
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_what_no_drive_can_answer_or_obey_is_not_emitted(encoding: Encoding, request_: sifang.Request) -> None:
    with pytest.raises(ValueError, match=r"expected|nobody answers|takes no data|not one of"):
        CODECS[encoding].encode_request(request_)


@given(encodings, requests)
def test_a_broadcast_expects_no_reply(encoding: Encoding, request: sifang.Request) -> None:
    codec = CODECS[encoding]
    assert codec.reply_size(request) == codec.largest_reply(request) == (0 if request.address == 31 else 18)
    assert codec.address_of(request) == request.address


def test_an_unknown_encoding_is_refused() -> None:
    with pytest.raises(ValueError, match="ascii or hex"):
        SifangCodec("rtu")  # type: ignore[arg-type]


# -- what a host believes ------------------------------------------------------------------------------------------


@given(encodings, addresses, st.sampled_from(Response), states, groups, items, words)
def test_every_reply_comes_back(
    encoding: Encoding, address: int, response: Response, state: State, group: int, item: int, data: int
) -> None:
    reply = Reply(address, response) if response.short else Reply(address, response, state, group, item, data)
    frame = CODECS[encoding].encode_reply(reply)
    assert len(frame) == (11 if response.short else 18)  # T06
    assert accepted(sifang.ReadParameter(address, group, item), frame, encoding) == reply


@given(encodings, addresses, groups, items, words)
def test_t05_every_fault_comes_back_with_its_code_and_no_item(
    encoding: Encoding, address: int, group: int, code: int, data: int
) -> None:
    reply = Reply(address, Response.OK, State.FAULT, group, None, data, fault_code=code)
    frame = CODECS[encoding].encode_reply(reply)
    assert accepted(sifang.ReadParameter(address, group, 99), frame, encoding) == reply


@given(encodings, addresses, groups, states, st.text("0123456789ABCDEF", min_size=6, max_size=6))
def test_every_identity_comes_back(encoding: Encoding, address: int, group: int, state: State, info: str) -> None:
    reply = Reply(address, Response.OK, state, group, info=info)
    frame = CODECS[encoding].encode_reply(reply)
    assert accepted(sifang.ReadIdentity(address, group), frame, encoding) == reply


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("code", [0x0C, 0x2F])
def test_t05_an_identity_in_a_fault_has_neither_the_digits_nor_a_fault_code(encoding: Encoding, code: int) -> None:
    """[OPEN] whether digits 7-8 are the code or the information: neither is believed."""
    frame = CODECS[encoding].encode_reply(Reply(3, Response.OK, State.FAULT, 0, data=0x0185, fault_code=code))
    found = accepted(sifang.ReadIdentity(3, 0), frame, encoding)
    assert (found.info, found.fault_code, found.item, found.state) == ("--0185", None, None, State.FAULT)


MONITOR = sifang.ReadMonitor(5, 0x0F)


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize(
    ("request_", "reply", "expected", "found"),
    [
        (MONITOR, Reply(5, Response.OK, State.STOPPED, 1, 0x0F, 7), 0, 1),
        (MONITOR, Reply(5, Response.OK, State.STOPPED, 0, 0x0E, 7), 0x0F, 0x0E),
        (sifang.ReadParameter(5, 2, 1), Reply(5, Response.OK, State.STOPPED, 0, 1, 7), 2, 0),
        (sifang.ReadParameter(5, 2, 1), Reply(5, Response.OK, State.STOPPED, 2, 2, 7), 1, 2),
        (sifang.ReadParameter(5, 2, 1), Reply(5, Response.OK, State.FAULT, 3, None, 7, fault_code=1), 2, 3),
        (sifang.ReadIdentity(5, 1), Reply(5, Response.OK, State.STOPPED, 0, info="400022"), 1, 0),
        (sifang.WriteParameter(5, 2, 1, 7), Reply(5, Response.OK, State.STOPPED, 2, 1, 8), 7, 8),
        (sifang.Control(5, Operation.STOP), Reply(5, Response.OK, State.STOPPED, 1, 0, 0), 0, 1),
    ],
    ids=lambda case: repr(case)[:40],
)
def test_a_field_that_the_drive_echoes_must_fit(
    encoding: Encoding, request_: sifang.Request, reply: Reply, expected: int, found: int
) -> None:
    with pytest.raises(EchoError) as caught:
        CODECS[encoding].decode_reply(request_, CODECS[encoding].encode_reply(reply))
    assert (caught.value.expected, caught.value.found) == (expected, found)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_f02_another_stations_whole_reply_can_be_dropped_by_its_size(encoding: Encoding) -> None:
    for reply, size in ((Reply(6, Response.OK, State.STOPPED, 0, 0x0F, 7), 18), (Reply(6, Response.BAD_CODE), 11)):
        with pytest.raises(AddressError) as caught:
            CODECS[encoding].decode_reply(MONITOR, CODECS[encoding].encode_reply(reply))
        assert (caught.value.expected, caught.value.found, caught.value.size) == (5, 6, size)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_only_enumerated_states_and_responses_are_believed(encoding: Encoding) -> None:
    form = FORMS[encoding]
    states = {int(state) for state in State}
    for state in range(256):
        frame = form.build(WRITE, 5, 0, state, 0, 0x0F, 7)
        if state in states:
            assert accepted(MONITOR, frame, encoding).state == state
        else:
            with pytest.raises(CodeError):
                CODECS[encoding].decode_reply(MONITOR, frame)
    for response in (5, *range(9, 16)):
        with pytest.raises(CodeError) as caught:
            CODECS[encoding].decode_reply(MONITOR, form.build(WRITE, 5, response, 3, 0, 0x0F, 7))
        assert caught.value.found == response


def test_a_hex_identity_has_digits_in_bytes_7_and_8_unless_the_drive_is_in_fault() -> None:
    frame = PackedForm().build(WRITE, 5, 0, State.STOPPED, 0, 0x25, 7)
    with pytest.raises(AlphabetError) as caught:
        CODECS["hex"].decode_reply(sifang.ReadIdentity(5, 0), frame)
    assert (caught.value.expected, caught.value.found, caught.value.params["position"]) == (0x0F, 0x25, 8)


def test_a_short_reply_with_a_state_is_none() -> None:
    with pytest.raises(CodeError) as caught:
        CODECS["ascii"].decode_reply(MONITOR, b"*0560300FE\r")
    assert (caught.value.expected, caught.value.found) == (0, 3)


def test_t06_the_end_mark_is_only_looked_for_where_the_length_puts_it() -> None:
    frame = CODECS["hex"].encode_reply(Reply(0x0D, Response.OK, State.STOPPED, 0xD, 0x0D, 0x2A5A))
    assert frame.count(b"\r") == 4
    assert accepted(sifang.ReadParameter(0x0D, 0xD, 0x0D), frame, "hex").data == 0x2A5A
    with pytest.raises(TerminatorError) as caught:
        CODECS["hex"].decode_reply(sifang.ReadParameter(0x0D, 0xD, 0x0D), frame[:-1] + b"\n")
    assert (caught.value.expected, caught.value.found) == (0x0D, 0x0A)


def test_the_other_encodings_head_is_not_accepted() -> None:
    for mine, other in (("ascii", "hex"), ("hex", "ascii")):
        with pytest.raises(HeaderError):
            CODECS[mine].decode_reply(MONITOR, CODECS[other].encode_reply(Reply(5, Response.BAD_CODE))[:1])


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize(
    ("expected_item", "item", "published"), [(4, 4, True), (4, 0, False), (None, 0, False), (0, 0, True)]
)
def test_the_data_of_a_control_reply_are_published_only_under_the_expected_item(
    encoding: Encoding, expected_item: int | None, item: int, published: bool
) -> None:
    request = sifang.Control(5, Operation.RUN_FORWARD_AT, 999, expected_item)
    frame = CODECS[encoding].encode_reply(Reply(5, Response.OK, State.ACCELERATING_FORWARD, 0, item, 540))
    found = accepted(request, frame, encoding)
    assert (found.state, found.response) == (State.ACCELERATING_FORWARD, Response.OK)
    assert (found.item, found.data) == ((item, 540) if published else (None, None))


def test_t04_a_control_reply_a_monitor_and_a_parameter_f0_are_the_same_bytes() -> None:
    """The shape can't tell them apart: that is why no command is confirmed by its own reply (ruling 1)."""
    frame = CODECS["ascii"].encode_reply(Reply(5, Response.OK, State.STOPPED, 0, 2, 7))
    asked: list[sifang.Request] = [
        sifang.Control(5, Operation.STOP, expected_item=2),
        sifang.ReadMonitor(5, 2),
        sifang.ReadParameter(5, 0, 2),
        sifang.WriteParameter(5, 0, 2, 7),
        sifang.WriteParameter(5, 0, 2, 7, save=True),
    ]
    assert len({accepted(request, frame) for request in asked}) == 1


@pytest.mark.parametrize("encoding", ENCODINGS)
@given(request=requests)
def test_t21_the_echo_of_ones_own_request_is_never_taken_for_success(
    encoding: Encoding, request: sifang.Request
) -> None:
    codec = CODECS[encoding]
    frame = codec.encode_request(request)
    try:
        verdict = codec.decode_reply(request, frame)
    except ProtocolError:
        return
    if isinstance(verdict, Complete):
        assert request == sifang.WriteParameter(request.address, request.group, request.item, 0)  # type: ignore[union-attr]
        assert (verdict.message.response, verdict.message.state) == (Response.PASSWORD, State.NOT_READY)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_t21_a_refused_write_is_believed_and_its_echo_is_not(encoding: Encoding) -> None:
    request = sifang.WriteParameter(5, 2, 1, 7)
    refused = Reply(5, Response.PASSWORD, State.NOT_READY, 2, 1, 0)
    assert accepted(request, CODECS[encoding].encode_reply(refused), encoding) == refused
    with pytest.raises(EchoError) as caught:
        CODECS[encoding].decode_reply(request, CODECS[encoding].encode_request(request))
    assert (caught.value.key, caught.value.found) == ("protocols.sifang.own_echo", 7)


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize(
    ("request_", "state", "data"),
    [
        (sifang.WriteParameter(5, 2, 1, 7, save=True), State.NOT_READY, 7),
        (sifang.WriteParameter(5, 2, 1, 7), State.STOPPED, 7),
        (sifang.WriteParameter(5, 2, 1, 0), State.NOT_READY, 0),
    ],
)
def test_t21_a_refusal_that_is_not_the_echo_is_believed(
    encoding: Encoding, request_: sifang.WriteParameter, state: State, data: int
) -> None:
    """A class-5 frame has no such echo, a state none, and a write of 0 is refused either way."""
    refused = Reply(5, Response.PASSWORD, state, 2, 1, data)
    assert accepted(request_, CODECS[encoding].encode_reply(refused), encoding) == refused


def test_a_hex_class_or_response_is_one_digit() -> None:
    for frame in (b"Z\x00\x05\x10", b"Z\x00\x05\x1f"):
        for decode in (CODECS["hex"].decode_request, lambda data: CODECS["hex"].decode_reply(reads_one, data)):
            with pytest.raises(AlphabetError) as caught:
                decode(frame)
            assert (caught.value.found, caught.value.params["position"]) == (frame[3], 3)


@pytest.mark.parametrize(
    ("frame", "english", "chinese"),
    [
        (b"#", "the frame begins with 23H, expected 2AH", "帧头为 23H，应为 2AH"),
        (b"*059", "response code 9 is not one of 0-4, 6-8", "从机响应码 9 不在 0-4, 6-8 之内"),
        (b"*0600300F00070266\r", "station 6 answered, station 5 was asked", "请求的是 5 号站，应答的是 6 号站"),
        (b"*0500300E00070264\r", "the reply names item 14, the request item 15", "应答的数据地址为 14，请求为 15"),
        (b"*0500300F0007028B\n", "byte 17: 0AH where the end mark 0DH belongs", "第 17 字节为 0AH，应为帧尾 0DH"),
    ],
)
def test_an_error_tells_what_happened_with_both_numbers(frame: bytes, english: str, chinese: str) -> None:
    with pytest.raises(ProtocolError) as caught:
        CODECS["ascii"].decode_reply(MONITOR, frame)
    assert (caught.value.text("en"), caught.value.text("zh")) == (english, chinese)


# -- nibble frames (T03) -------------------------------------------------------------------------------------------


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


# -- what a station answers ----------------------------------------------------------------------------------------


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


# -- effects -------------------------------------------------------------------------------------------------------


@given(encodings, controls)
def test_the_effect_of_a_command_is_read_from_its_bytes(encoding: Encoding, request: sifang.Control) -> None:
    frame = CODECS[encoding].encode_request(request)
    name, found = request.operation.name, sifang.effect(frame)
    if "STOP" in name:
        assert found is (Effect.SETTING if request.data and request.operation not in STOPS else Effect.STOP)
    elif name in ("SET_FREQUENCY", "RESET_FAULT"):
        assert found is (Effect.SETTING)
    else:
        assert found is (Effect.NONE if name == "NONE" else Effect.MOTION)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_a_stop_that_brings_a_frequency_or_writes_is_a_setting(encoding: Encoding) -> None:
    form = FORMS[encoding]
    assert sifang.effect(form.build(CONTROL, 1, 4, Operation.STOP, 999)) is Effect.SETTING
    assert sifang.effect(form.build(WRITE, 1, 3, Operation.STOP, 0, 0, 1)) is Effect.SETTING
    assert sifang.effect(form.build(CONTROL, 1, 4, Operation.NONE, 999)) is Effect.SETTING


@given(encodings, requests)
def test_what_is_not_one_whole_canonical_frame_counts_as_motion(encoding: Encoding, request: sifang.Request) -> None:
    frame = CODECS[encoding].encode_request(request)
    for wrong in (frame[:-1], frame + b"\r", b"", b"#" + frame[1:], frame[:-2] + bytes((frame[-2] ^ 1,)) + frame[-1:]):
        assert sifang.effect(wrong) is Effect.MOTION


def test_t02_a_tolerated_spelling_counts_as_motion() -> None:
    assert sifang.effect(b"*0010000:018:\r") is Effect.MOTION


# -- notation ------------------------------------------------------------------------------------------------------


@given(groups, items)
def test_a_parameter_has_the_manuals_notation(group: int, item: int) -> None:
    assert sifang.parse_parameter(sifang.parameter_name(group, item)) == (group, item)


@pytest.mark.parametrize(
    ("notation", "place"), [("F1.10", (1, 10)), ("F0.16", (0, 16)), ("FC.3", (10, 3)), ("fp.0", (15, 0))]
)
def test_the_sixteen_groups_have_these_letters(notation: str, place: tuple[int, int]) -> None:
    assert sifang.parse_parameter(notation) == place


@pytest.mark.parametrize("notation", ["", "F1", "F1.", "FA.1", "G1.1", "F1.256", "F1.1.1", "F1.-1", "F1.٣"])
def test_what_is_no_parameter_is_refused(notation: str) -> None:
    with pytest.raises(ValueError, match="expected a parameter"):
        sifang.parse_parameter(notation)


def test_a_monitor_index_is_binary_unless_the_drive_wants_it_as_printed() -> None:
    assert (sifang.monitor_item(15), sifang.monitor_item(15, "bcd")) == (0x0F, 0x15)
    assert (sifang.monitor_index(0x25), sifang.monitor_index(0x25, "bcd")) == (37, 25)
    assert sifang.monitor_index(0x0F, "bcd") is None
    with pytest.raises(ValueError, match=r"d\.100"):
        sifang.monitor_item(100, "bcd")
