"""Frames that a Sunfar host sends, and their effect: only a control frame carries an operation."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivebus.protocols import sunfar
from drivebus.protocols.codec import Complete, Effect
from drivebus.protocols.sunfar import SunfarCodec, SunfarOperation
from drivebus.protocols.sunfar.family import FAMILY
from drivebus.protocols.sunfar.frame import CONTROL_LAYOUT, WRITE_LAYOUT
from fixtures.sunfar_messages import (
    CODECS,
    ENCODINGS,
    FORMS,
    STOPS,
    Encoding,
    controls,
    encodings,
    groups,
    items,
    reads,
    requests,
    writes,
)


@given(encodings, reads)
def test_bytes_4_and_5_of_a_read_are_always_the_digits_00(encoding: Encoding, request: sunfar.SunfarRequest) -> None:
    frame = CODECS[encoding].encode_request(request)
    assert frame[4:6] == (b"00" if encoding == "ascii" else b"\x00\x00")
    assert sunfar.frame_effect(frame) is Effect.NONE


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_no_read_that_there_is_carries_an_operation(encoding: Encoding) -> None:
    """Every address, group and item: 135,408 frames."""
    none = b"00" if encoding == "ascii" else b"\x00\x00"
    encode = CODECS[encoding].encode_request
    for address in range(31):
        assert all(encode(sunfar.ReadIdentity(address, group))[4:6] == none for group in range(16))
        assert all(encode(sunfar.ReadMonitor(address, item))[4:6] == none for item in range(256))
        for group in range(16):
            assert all(encode(sunfar.SunfarReadParameter(address, group, item))[4:6] == none for item in range(256))


@given(encodings, writes)
def test_a_write_carries_no_operation(encoding: Encoding, request: sunfar.SunfarWriteParameter) -> None:
    frame = CODECS[encoding].encode_request(request)
    assert frame[4:6] == (b"00" if encoding == "ascii" else b"\x00\x00")
    assert sunfar.frame_effect(frame) is Effect.SETTING


@pytest.mark.parametrize(
    "message", [sunfar.ReadIdentity, sunfar.ReadMonitor, sunfar.SunfarReadParameter, sunfar.SunfarWriteParameter]
)
def test_only_control_has_a_field_for_an_operation(message: Any) -> None:
    assert "operation" not in {field.name for field in dataclasses.fields(message)}
    assert "operation" in {field.name for field in dataclasses.fields(sunfar.SunfarControl)}


@given(encodings, requests)
def test_a_station_decodes_what_a_host_sends(encoding: Encoding, request: sunfar.SunfarRequest) -> None:
    frame = CODECS[encoding].encode_request(request)
    operation = request.operation if isinstance(request, sunfar.SunfarControl) else SunfarOperation.NONE
    assert CODECS[encoding].decode_request(frame) == Complete(sunfar.ReceivedRequest(request, operation), len(frame))


@given(encodings, st.integers(0, 31), st.sampled_from(STOPS), st.integers())
def test_a_stop_is_never_rejected_and_carries_0000(
    encoding: Encoding, address: int, operation: SunfarOperation, data: int
) -> None:
    frame = CODECS[encoding].encode_request(sunfar.SunfarControl(address, operation, data))
    assert CODECS[encoding].decode_request(frame).message.request == sunfar.SunfarControl(address, operation)
    assert sunfar.frame_effect(frame) is Effect.STOP


@pytest.mark.parametrize(
    "request_",
    [
        sunfar.ReadMonitor(31, 0),
        sunfar.ReadIdentity(31, 0),
        sunfar.SunfarReadParameter(31, 1, 2),
        sunfar.ReadMonitor(32, 0),
        sunfar.ReadMonitor(-1, 0),
        sunfar.ReadMonitor(1, 256),
        sunfar.SunfarReadParameter(1, 16, 0),
        sunfar.SunfarWriteParameter(1, 0, 0, 0x10000),
        sunfar.SunfarControl(1, SunfarOperation.SET_FREQUENCY, 0x10000),
        sunfar.SunfarControl(1, SunfarOperation.RUN_FORWARD, 1),
        sunfar.SunfarControl(1, SunfarOperation.RESET_FAULT, 1),
        sunfar.SunfarControl(1, 0x30),  # type: ignore[arg-type]
    ],
    ids=repr,
)
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_what_no_drive_can_answer_or_obey_is_not_emitted(encoding: Encoding, request_: sunfar.SunfarRequest) -> None:
    with pytest.raises(ValueError, match=r"expected|no station answers|takes no data|not one of"):
        CODECS[encoding].encode_request(request_)


@given(encodings, requests)
def test_a_broadcast_expects_no_reply(encoding: Encoding, request: sunfar.SunfarRequest) -> None:
    codec = CODECS[encoding]
    assert codec.reply_size(request) == codec.largest_reply(request) == (0 if request.address == 31 else 18)
    assert codec.address_of(request) == request.address


def test_an_unknown_encoding_is_rejected() -> None:
    with pytest.raises(ValueError, match="ascii or hex"):
        SunfarCodec("rtu")  # type: ignore[arg-type]


@given(encodings, controls)
def test_the_effect_of_a_command_is_read_from_its_bytes(encoding: Encoding, request: sunfar.SunfarControl) -> None:
    frame = CODECS[encoding].encode_request(request)
    name, found = request.operation.name, sunfar.frame_effect(frame)
    if request.operation in STOPS:
        assert found is Effect.STOP
    elif name in ("NONE", "STOP_AT", "JOG_STOP_AT", "SET_FREQUENCY", "RESET_FAULT"):
        assert found is Effect.SETTING
    else:
        assert found is Effect.MOTION


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_a_stop_that_brings_a_frequency_or_writes_is_a_setting(encoding: Encoding) -> None:
    form = FORMS[encoding]
    assert sunfar.frame_effect(form.build(CONTROL_LAYOUT, 1, 4, SunfarOperation.STOP, 999)) is Effect.SETTING
    assert sunfar.frame_effect(form.build(WRITE_LAYOUT, 1, 3, SunfarOperation.STOP, 0, 0, 1)) is Effect.SETTING
    assert sunfar.frame_effect(form.build(CONTROL_LAYOUT, 1, 4, SunfarOperation.NONE, 999)) is Effect.SETTING


@given(encodings, requests)
def test_what_is_not_one_whole_canonical_frame_counts_as_motion(
    encoding: Encoding, request: sunfar.SunfarRequest
) -> None:
    frame = CODECS[encoding].encode_request(request)
    for wrong in (frame[:-1], frame + b"\r", b"", b"#" + frame[1:], frame[:-2] + bytes((frame[-2] ^ 1,)) + frame[-1:]):
        assert sunfar.frame_effect(wrong) is Effect.MOTION


def test_a_tolerated_spelling_counts_as_motion() -> None:
    assert sunfar.frame_effect(b"*0010000:018:\r") is Effect.MOTION


def parse(notation: str) -> tuple[str, int] | None:
    return FAMILY.notations["sunfar"].parse(notation, 0xFFFF, {})


@given(groups, items)
def test_a_parameter_has_the_manuals_notation(group: int, item: int) -> None:
    assert parse(sunfar.parameter_name(group, item)) == ("parameter", group << 8 | item)


@pytest.mark.parametrize(
    ("notation", "place"),
    [("F0.0", 0), ("F1.10", 0x010A), ("F0.16", 0x0010), ("F9.7", 0x0907), ("FC.3", 0x0A03), ("FP.255", 0x0FFF)],
)
def test_the_sixteen_groups_have_these_letters(notation: str, place: int) -> None:
    assert parse(notation) == ("parameter", place)
    assert sunfar.parameter_name(place >> 8, place & 0xFF) == notation


@pytest.mark.parametrize(
    "notation",
    ["", "F1", "F1.", "FA.1", "G1.1", "F.1", "F00.1", "F1.256", "F1.1.1", "F1.-1", "F1.٣", "F0.²"],
)
def test_what_is_no_parameter_is_rejected(notation: str) -> None:
    assert parse(notation) is None


def test_a_monitor_index_is_binary_unless_the_drive_wants_it_as_printed() -> None:
    assert (sunfar.monitor_item(15), sunfar.monitor_item(15, "bcd")) == (0x0F, 0x15)
    assert (sunfar.monitor_index(0x25), sunfar.monitor_index(0x25, "bcd")) == (37, 25)
    assert sunfar.monitor_index(0x0F, "bcd") is None
    with pytest.raises(ValueError, match=r"d\.100"):
        sunfar.monitor_item(100, "bcd")
