"""A conformance kit for codecs: whoever writes another protocol runs ``check_codec`` and knows.

It asks what ``message.Codec`` promises: canonical bytes, the same answer whole, byte by byte, glued and with trailing
noise, no flipped bit believed, honest sizes, and no exception but ``ProtocolError`` for any bytes. No protocol is
known here.
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
    """A codec breaks its promise: which exchange, which promise, which bytes."""

    def __init__(self, exchange: str, promise: str, data: bytes = b"", detail: object = "") -> None:
        self.exchange, self.promise, self.data = exchange, promise, data
        super().__init__(f"{exchange}: {promise} [{data.hex(' ').upper()}] {detail}".rstrip())


@dataclass(frozen=True, slots=True)
class CodecExchange:
    """A request and its reply, as messages and as bytes that somebody else proved (a manual, a peer)."""

    name: str
    request: Any
    sent: bytes
    reply: Any = None
    received: bytes = b""
    """Empty where nobody answers (a broadcast) or no frame of the reply is known."""
    is_normal_reply: bool = True
    """False where the reply is the station's refusal, whose size may differ from ``reply_size``."""


@dataclass(slots=True)
class CodecReport:
    """What was tried, and the flips that a protocol without a check cannot see."""

    checks: int = 0
    accepted_flips: dict[str, list[tuple[int, int]]] = field(default_factory=dict)
    """Exchange → (byte, bit) of each single flip in a reply that still was taken for a reply to its request."""


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
    """Try a codec against proven exchanges. Raises CodecFault at the first broken promise.

    ``heard`` takes the request out of what ``decode_request`` reports. ``detects_flips`` False is for protocols that
    have no check: flips that are believed are then reported instead of refused. ``junk_before`` is for codecs that
    were told to forgive leading junk. ``noise`` seeded frames of garbage are tried per direction and exchange.
    """
    report, trials = CodecReport(), _CodecChecks(codec, request_of, Random(seed), garbage_frames)
    exchanges = tuple(exchanges)
    for exchange in exchanges:
        report.checks += trials.sizes(exchange)
        report.checks += trials.request(exchange, allows_leading_noise, detects_flips)
        if exchange.received:
            report.checks += trials.reply(exchange, exchanges, allows_leading_noise)
            believed = trials.flips(exchange)
            report.checks += 8 * len(exchange.received)
            if believed and detects_flips:
                raise CodecFault(exchange.name, "a flipped bit is refused", exchange.received, believed)
            report.accepted_flips[exchange.name] = believed
    return report


