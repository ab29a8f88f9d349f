"""Every golden C320 frame: decoded with its verdict, encoded as its canonical form, whole or in any pieces."""

from __future__ import annotations

import random
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivebus.errors import AlphabetError, ChecksumError, EchoError, ProtocolError
from drivebus.protocols import sunfar
from drivebus.protocols.codec import Complete, Incomplete
from drivebus.protocols.sunfar import SunfarCodec, SunfarOperation, SunfarResponse, SunfarState
from fixtures.vectors import Vector, vectors_by_id

VECTORS = vectors_by_id("c320")
REQUESTS = [v for v in VECTORS.values() if v.direction == "request"]
REPLIES = [v for v in VECTORS.values() if v.direction == "response"]
CLEAN = [v for v in VECTORS.values() if not v.misprinted]


def tolerant(vector: Vector) -> SunfarCodec:
    return SunfarCodec(vector.encoding, digits="tolerant", nibble=True)


def strict(vector: Vector) -> SunfarCodec:
    return SunfarCodec(vector.encoding)


def request_of(reply: Vector) -> sunfar.SunfarRequest:
    """The request that a reply answers, or for a reply on its own one that it fits."""
    asked = reply.request
    if asked is not None:
        request = tolerant(asked).decode_request(asked.data).message.request
        if isinstance(request, sunfar.SunfarControl):
            return sunfar.SunfarControl(request.address, request.operation, request.data, expected_item=0)
        return request
    fields = reply.fields
    return sunfar.ReadMonitor(fields["address"], fields.get("item", 0))


def received_fields(received: sunfar.ReceivedRequest) -> dict[str, Any]:
    request = received.request
    names = ("address", "group", "item", "data")
    found = {name: getattr(request, name) for name in names if hasattr(request, name)}
    return {**found, "class": request.frame_class, "operation": int(received.operation)}


def reply_fields(reply: sunfar.SunfarReply) -> dict[str, Any]:
    return {name: getattr(reply, name) for name in reply.__slots__}


def named(vector: Vector, *derived: str) -> dict[str, Any]:
    """The vector's fields without those that a profile derives."""
    derived = ("parameter", "frequency_hz", "voltage_class", "power_kw", *derived)
    return {name: value for name, value in vector.fields.items() if name not in derived}


@pytest.mark.parametrize("vector", REQUESTS, ids=repr)
def test_a_station_decodes_every_request_and_the_operation_in_it(vector: Vector) -> None:
    verdict = tolerant(vector).decode_request(vector.data)
    assert isinstance(verdict, Complete)
    assert verdict.size == len(vector.data)
    assert named(vector).items() <= received_fields(verdict.message).items()


@pytest.mark.parametrize("vector", REQUESTS, ids=repr)
def test_a_request_is_emitted_in_its_canonical_form_without_an_operation(vector: Vector) -> None:
    request = tolerant(vector).decode_request(vector.data).message.request
    assert strict(vector).encode_request(request) == vector.correct


@pytest.mark.parametrize("vector", REPLIES, ids=repr)
def test_a_reply_is_read_against_its_request(vector: Vector) -> None:
    verdict = tolerant(vector).decode_reply(request_of(vector), vector.data)
    assert isinstance(verdict, Complete)
    assert verdict.size == len(vector.data)
    assert named(vector).items() <= reply_fields(verdict.message).items()
    assert verdict.message.nibble_data == (vector.line["meant"]["data"] if vector.ambiguous else None)


@pytest.mark.parametrize("vector", [v for v in REPLIES if not v.ambiguous], ids=repr)
def test_a_reply_is_emitted_in_its_canonical_form(vector: Vector) -> None:
    reply = tolerant(vector).decode_reply(request_of(vector), vector.data).message
    assert strict(vector).encode_reply(reply) == vector.correct


@pytest.mark.parametrize("vector", [v for v in CLEAN if not v.hazardous], ids=repr)
def test_what_the_strict_codec_reads_of_a_clean_frame_is_what_the_tolerant_one_reads(vector: Vector) -> None:
    if vector.direction == "request":
        verdict = strict(vector).decode_request(vector.data)
        assert verdict == tolerant(vector).decode_request(vector.data)
    else:
        request = request_of(vector)
        assert strict(vector).decode_reply(request, vector.data) == tolerant(vector).decode_reply(request, vector.data)


def test_a_strict_station_answers_code_7_to_the_manuals_digits() -> None:
    vector = VECTORS["c320-4.5-request-ascii"]
    with pytest.raises(AlphabetError) as caught:
        strict(vector).decode_request(vector.data)
    assert caught.value.found == 0x3A
    assert sunfar.error_reply(caught.value) == sunfar.SunfarReply(address=0, response=SunfarResponse.BAD_ASCII)


@pytest.mark.parametrize(("name", "error"), [("4.5", ChecksumError), ("4.6", AlphabetError)])
def test_a_strict_station_does_not_answer_frames_printed_nibble_by_nibble(
    name: str, error: type[ProtocolError]
) -> None:
    vector = VECTORS[f"c320-{name}-request-hex"]
    with pytest.raises(error) as caught:
        strict(vector).decode_request(vector.data)
    assert sunfar.error_reply(caught.value) is None


def test_a_strict_host_rejects_the_manuals_digits() -> None:
    vector = VECTORS["c320-4.5-response-ascii"]
    with pytest.raises(AlphabetError) as caught:
        strict(vector).decode_reply(request_of(vector), vector.data)
    assert (caught.value.found, caught.value.params["position"]) == (0x3A, 8)


def test_a_strict_host_reads_the_ambiguous_frame_as_packed_and_so_for_another_value() -> None:
    vector = VECTORS["c320-4.5-response-hex"]
    with pytest.raises(EchoError) as caught:
        strict(vector).decode_reply(request_of(vector), vector.data)
    assert (caught.value.expected, caught.value.found) == (16, 256)


