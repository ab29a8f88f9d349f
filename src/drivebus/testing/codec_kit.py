"""Conformance kit for codecs: ``check_codec`` checks the contract of ``protocols.codec.Codec``.

It checks canonical bytes, the same result whole, byte by byte, concatenated and with trailing noise, rejection of
flipped bits, correct sizes, and that any bytes raise no exception other than ``ProtocolError``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from random import Random
from typing import Any

from drivebus.errors import ProtocolError
from drivebus.protocols.codec import Codec, Complete, CompleteIfSilent, DecodeResult, Incomplete

Decode = Callable[[bytes], DecodeResult]


class CodecFault(AssertionError):
    """Violation of the contract by a codec: the exchange, the rule, the bytes."""

    def __init__(self, exchange: str, rule: str, data: bytes = b"", detail: object = "") -> None:
        self.exchange, self.rule, self.data = exchange, rule, data
        super().__init__(f"{exchange}: {rule} [{data.hex(' ').upper()}] {detail}".rstrip())


@dataclass(frozen=True, slots=True, kw_only=True)
class CodecExchange:
    """A request and its reply, as messages and as bytes from an independent source (a manual, a peer)."""

    name: str
    request: Any
    sent: bytes
    reply: Any = None
    received: bytes = b""
    """Empty for a broadcast, or where no frame of the reply is known."""
    is_normal_reply: bool = True
    """False for an error reply, whose size may differ from ``reply_size``."""


@dataclass(slots=True)
class CodecReport:
    """Number of checks, and the flipped bits that a protocol without a checksum can't detect."""

    checks: int = 0
    accepted_flips: dict[str, list[tuple[int, int]]] = field(default_factory=dict)
    """Name of the exchange → (byte, bit) of each single flip after which a reply was still accepted."""


def check_codec(
    codec: Codec,
    exchanges: Iterable[CodecExchange],
    *,
    request_of: Callable[[Any], Any] = lambda message: message,
    detects_flips: bool = True,
    allows_leading_noise: bool = False,
    garbage_frames: int = 300,
    seed: int = 1,
) -> CodecReport:
    """Check a codec against known exchanges, and ``garbage_frames`` random frames for each direction of each exchange.

    ``request_of`` extracts the request from the message of ``decode_request``; without ``detects_flips``, as of a
    protocol without a checksum, accepted flips are reported; with ``allows_leading_noise`` the codec may skip noise.
    Raises CodecFault at the first violation.
    """
    report, checks = CodecReport(), _CodecChecks(codec, request_of, Random(seed), garbage_frames)
    exchanges = tuple(exchanges)
    for exchange in exchanges:
        report.checks += checks.check_sizes(exchange)
        report.checks += checks.check_request(
            exchange, allows_leading_noise=allows_leading_noise, detects_flips=detects_flips
        )
        if exchange.received:
            report.checks += checks.check_reply(exchange, exchanges, allows_leading_noise=allows_leading_noise)
            accepted = checks.accepted_flips(exchange)
            report.checks += 8 * len(exchange.received)
            if accepted and detects_flips:
                raise CodecFault(exchange.name, "a flipped bit is rejected", exchange.received, accepted)
            report.accepted_flips[exchange.name] = accepted
    return report