class _CodecChecks:
    def __init__(self, codec: Codec, request_of: Callable[[Any], Any], rng: Random, noise: int) -> None:
        self.codec, self.request_of, self.rng, self.garbage_frames = codec, request_of, rng, noise

    def sizes(self, exchange: CodecExchange) -> int:
        codec, request = self.codec, exchange.request
        size, largest = codec.reply_size(request), codec.largest_reply(request)
        _require(exchange, "largest_reply is not below reply_size", largest >= size, detail=(size, largest))
        if codec.address_of(request) == codec.broadcast_address:
            _require(exchange, "reply_size of a broadcast is 0", size == 0, detail=size)
        if exchange.received and exchange.is_normal_reply:
            _require(exchange, "reply_size is the size of the reply", size == len(exchange.received), detail=size)
        _require(exchange, "largest_reply covers every reply", largest >= len(exchange.received), detail=largest)
        return 3

    def request(self, exchange: CodecExchange, junk_before: bool, detects_flips: bool) -> int:
        codec, data = self.codec, exchange.sent
        _require(
            exchange, "encode_request gives the proven bytes", codec.encode_request(exchange.request) == data, data
        )
        whole = self._whole(exchange, codec.decode_request, data)
        again = codec.encode_request(self.request_of(whole))
        _require(exchange, "a decoded request encodes to the same bytes", again == data, data, again)
        tried = self._chunks(exchange, codec.decode_request, data, whole, junk_before, (data,))
        for place, flipped in _flips(data):
            taken = _accepted_message(codec.decode_request, flipped)
            _require(exchange, "a flipped request is refused", taken is None or not detects_flips, flipped, place)
        return tried + 8 * len(data)

    def reply(self, exchange: CodecExchange, others: tuple[CodecExchange, ...], junk_before: bool) -> int:
        codec, data = self.codec, exchange.received

        def decode(data: bytes) -> DecodeResult:
            return codec.decode_reply(exchange.request, data)

        _require(exchange, "encode_reply gives the proven bytes", codec.encode_reply(exchange.reply) == data, data)
        whole = self._whole(exchange, decode, data)
        _require(exchange, "decode_reply gives the proven reply", whole == exchange.reply, data, whole)
        followers = tuple(other.received for other in others if other.received)
        return self._chunks(exchange, decode, data, whole, junk_before, followers)

    def flips(self, exchange: CodecExchange) -> list[tuple[int, int]]:
        def decode(data: bytes) -> DecodeResult:
            return self.codec.decode_reply(exchange.request, data)

        return [place for place, flipped in _flips(exchange.received) if _accepted_message(decode, flipped) is not None]

    def _whole(self, exchange: CodecExchange, decode: Decode, data: bytes) -> Any:
        verdict = decode(data)
        if isinstance(verdict, Incomplete):
            raise CodecFault(exchange.name, "a whole frame is complete", data, verdict)
        _require(exchange, "size is the frame's", verdict.size == len(data), data, verdict.size)
        return verdict.message

    def _chunks(
        self,
        exchange: CodecExchange,
        decode: Decode,
        data: bytes,
        whole: Any,
        junk_before: bool,
        followers: tuple[bytes, ...],
    ) -> int:
        for end in range(len(data)):
            verdict = decode(data[:end])
            _require(exchange, "a cut frame is not complete", not isinstance(verdict, Complete), data[:end], verdict)
            need = verdict.need if isinstance(verdict, Incomplete | CompleteIfSilent) else 0
            _require(exchange, "need is beyond what is there and within the frame", end < need <= len(data), data, need)
        tails = (*followers, *(bytes((byte,)) for byte in range(256)))
        for tail in tails:
            verdict = decode(data + tail)
            same = isinstance(verdict, Complete) and verdict.size == len(data) and verdict.message == whole
            alone = isinstance(decode(data), CompleteIfSilent)
            _require(exchange, "what follows a frame does not change it", same or alone, data + tail, verdict)
        if not junk_before:
            found = _accepted_message(decode, b"\xff" + data)
            _require(exchange, "a frame counts at offset 0 only", found is None, b"\xff" + data, found)
        return len(data) + len(tails) + self._garbage(exchange, decode, data)

    def _garbage(self, exchange: CodecExchange, decode: Decode, data: bytes) -> int:
        """Bytes of all kinds: alone ProtocolError may come, and whole is byte by byte."""
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


def _require(exchange: CodecExchange, promise: str, fulfilled: bool, data: bytes = b"", detail: object = "") -> None:
    if not fulfilled:
        raise CodecFault(exchange.name, promise, data, detail)


def _flips(data: bytes) -> Iterator[tuple[tuple[int, int], bytes]]:
    for place, byte in enumerate(data):
        for bit in range(8):
            yield (place, bit), data[:place] + bytes((byte ^ 1 << bit,)) + data[place + 1 :]


def _accepted_message(decode: Decode, data: bytes) -> Any:
    """The message that a decoder makes of these bytes, None where it makes none."""
    try:
        verdict = decode(data)
    except ProtocolError:
        return None
    return None if isinstance(verdict, Incomplete) else verdict.message


def _result(decode: Decode, data: bytes) -> object:
    try:
        return decode(data)
    except ProtocolError as error:
        return type(error), error.key


def _decode_bytewise(decode: Decode, data: bytes) -> object:
    """The first verdict that is more than Incomplete, with the bytes given as they are asked for and one by one."""
    outcome: object = None
    for end in range(len(data) + 1):
        outcome = _result(decode, data[:end])
        if not isinstance(outcome, Incomplete | CompleteIfSilent):
            return outcome
    return outcome