def test_the_item_of_a_fault_is_the_fault_code_and_no_echo() -> None:
    vector = VECTORS["c320-fault-12-ascii"]
    reply = strict(vector).decode_reply(sunfar.ReadMonitor(3, 4), vector.data).message
    assert (reply.state, reply.fault_code, reply.item) == (SunfarState.FAULT, 12, None)


def decode(vector: Vector, data: bytes, codec: SunfarCodec | None = None) -> Any:
    """The verdict, or the type and numbers of the error."""
    codec = codec or tolerant(vector)
    try:
        if vector.direction == "request":
            return codec.decode_request(data)
        return codec.decode_reply(request_of(vector), data)
    except ProtocolError as error:
        return type(error), error.expected, error.found


def in_pieces(vector: Vector, data: bytes, cuts: list[int]) -> Any:
    """The first final answer as the bytes arrive, asked after every cut."""
    for end in [*sorted(cuts), len(data)]:
        found = decode(vector, data[:end])
        if not isinstance(found, Incomplete):
            return found
        assert found.need > end
    return found


@pytest.mark.parametrize("vector", VECTORS.values(), ids=repr)
def test_byte_by_byte_is_the_same_as_whole(vector: Vector) -> None:
    data = vector.data
    assert in_pieces(vector, data, list(range(len(data)))) == decode(vector, data)


@given(st.sampled_from(list(VECTORS.values())), st.data())
def test_any_pieces_of_any_damaged_frame_are_the_same_as_whole(vector: Vector, data: st.DataObject) -> None:
    frame = bytearray(vector.data)
    frame[data.draw(st.integers(0, len(frame) - 1))] = data.draw(st.integers(0, 255))
    cuts = data.draw(st.lists(st.integers(0, len(frame) - 1)))
    assert in_pieces(vector, bytes(frame), cuts) == decode(vector, bytes(frame))


@pytest.mark.parametrize("vector", VECTORS.values(), ids=repr)
@pytest.mark.parametrize("trailing", [b"\r", b"*", b"\x00\x00", b"Z\x00\x01"])
def test_a_frame_ends_at_its_length_whatever_follows(vector: Vector, trailing: bytes) -> None:
    assert decode(vector, vector.data + trailing) == decode(vector, vector.data)


def single_flips(frame: bytes) -> Iterator[bytes]:
    for bit in range(8 * len(frame)):
        flipped = bytearray(frame)
        flipped[bit // 8] ^= 1 << bit % 8
        yield bytes(flipped)


@pytest.mark.parametrize("vector", VECTORS.values(), ids=repr)
def test_no_single_flipped_bit_passes_for_a_frame(vector: Vector) -> None:
    """The checksum detects every one of them."""
    for flipped in single_flips(vector.correct):
        assert not isinstance(decode(vector, flipped, strict(vector)), Complete), flipped.hex(" ")


@pytest.mark.parametrize("vector", VECTORS.values(), ids=repr)
def test_a_flipped_bit_that_a_tolerant_reader_accepts_changes_no_number(vector: Vector) -> None:
    """Only the case of a letter in the sum itself: 43H for 63H."""
    meant = decode(vector, vector.data)
    for flipped in single_flips(vector.data):
        found = decode(vector, flipped)
        assert not isinstance(found, Complete) or found == meant, flipped.hex(" ")


@pytest.mark.parametrize("vector", REPLIES, ids=repr)
def test_every_byte_value_in_every_position_of_a_reply_raises_nothing_but_protocol_errors(vector: Vector) -> None:
    codec, request, frame = strict(vector), request_of(vector), bytearray(vector.correct)
    for position, original in enumerate(vector.correct):
        for byte in range(256):
            frame[position] = byte
            if byte == original:
                continue
            try:
                assert isinstance(codec.decode_reply(request, bytes(frame)), Incomplete)
            except ProtocolError as error:
                assert error.text("en") != error.key
                assert error.text("zh") not in (error.key, error.text("en"))
        frame[position] = original


def test_random_bytes_raise_nothing_but_protocol_errors() -> None:
    chance = random.Random(320)
    codecs = [
        SunfarCodec(e, d, nibble=n) for e in ("ascii", "hex") for d in ("strict", "tolerant") for n in (False, True)
    ]
    asked = [sunfar.ReadIdentity(0, 0), sunfar.ReadMonitor(5, 0), sunfar.SunfarWriteParameter(5, 1, 2, 3)]
    asked += [sunfar.SunfarControl(5, SunfarOperation.STOP), sunfar.SunfarReadParameter(5, 1, 2)]
    for _ in range(20_000):
        codec = chance.choice(codecs)
        data = chance.choice((b"", b"*05", b"Z\x00\x05", b"*050", b"Z\x00\x05\x00")) + chance.randbytes(16)
        if chance.random() < 0.5:
            data = bytes(chance.choice(b"0123456789ABCDEF\r*") for _ in range(19)) if data[:1] == b"*" else data
        for attempt in (lambda: codec.decode_reply(chance.choice(asked), data), lambda: codec.decode_request(data)):  # noqa: B023
            try:
                attempt()
            except ProtocolError as error:
                assert str(error) != error.key


def test_the_checksum_error_carries_both_numbers() -> None:
    with pytest.raises(ChecksumError) as caught:
        SunfarCodec().decode_reply(sunfar.ReadMonitor(0, 0), b"*0000100003E70261\r")
    assert str(caught.value) == "checksum 0261H received, 0260H computed"
    assert caught.value.text("zh") == "收到的校验和为 0261H，计算值为 0260H"
