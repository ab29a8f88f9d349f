"""What decoding garbage costs on this machine, beside a bare loop over the same bytes (G02)."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from random import Random
from time import perf_counter

from drivebus.lab.codecs.feed import Decode, outcome
from drivebus.lab.codecs.roster import ROSTER, Entry

LONG = 256


def figures(rng: Random) -> dict[str, dict[str, float]]:
    """For each codec, in microseconds: a byte of garbage of frame length; the worst 256 bytes of garbage, whole (also
    in bare loops over them) and fed one by one."""
    return {name: _figures(rng, entry) for name, entry in ROSTER.items()}


def garbage(rng: Random, entry: Entry) -> list[bytes]:
    """256 bytes each: any, or beginning like a request or a reply, of any function, and then of the alphabet."""
    heads = [b"", bytes((1, 0x63)) if entry.codec.encoding == "rtu" else b":0163"]
    for _ in range(8):
        exchange = entry.talk(rng, entry.codec)
        heads += [frame[:keep] for frame in (exchange.sent, exchange.received) for keep in (1, 2, 4, 8, len(frame) - 3)]
    return [(head + bytes(rng.choices(entry.alphabet, k=LONG)))[:LONG] for head in heads]


def sides(rng: Random, entry: Entry) -> tuple[Decode, Decode]:
    """Host and station."""
    return partial(entry.codec.decode_reply, entry.talk(rng, entry.codec).request), entry.codec.decode_request


def _figures(rng: Random, entry: Entry) -> dict[str, float]:
    decoders, long = sides(rng, entry), garbage(rng, entry)
    short = [rng.randbytes(rng.randrange(1, 40)) for _ in range(500)]
    mean = sum(_seconds(partial(outcome, decode, data)) for decode in decoders for data in short) / sum(map(len, short))
    worst = max(_seconds(partial(outcome, decode, data)) for decode in decoders for data in long)
    bare = _seconds(partial(_loop, long[0]))
    return {
        "us_per_byte": round(mean / len(decoders) * 1e6, 3),
        "worst_256_us": round(worst * 1e6, 1),
        "worst_256_in_loops": round(worst / bare, 1),
        "worst_256_one_by_one_us": round(
            max(_one_by_one(decode, data) for decode in decoders for data in long[:12]) * 1e6
        ),
    }


def _one_by_one(decode: Decode, data: bytes) -> float:
    return sum(_seconds(partial(outcome, decode, data[:end])) for end in range(1, len(data) + 1))


def _seconds(work: Callable[[], object]) -> float:
    """The best of five: the machine's own pauses are not the codec's."""
    best = float("inf")
    for _ in range(5):
        start = perf_counter()
        work()
        best = min(best, perf_counter() - start)
    return best


def _loop(data: bytes) -> None:
    for byte in data:
        byte & 0x0F
