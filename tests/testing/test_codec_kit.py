"""The conformance kit for codecs names each violated rule."""

from __future__ import annotations

from typing import Any

import pytest

from drivebus.errors import ChecksumError, HeaderError, ProtocolError
from drivebus.protocols.codec import Codec, Complete, DecodeResult, Incomplete
from drivebus.testing.codec_kit import CodecExchange, CodecFault, check_codec


class Toy:
    """Codec of four bytes: 55H, address, value, sum. A reply repeats its request with 56H in front."""

    family: str = "toy"
    encoding: str = "toy"
    broadcast_address: int | None = 0

    def encode_request(self, request: tuple[int, int], /) -> bytes:
        return self.frame(0x55, *request)

    def encode_reply(self, reply: tuple[int, int], /) -> bytes:
        return self.frame(0x56, *reply)

    def frame(self, head: int, address: int, value: int) -> bytes:
        octets = bytes((head, address, value))
        return octets + bytes((self.check(octets),))

    def check(self, octets: bytes) -> int:
        return sum(octets) & 0xFF

    def decode(self, head: int, data: bytes) -> DecodeResult:
        if len(data) < 4:
            return Incomplete(4)
        if data[0] != head:
            raise HeaderError("protocols.header", expected=head, found=data[0])
        if data[3] != self.check(data[:3]):
            raise ChecksumError("protocols.checksum", expected=self.check(data[:3]), found=data[3])
        return Complete((data[1], data[2]), 4)

    def decode_request(self, data: bytes, /) -> DecodeResult:
        return self.decode(0x55, data)

    def decode_reply(self, request: Any, data: bytes, /) -> DecodeResult:
        return self.decode(0x56, data)

    def reply_size(self, request: tuple[int, int], /) -> int:
        return 4 if request[0] else 0

    def largest_reply(self, request: tuple[int, int], /) -> int:
        return self.reply_size(request)

    def address_of(self, request: tuple[int, int], /) -> int:
        return request[0]


EXCHANGES = [
    CodecExchange(
        name="speed",
        request=(3, 7),
        sent=bytes.fromhex("55 03 07 5F"),
        reply=(3, 7),
        received=bytes.fromhex("56 03 07 60"),
    ),
    CodecExchange(name="all stop", request=(0, 0), sent=bytes.fromhex("55 00 00 55")),
]


def test_a_codec_that_obeys_the_contract_passes() -> None:
    codec: Codec = Toy()
    report = check_codec(codec, EXCHANGES)
    assert report.checks > 1000
    assert report.accepted_flips == {"speed": []}


class NoCheck(Toy):
    def decode(self, head: int, data: bytes) -> DecodeResult:
        if len(data) < 4:
            return Incomplete(4)
        if data[0] != head:
            raise HeaderError("protocols.header", expected=head, found=data[0])
        return Complete((data[1], data[2]), 4)


class Hunter(Toy):
    def decode(self, head: int, data: bytes) -> DecodeResult:
        start = max(data.find(head), 0)
        verdict = super().decode(head, data[start:])
        return Complete(verdict.message, verdict.size) if isinstance(verdict, Complete) else Incomplete(start + 4)


class Greedy(Toy):
    def decode(self, head: int, data: bytes) -> DecodeResult:
        verdict = super().decode(head, data)
        return Complete(verdict.message, len(data)) if isinstance(verdict, Complete) else verdict


class Impatient(Toy):
    def decode(self, head: int, data: bytes) -> DecodeResult:
        return Complete((data[1], data[2]), 4) if len(data) == 3 and data[0] == head else super().decode(head, data)


class Liar(Toy):
    def reply_size(self, request: tuple[int, int], /) -> int:
        return 5


class Asker(Toy):
    def decode(self, head: int, data: bytes) -> DecodeResult:
        return Incomplete(len(data)) if len(data) < 4 else super().decode(head, data)


class Crasher(Toy):
    def decode(self, head: int, data: bytes) -> DecodeResult:
        if data[:1] not in (b"", b"\x55", b"\x56", b"\xff"):
            raise ValueError(data)
        return super().decode(head, data)


class Moody(Toy):
    def decode(self, head: int, data: bytes) -> DecodeResult:
        if len(data) == 1 and data[0] not in (head, 0xFF):
            raise HeaderError("protocols.start", expected=head, found=data[0])
        return super().decode(head, data)


class Forgetful(Toy):
    def decode_request(self, data: bytes, /) -> DecodeResult:
        verdict = super().decode_request(data)
        return Complete((verdict.message[0], 0), 4) if isinstance(verdict, Complete) else verdict


@pytest.mark.parametrize(
    ("broken", "rule"),
    [
        (NoCheck, "a flipped request is rejected"),
        (Hunter, "a frame counts at offset 0 only"),
        (Greedy, "what follows a frame does not change it"),
        (Impatient, "a cut frame is not complete"),
        (Liar, "reply_size is the size of the reply"),
        (Asker, "need is beyond the data and within the frame"),
        (Crasher, "only ProtocolError comes out"),
        (Moody, "whole and byte by byte agree"),
        (Forgetful, "a decoded request encodes to the same bytes"),
    ],
)
def test_a_violated_rule_is_named(broken: type[Toy], rule: str) -> None:
    with pytest.raises(CodecFault) as caught:
        check_codec(broken(), EXCHANGES)
    assert caught.value.rule == rule
    assert caught.value.exchange == "speed"
    assert rule in str(caught.value)


def test_a_protocol_without_a_check_gets_its_accepted_flips_counted() -> None:
    report = check_codec(NoCheck(), EXCHANGES, detects_flips=False)
    assert len(report.accepted_flips["speed"]) == 24


def test_a_wrong_vector_is_reported() -> None:
    wrong = CodecExchange(name="speed", request=(3, 8), sent=bytes.fromhex("55 03 07 5F"))
    with pytest.raises(CodecFault) as caught:
        check_codec(Toy(), [wrong])
    assert caught.value.rule == "encode_request returns the known bytes"


def test_the_toy_codec_raises_protocol_errors_only() -> None:
    with pytest.raises(ProtocolError):
        Toy().decode_reply(None, b"\x00\x00\x00\x00")
