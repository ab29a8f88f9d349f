"""Codecs of the families of one folder each: any request is restored, any bytes are rejected or decoded."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivebus.errors import ProtocolError
from drivebus.families.huanyang import codec as hy
from drivebus.families.mitsubishi import codec as fr
from drivebus.protocols.codec import Codec, Complete, Effect, Incomplete

HUANYANG_REQUESTS = st.one_of(
    st.builds(hy.read_parameter, st.integers(1, 250), st.integers(0, 255)),
    st.builds(
        hy.write_parameter, st.integers(1, 250), st.integers(0, 255), st.integers(0, 255), st.sampled_from((1, 2))
    ),
    st.builds(hy.control, st.integers(0, 250), st.integers(0, 255)),
    st.builds(hy.read_status, st.integers(1, 250), st.integers(0, 7)),
    st.builds(hy.set_frequency, st.integers(0, 250), st.integers(0, 0xFFFF)),
)
MITSUBISHI_REQUESTS = st.one_of(
    st.builds(fr.MitsubishiRequest, st.integers(0, 31), st.sampled_from(sorted(fr.READ_DIGITS))),
    st.builds(fr.MitsubishiRequest, st.integers(0, 31), st.just(fr.SET_FREQUENCY), st.integers(0, 0xFFFF)),
    st.builds(fr.MitsubishiRequest, st.integers(0, 31), st.just(fr.RUN_COMMAND), st.integers(0, 0xFF)),
)

each_family = pytest.mark.parametrize(
    ("codec", "requests", "effect_of"),
    [
        (hy.HuanyangCodec(), HUANYANG_REQUESTS, hy.frame_effect),
        (fr.MitsubishiCodec(), MITSUBISHI_REQUESTS, fr.frame_effect),
    ],
    ids=["huanyang", "mitsubishi"],
)
EffectOf = Callable[[bytes], Effect]


@each_family
@given(data=st.data())
def test_a_whole_request_decodes_to_what_was_encoded_and_a_part_of_it_is_incomplete(
    codec: Codec, requests: st.SearchStrategy[Any], effect_of: EffectOf, data: st.DataObject
) -> None:
    sent = data.draw(requests)
    frame = codec.encode_request(sent)
    assert codec.decode_request(frame) == Complete(sent, len(frame))
    for size in range(len(frame)):
        found = codec.decode_request(frame[:size])
        assert isinstance(found, Incomplete) and size < found.need <= len(frame)


@each_family
@given(data=st.data(), received=st.binary(max_size=14))
def test_any_bytes_are_decoded_or_rejected(
    codec: Codec, requests: st.SearchStrategy[Any], effect_of: EffectOf, data: st.DataObject, received: bytes
) -> None:
    sent = data.draw(requests)
    for decode in (codec.decode_request, lambda frame: codec.decode_reply(sent, frame)):
        try:
            result = decode(received)
        except ProtocolError:
            continue
        assert isinstance(result, Complete | Incomplete)


@each_family
@given(data=st.data())
def test_a_flipped_bit_is_detected(
    codec: Codec, requests: st.SearchStrategy[Any], effect_of: EffectOf, data: st.DataObject
) -> None:
    frame = bytearray(codec.encode_request(data.draw(requests)))
    bit = data.draw(st.integers(0, 8 * len(frame) - 1))
    frame[bit // 8] ^= 1 << bit % 8
    assert effect_of(bytes(frame)) is Effect.MOTION
