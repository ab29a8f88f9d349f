"""Validation of Sunfar replies: echoed fields, enumerated values, lengths, and the echo of an own write."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivebus.errors import (
    AddressError,
    AlphabetError,
    CodeError,
    EchoError,
    HeaderError,
    ProtocolError,
    TerminatorError,
)
from drivebus.protocols import sunfar
from drivebus.protocols.codec import Complete
from drivebus.protocols.sunfar import SunfarOperation, SunfarReply, SunfarResponse, SunfarState
from drivebus.protocols.sunfar.frame import SHORT_LAYOUT, WRITE_LAYOUT, PackedFormat
from fixtures.sunfar_messages import (
    CODECS,
    ENCODINGS,
    FORMS,
    Encoding,
    addresses,
    decode_accepted,
    encodings,
    groups,
    items,
    read_monitor,
    requests,
    states,
    words,
)


@given(encodings, addresses, st.sampled_from(SunfarResponse), states, groups, items, words)
def test_every_reply_comes_back(
    encoding: Encoding, address: int, response: SunfarResponse, state: SunfarState, group: int, item: int, data: int
) -> None:
    reply = (
        SunfarReply(address=address, response=response)
        if response.is_short
        else SunfarReply(address=address, response=response, state=state, group=group, item=item, data=data)
    )
    frame = CODECS[encoding].encode_reply(reply)
    assert len(frame) == (11 if response.is_short else 18)
    assert decode_accepted(sunfar.SunfarReadParameter(address, group, item), frame, encoding) == reply


@given(encodings, addresses, groups, items, words)
def test_every_fault_comes_back_with_its_code_and_no_item(
    encoding: Encoding, address: int, group: int, code: int, data: int
) -> None:
    reply = SunfarReply(
        address=address,
        response=SunfarResponse.OK,
        state=SunfarState.FAULT,
        group=group,
        item=None,
        data=data,
        fault_code=code,
    )
    frame = CODECS[encoding].encode_reply(reply)
    assert decode_accepted(sunfar.SunfarReadParameter(address, group, 99), frame, encoding) == reply


@given(encodings, addresses, groups, states, st.text("0123456789ABCDEF", min_size=6, max_size=6))
def test_every_identity_comes_back(encoding: Encoding, address: int, group: int, state: SunfarState, info: str) -> None:
    reply = SunfarReply(address=address, response=SunfarResponse.OK, state=state, group=group, info=info)
    frame = CODECS[encoding].encode_reply(reply)
    assert decode_accepted(sunfar.ReadIdentity(address, group), frame, encoding) == reply


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("code", [0x0C, 0x2F])
def test_an_identity_in_a_fault_has_neither_the_digits_nor_a_fault_code(encoding: Encoding, code: int) -> None:
    """[OPEN] whether digits 7-8 are the code or the information: neither is believed."""
    frame = CODECS[encoding].encode_reply(
        SunfarReply(
            address=3, response=SunfarResponse.OK, state=SunfarState.FAULT, group=0, data=0x0185, fault_code=code
        )
    )
    found = decode_accepted(sunfar.ReadIdentity(3, 0), frame, encoding)
    assert (found.info, found.fault_code, found.item, found.state) == ("--0185", None, None, SunfarState.FAULT)


MONITOR = sunfar.ReadMonitor(5, 0x0F)


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize(
    ("request_", "reply", "expected", "found"),
    [
        (
            MONITOR,
            SunfarReply(address=5, response=SunfarResponse.OK, state=SunfarState.STOPPED, group=1, item=0x0F, data=7),
            0,
            1,
        ),
        (
            MONITOR,
            SunfarReply(address=5, response=SunfarResponse.OK, state=SunfarState.STOPPED, group=0, item=0x0E, data=7),
            0x0F,
            0x0E,
        ),
        (
            sunfar.SunfarReadParameter(5, 2, 1),
            SunfarReply(address=5, response=SunfarResponse.OK, state=SunfarState.STOPPED, group=0, item=1, data=7),
            2,
            0,
        ),
        (
            sunfar.SunfarReadParameter(5, 2, 1),
            SunfarReply(address=5, response=SunfarResponse.OK, state=SunfarState.STOPPED, group=2, item=2, data=7),
            1,
            2,
        ),
        (
            sunfar.SunfarReadParameter(5, 2, 1),
            SunfarReply(
                address=5, response=SunfarResponse.OK, state=SunfarState.FAULT, group=3, item=None, data=7, fault_code=1
            ),
            2,
            3,
        ),
        (
            sunfar.ReadIdentity(5, 1),
            SunfarReply(address=5, response=SunfarResponse.OK, state=SunfarState.STOPPED, group=0, info="400022"),
            1,
            0,
        ),
        (
            sunfar.SunfarWriteParameter(5, 2, 1, 7),
            SunfarReply(address=5, response=SunfarResponse.OK, state=SunfarState.STOPPED, group=2, item=1, data=8),
            7,
            8,
        ),
        (
            sunfar.SunfarControl(5, SunfarOperation.STOP),
            SunfarReply(address=5, response=SunfarResponse.OK, state=SunfarState.STOPPED, group=1, item=0, data=0),
            0,
            1,
        ),
    ],
    ids=lambda case: repr(case)[:40],
)
def test_a_field_that_the_drive_echoes_must_fit(
    encoding: Encoding, request_: sunfar.SunfarRequest, reply: SunfarReply, expected: int, found: int
) -> None:
    with pytest.raises(EchoError) as caught:
        CODECS[encoding].decode_reply(request_, CODECS[encoding].encode_reply(reply))
    assert (caught.value.expected, caught.value.found) == (expected, found)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_another_stations_whole_reply_can_be_dropped_by_its_size(encoding: Encoding) -> None:
    for reply, size in (
        (SunfarReply(address=6, response=SunfarResponse.OK, state=SunfarState.STOPPED, group=0, item=0x0F, data=7), 18),
        (SunfarReply(address=6, response=SunfarResponse.BAD_CODE), 11),
    ):
        with pytest.raises(AddressError) as caught:
            CODECS[encoding].decode_reply(MONITOR, CODECS[encoding].encode_reply(reply))
        assert (caught.value.expected, caught.value.found, caught.value.size) == (5, 6, size)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_no_station_answers_a_broadcast(encoding: Encoding) -> None:
    form, stop = FORMS[encoding], sunfar.SunfarControl(sunfar.BROADCAST, SunfarOperation.STOP)
    for frame in (
        form.build(WRITE_LAYOUT, 31, 0, SunfarState.STOPPED, 0, 0, 0),
        form.build(SHORT_LAYOUT, 31, SunfarResponse.BAD_CODE, 0),
    ):
        with pytest.raises(AddressError) as caught:
            CODECS[encoding].decode_reply(stop, frame)
        assert caught.value.found == sunfar.BROADCAST


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_only_enumerated_states_and_responses_are_accepted(encoding: Encoding) -> None:
    form = FORMS[encoding]
    states = {int(state) for state in SunfarState}
    for state in range(256):
        frame = form.build(WRITE_LAYOUT, 5, 0, state, 0, 0x0F, 7)
        if state in states:
            assert decode_accepted(MONITOR, frame, encoding).state == state
        else:
            with pytest.raises(CodeError):
                CODECS[encoding].decode_reply(MONITOR, frame)
    for response in (5, *range(9, 16)):
        with pytest.raises(CodeError) as caught:
            CODECS[encoding].decode_reply(MONITOR, form.build(WRITE_LAYOUT, 5, response, 3, 0, 0x0F, 7))
        assert caught.value.found == response


def test_a_hex_identity_has_digits_in_bytes_7_and_8_unless_the_drive_is_in_fault() -> None:
    frame = PackedFormat().build(WRITE_LAYOUT, 5, 0, SunfarState.STOPPED, 0, 0x25, 7)
    with pytest.raises(AlphabetError) as caught:
        CODECS["hex"].decode_reply(sunfar.ReadIdentity(5, 0), frame)
    assert (caught.value.expected, caught.value.found, caught.value.params["position"]) == (0x0F, 0x25, 8)


def test_a_short_reply_with_a_state_is_none() -> None:
    with pytest.raises(CodeError) as caught:
        CODECS["ascii"].decode_reply(MONITOR, b"*0560300FE\r")
    assert (caught.value.expected, caught.value.found) == (0, 3)


def test_the_end_mark_is_only_looked_for_where_the_length_puts_it() -> None:
    frame = CODECS["hex"].encode_reply(
        SunfarReply(
            address=0x0D, response=SunfarResponse.OK, state=SunfarState.STOPPED, group=0xD, item=0x0D, data=0x2A5A
        )
    )
    assert frame.count(b"\r") == 4
    assert decode_accepted(sunfar.SunfarReadParameter(0x0D, 0xD, 0x0D), frame, "hex").data == 0x2A5A
    with pytest.raises(TerminatorError) as caught:
        CODECS["hex"].decode_reply(sunfar.SunfarReadParameter(0x0D, 0xD, 0x0D), frame[:-1] + b"\n")
    assert (caught.value.expected, caught.value.found) == (0x0D, 0x0A)


def test_the_other_encodings_head_is_not_accepted() -> None:
    for mine, other in (("ascii", "hex"), ("hex", "ascii")):
        with pytest.raises(HeaderError):
            CODECS[mine].decode_reply(
                MONITOR, CODECS[other].encode_reply(SunfarReply(address=5, response=SunfarResponse.BAD_CODE))[:1]
            )


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize(
    ("expected_item", "item", "published"), [(4, 4, True), (4, 0, False), (None, 0, False), (0, 0, True)]
)
def test_the_data_of_a_control_reply_are_published_only_under_the_expected_item(
    encoding: Encoding, expected_item: int | None, item: int, published: bool
) -> None:
    request = sunfar.SunfarControl(5, SunfarOperation.RUN_FORWARD_AT, 999, expected_item)
    frame = CODECS[encoding].encode_reply(
        SunfarReply(
            address=5, response=SunfarResponse.OK, state=SunfarState.ACCELERATING_FORWARD, group=0, item=item, data=540
        )
    )
    found = decode_accepted(request, frame, encoding)
    assert (found.state, found.response) == (SunfarState.ACCELERATING_FORWARD, SunfarResponse.OK)
    assert (found.item, found.data) == ((item, 540) if published else (None, None))


def test_a_control_reply_a_monitor_and_a_parameter_f0_are_the_same_bytes() -> None:
    """Because of that no command is confirmed by its own reply."""
    frame = CODECS["ascii"].encode_reply(
        SunfarReply(address=5, response=SunfarResponse.OK, state=SunfarState.STOPPED, group=0, item=2, data=7)
    )
    asked: list[sunfar.SunfarRequest] = [
        sunfar.SunfarControl(5, SunfarOperation.STOP, expected_item=2),
        sunfar.ReadMonitor(5, 2),
        sunfar.SunfarReadParameter(5, 0, 2),
        sunfar.SunfarWriteParameter(5, 0, 2, 7),
        sunfar.SunfarWriteParameter(5, 0, 2, 7, save=True),
    ]
    assert len({decode_accepted(request, frame) for request in asked}) == 1


@pytest.mark.parametrize("encoding", ENCODINGS)
@given(request=requests)
def test_the_echo_of_ones_own_request_is_never_taken_for_success(
    encoding: Encoding, request: sunfar.SunfarRequest
) -> None:
    codec = CODECS[encoding]
    frame = codec.encode_request(request)
    try:
        verdict = codec.decode_reply(request, frame)
    except ProtocolError:
        return
    if isinstance(verdict, Complete):
        assert request == sunfar.SunfarWriteParameter(request.address, request.group, request.item, 0)  # type: ignore[union-attr]
        assert (verdict.message.response, verdict.message.state) == (SunfarResponse.PASSWORD, SunfarState.NOT_READY)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_a_rejected_write_is_accepted_as_reply_and_its_echo_is_not(encoding: Encoding) -> None:
    request = sunfar.SunfarWriteParameter(5, 2, 1, 7)
    refused = SunfarReply(
        address=5, response=SunfarResponse.PASSWORD, state=SunfarState.NOT_READY, group=2, item=1, data=0
    )
    assert decode_accepted(request, CODECS[encoding].encode_reply(refused), encoding) == refused
    with pytest.raises(EchoError) as caught:
        CODECS[encoding].decode_reply(request, CODECS[encoding].encode_request(request))
    assert (caught.value.key, caught.value.found) == ("protocols.sunfar.own_echo", 7)


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("save", [False, True])
@pytest.mark.parametrize("response", [r for r in SunfarResponse if r is not SunfarResponse.OK and not r.is_short])
def test_a_rejected_write_carries_0000_and_nothing_else(
    encoding: Encoding, save: bool, response: SunfarResponse
) -> None:
    """Note of section 3 (4). A refusal with data is a damaged "done", or our own echo."""
    request = sunfar.SunfarWriteParameter(5, 2, 1, 7, save)
    refused = SunfarReply(address=5, response=response, state=SunfarState.STOPPED, group=2, item=1, data=0)
    assert decode_accepted(request, CODECS[encoding].encode_reply(refused), encoding) == refused
    for data in (7, 8):
        with pytest.raises(EchoError) as caught:
            CODECS[encoding].decode_reply(request, CODECS[encoding].encode_reply(replace(refused, data=data)))
        assert (caught.value.key, caught.value.found) == ("protocols.sunfar.refused_data", data)


def test_a_write_of_0_is_rejected_like_its_echo() -> None:
    refused = SunfarReply(
        address=5, response=SunfarResponse.PASSWORD, state=SunfarState.NOT_READY, group=2, item=1, data=0
    )
    request = sunfar.SunfarWriteParameter(5, 2, 1, 0)
    assert decode_accepted(request, CODECS["ascii"].encode_reply(refused)) == refused


def test_two_neighbours_that_change_places_do_not_turn_done_into_rejected() -> None:
    """No sum sees it: "done, accelerating" becomes "out of range, running forward"."""
    request = sunfar.SunfarWriteParameter(5, 2, 1, 7)
    done = CODECS["ascii"].encode_reply(
        SunfarReply(
            address=5, response=SunfarResponse.OK, state=SunfarState.ACCELERATING_FORWARD, group=2, item=1, data=7
        )
    )
    swapped = done[:3] + done[4:5] + done[3:4] + done[5:]
    assert (done[3:6], swapped[3:6]) == (b"011", b"101")
    with pytest.raises(EchoError):
        CODECS["ascii"].decode_reply(request, swapped)


def test_a_hex_class_or_response_is_one_digit() -> None:
    for frame in (b"Z\x00\x05\x10", b"Z\x00\x05\x1f"):
        for decode in (CODECS["hex"].decode_request, lambda data: CODECS["hex"].decode_reply(read_monitor, data)):
            with pytest.raises(AlphabetError) as caught:
                decode(frame)
            assert (caught.value.found, caught.value.params["position"]) == (frame[3], 3)


@pytest.mark.parametrize(
    ("frame", "english", "chinese"),
    [
        (b"#", "the frame begins with 23H, expected 2AH", "帧头为 23H，应为 2AH"),
        (
            b"*059",
            "response code 9, which the manual reserves, is not one of 0-4, 6-8",
            "变频器响应码 9 为手册保留的代码，不在 0-4、6-8 之内",
        ),
        (b"*0600300F00070266\r", "reply from station 6, expected 5", "请求的是 5 号站，应答的是 6 号站"),
        (b"*0500300E00070264\r", "the reply names item 14, the request item 15", "应答的数据地址为 14，请求为 15"),
        (b"*0500300F0007028B\n", "byte 17: 0AH where the end mark 0DH belongs", "第 17 字节为 0AH，应为帧尾 0DH"),
    ],
)
def test_an_error_carries_both_numbers(frame: bytes, english: str, chinese: str) -> None:
    with pytest.raises(ProtocolError) as caught:
        CODECS["ascii"].decode_reply(MONITOR, frame)
    assert (caught.value.text("en"), caught.value.text("zh")) == (english, chinese)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_a_command_that_expects_no_monitor_takes_no_data_of_a_fault_either(encoding: Encoding) -> None:
    message = SunfarReply(
        address=5, response=SunfarResponse.OK, state=SunfarState.FAULT, group=0, item=None, data=7, fault_code=3
    )
    found = decode_accepted(
        sunfar.SunfarControl(5, SunfarOperation.STOP), CODECS[encoding].encode_reply(message), encoding
    )
    assert (found.state, found.fault_code, found.item, found.data) == (SunfarState.FAULT, 3, None, None)


def test_an_identity_with_a_byte_that_is_no_digit_is_one_of_a_fault_or_none() -> None:
    frame = FORMS["hex"].build(WRITE_LAYOUT, 5, 0, SunfarState.STOPPED, 2, 0x10, 0)
    with pytest.raises(AlphabetError) as caught:
        CODECS["hex"].decode_reply(sunfar.ReadIdentity(5, 2), frame)
    error = caught.value
    assert (error.key, error.expected, error.found) == ("protocols.sunfar.digit", 0x0F, 0x10)
    assert error.params["position"] == 8
