"""What decoding garbage costs on this machine, beside a bare loop over the same bytes."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from random import Random
from time import perf_counter

from verification.codec_fuzz.incremental_feed import DecodeFunction, decode_outcome
from verification.codec_fuzz.registry import FUZZED_CODECS, FuzzedCodec

GARBAGE_LENGTH = 256


def decode_costs(rng: Random) -> dict[str, dict[str, float]]:
    """For each codec, in microseconds: a byte of garbage of frame length; the worst 256 bytes of garbage, whole (also
    in bare loops over them) and fed one by one."""
    return {name: _codec_costs(rng, entry) for name, entry in FUZZED_CODECS.items()}


def garbage(rng: Random, entry: FuzzedCodec) -> list[bytes]:
    """256 bytes each: any, or beginning like a request or a reply, of any function, and then of the alphabet."""
    heads = [b"", bytes((1, 0x63)) if entry.codec.encoding == "rtu" else b":0163"]
    for _ in range(8):
        exchange = entry.make_exchange(rng, entry.codec)
        heads += [frame[:keep] for frame in (exchange.sent, exchange.received) for keep in (1, 2, 4, 8, len(frame) - 3)]
    return [(head + bytes(rng.choices(entry.alphabet, k=GARBAGE_LENGTH)))[:GARBAGE_LENGTH] for head in heads]


def decoders(rng: Random, entry: FuzzedCodec) -> tuple[DecodeFunction, DecodeFunction]:
    """Host and station."""
    return partial(entry.codec.decode_reply, entry.make_exchange(rng, entry.codec).request), entry.codec.decode_request


def _codec_costs(rng: Random, entry: FuzzedCodec) -> dict[str, float]:
    both, long = decoders(rng, entry), garbage(rng, entry)
    short = [rng.randbytes(rng.randrange(1, 40)) for _ in range(500)]
    mean = sum(_seconds(partial(decode_outcome, decode, data)) for decode in both for data in short) / sum(
        map(len, short)
    )
    worst = max(_seconds(partial(decode_outcome, decode, data)) for decode in both for data in long)
    bare = _seconds(partial(_bare_loop, long[0]))
    return {
        "us_per_byte": round(mean / len(both) * 1e6, 3),
        "worst_256_us": round(worst * 1e6, 1),
        "worst_256_in_loops": round(worst / bare, 1),
        "worst_256_one_by_one_us": round(max(_one_by_one(decode, data) for decode in both for data in long[:12]) * 1e6),
    }


def _one_by_one(decode: DecodeFunction, data: bytes) -> float:
    return sum(_seconds(partial(decode_outcome, decode, data[:end])) for end in range(1, len(data) + 1))


def _seconds(work: Callable[[], object]) -> float:
    """The best of five: the machine's own pauses are not the codec's."""
    best = float("inf")
    for _ in range(5):
        start = perf_counter()
        work()
        best = min(best, perf_counter() - start)
    return best


def _bare_loop(data: bytes) -> None:
    for byte in data:
        byte & 0x0F