class _CodecChecks:
    """Checks of one codec. Each returns the number of cases that it tried, and raises CodecFault at a violation."""

    def __init__(self, codec: Codec, request_of: Callable[[Any], Any], rng: Random, garbage_frames: int) -> None:
        self.codec, self.request_of, self.rng, self.garbage_frames = codec, request_of, rng, garbage_frames

    def check_sizes(self, exchange: CodecExchange) -> int:
        codec, request = self.codec, exchange.request
        size, largest = codec.reply_size(request), codec.largest_reply(request)
        _require(exchange, "largest_reply is not below reply_size", largest >= size, detail=(size, largest))
        if codec.address_of(request) == codec.broadcast_address:
            _require(exchange, "reply_size of a broadcast is 0", size == 0, detail=size)
        if exchange.received and exchange.is_normal_reply:
            _require(exchange, "reply_size is the size of the reply", size == len(exchange.received), detail=size)
        _require(exchange, "largest_reply covers every reply", largest >= len(exchange.received), detail=largest)
        return 3

    def check_request(self, exchange: CodecExchange, *, allows_leading_noise: bool, detects_flips: bool) -> int:
        codec, data = self.codec, exchange.sent
        _require(
            exchange, "encode_request returns the known bytes", codec.encode_request(exchange.request) == data, data
        )
        whole = self._decode_whole(exchange, codec.decode_request, data)
        again = codec.encode_request(self.request_of(whole))
        _require(exchange, "a decoded request encodes to the same bytes", again == data, data, again)
        tried = self._check_parts(
            exchange, codec.decode_request, data, whole, allows_leading_noise=allows_leading_noise, followers=(data,)
        )
        for place, flipped in _flips(data):
            accepted = _accepted_message(codec.decode_request, flipped)
            _require(exchange, "a flipped request is rejected", accepted is None or not detects_flips, flipped, place)
        return tried + 8 * len(data)

    def check_reply(
        self, exchange: CodecExchange, others: tuple[CodecExchange, ...], *, allows_leading_noise: bool
    ) -> int:
        codec, data = self.codec, exchange.received

        def decode(data: bytes) -> DecodeResult:
            return codec.decode_reply(exchange.request, data)

        _require(exchange, "encode_reply returns the known bytes", codec.encode_reply(exchange.reply) == data, data)
        whole = self._decode_whole(exchange, decode, data)
        _require(exchange, "decode_reply returns the known reply", whole == exchange.reply, data, whole)
        followers = tuple(other.received for other in others if other.received)
        return self._check_parts(
            exchange, decode, data, whole, allows_leading_noise=allows_leading_noise, followers=followers
        )

    def accepted_flips(self, exchange: CodecExchange) -> list[tuple[int, int]]:
        """Return (byte, bit) of each single flip after which the reply is still accepted."""

        def decode(data: bytes) -> DecodeResult:
            return self.codec.decode_reply(exchange.request, data)

        return [place for place, flipped in _flips(exchange.received) if _accepted_message(decode, flipped) is not None]

    def _decode_whole(self, exchange: CodecExchange, decode: Decode, data: bytes) -> Any:
        result = decode(data)
        if isinstance(result, Incomplete):
            raise CodecFault(exchange.name, "a whole frame is complete", data, result)
        _require(exchange, "size is that of the frame", result.size == len(data), data, result.size)
        return result.message

    def _check_parts(
        self,
        exchange: CodecExchange,
        decode: Decode,
        data: bytes,
        whole: Any,
        *,
        allows_leading_noise: bool,
        followers: tuple[bytes, ...],
    ) -> int:
        for end in range(len(data)):
            result = decode(data[:end])
            _require(exchange, "a cut frame is not complete", not isinstance(result, Complete), data[:end], result)
            need = result.need if isinstance(result, Incomplete | CompleteIfSilent) else 0
            _require(exchange, "need is beyond the data and within the frame", end < need <= len(data), data, need)
        tails = (*followers, *(bytes((byte,)) for byte in range(256)))
        for tail in tails:
            result = decode(data + tail)
            same = isinstance(result, Complete) and result.size == len(data) and result.message == whole
            alone = isinstance(decode(data), CompleteIfSilent)
            _require(exchange, "what follows a frame does not change it", same or alone, data + tail, result)
        if not allows_leading_noise:
            accepted = _accepted_message(decode, b"\xff" + data)
            _require(exchange, "a frame counts at offset 0 only", accepted is None, b"\xff" + data, accepted)
        return len(data) + len(tails) + self._check_garbage(exchange, decode, data)

    def _check_garbage(self, exchange: CodecExchange, decode: Decode, data: bytes) -> int:
        """Check that garbage raises only ProtocolError, and gives the same result whole and byte by byte."""
        count = 0
        for garbage in self._mutants(data):
            count += 1
            try:
                alike = _result(decode, garbage) == _decode_bytewise(decode, garbage)
            except Exception as error:
                raise CodecFault(exchange.name, "only ProtocolError comes out", garbage, repr(error)) from error
            _require(exchange, "whole and byte by byte agree", alike, garbage)
        return count

    def _mutants(self, data: bytes) -> Iterator[bytes]:
        rng = self.rng
        for turn in range(self.garbage_frames):
            if turn % 3 == 0:
                yield bytes(rng.randrange(256) for _ in range(rng.randrange(40)))
            elif turn % 3 == 1:
                place = rng.randrange(len(data))
                yield data[:place] + bytes((rng.randrange(256),)) + data[place + 1 :]
            else:
                place, end = rng.randrange(len(data)), rng.randrange(len(data) + 1)
                yield data[place:] + data[:end]


def _require(exchange: CodecExchange, rule: str, fulfilled: bool, data: bytes = b"", detail: object = "") -> None:
    if not fulfilled:
        raise CodecFault(exchange.name, rule, data, detail)


def _flips(data: bytes) -> Iterator[tuple[tuple[int, int], bytes]]:
    for place, byte in enumerate(data):
        for bit in range(8):
            yield (place, bit), data[:place] + bytes((byte ^ 1 << bit,)) + data[place + 1 :]


def _accepted_message(decode: Decode, data: bytes) -> Any:
    """Return the message that a decoder makes of these bytes, None where it makes none."""
    try:
        result = decode(data)
    except ProtocolError:
        return None
    return None if isinstance(result, Incomplete) else result.message


def _result(decode: Decode, data: bytes) -> object:
    try:
        return decode(data)
    except ProtocolError as error:
        return type(error), error.key


def _decode_bytewise(decode: Decode, data: bytes) -> object:
    """Return the first result other than Incomplete, with the bytes added one by one."""
    result: object = None
    for end in range(len(data) + 1):
        result = _result(decode, data[:end])
        if not isinstance(result, Incomplete | CompleteIfSilent):
            return result
    return result
