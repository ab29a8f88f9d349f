"""One block of garbage for one codec: drawn, fed, judged, counted. A block is a function of seed, codec and number."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from hashlib import sha256
from random import Random

from verification.codec_fuzz.collision_odds import CollisionOdds, noise_odds
from verification.codec_fuzz.exchanges import LawfulExchange
from verification.codec_fuzz.frame_damage import DAMAGE_KINDS, DAMAGE_WEIGHTS, DamageBase
from verification.codec_fuzz.incremental_feed import (
    DecodeFunction,
    DecodeOutcome,
    RefusedBytes,
    accepted_size,
    feed_incrementally,
)
from verification.codec_fuzz.registry import FUZZED_CODECS, FuzzedCodec
from verification.reference.frame_shapes import FrameShape

BLOCK_BYTES = 200_000
"""Bytes of a block."""
EXCHANGES_PER_BLOCK = 48
"""Exchanges whose frames one block damages."""
CHANCE_DAMAGE_KINDS = ("noise", "garbled", "substituted")
"""Kinds of damage whose odds are known; what the others bring through is lawful by the judge or a violation."""


@dataclass(slots=True)
class BlockResult:
    """What one or more blocks of a codec came to."""

    bytes: int = 0
    frames: Counter[str] = field(default_factory=Counter)
    """By kind of damage."""
    outcomes: Counter[str] = field(default_factory=Counter)
    """By verdict or error."""
    accepted: Counter[str] = field(default_factory=Counter)
    """By kind of damage: taken, and not the frame that had been damaged."""
    expected: dict[str, float] = field(default_factory=lambda: dict.fromkeys(CHANCE_DAMAGE_KINDS, 0.0))
    """So many of them chance alone would bring, at most."""
    lines: list[str] = field(default_factory=list)
    violations: list[str] = field(default_factory=list)

    def add(self, other: BlockResult) -> None:
        """Take another block's numbers; its lines and violations are the caller's to tell."""
        self.bytes += other.bytes
        self.frames.update(other.frames)
        self.outcomes.update(other.outcomes)
        self.accepted.update(other.accepted)
        for kind, chance in other.expected.items():
            self.expected[kind] += chance


@dataclass(frozen=True, slots=True)
class FuzzTarget:
    """One side of one exchange, as it is tried."""

    decode: DecodeFunction
    sent: bytes
    """Of the request that is answered; empty at a station."""
    frame: bytes
    odds: CollisionOdds
    noise: tuple[tuple[int, float], ...]


@cache
def _station_noise(name: str) -> tuple[tuple[int, float], ...]:
    return noise_odds(FUZZED_CODECS[name].forms(b""))


def fuzz_targets(entry: FuzzedCodec, exchange: LawfulExchange) -> tuple[FuzzTarget, FuzzTarget]:
    """The host's side and the station's."""

    def odds(frame: bytes, forms: tuple[FrameShape, ...]) -> CollisionOdds:
        return CollisionOdds(frame, forms, entry.alphabet, entry.reference.marks)

    replies, requests = entry.forms(exchange.sent), entry.forms(b"")
    host = partial(entry.codec.decode_reply, exchange.request)
    return (
        FuzzTarget(host, exchange.sent, exchange.received, odds(exchange.received, replies), noise_odds(replies)),
        FuzzTarget(
            entry.codec.decode_request, b"", exchange.sent, odds(exchange.sent, requests), _station_noise(entry.name)
        ),
    )


def run_block(entry: FuzzedCodec, rng: Random, size: int = BLOCK_BYTES) -> BlockResult:
    """Damaged frames until ``size`` bytes are used, each byte counted once however often it is fed."""
    found = BlockResult()
    pool = [fuzz_targets(entry, entry.exchange(rng)) for _ in range(EXCHANGES_PER_BLOCK)]
    kinds, digest = list(DAMAGE_KINDS), sha256()
    while found.bytes < size:
        side = rng.random() > 2 / 3
        target, other = (
            pool[rng.randrange(EXCHANGES_PER_BLOCK)][side],
            pool[rng.randrange(EXCHANGES_PER_BLOCK)][rng.random() > 0.7],
        )
        kind = rng.choices(kinds, DAMAGE_WEIGHTS)[0]
        base = DamageBase(target.frame, other.frame, entry.alphabet, entry.reference.marks, entry.reference.reseal)
        data, places = DAMAGE_KINDS[kind](rng, base)
        found.bytes += len(data)
        found.frames[kind] += 1
        if kind in CHANCE_DAMAGE_KINDS:
            found.expected[kind] += false_accept_probability(entry, target, kind, data, places)
        digest.update(_try_frame(entry, target, kind, data, rng.random(), found))
    totals = f"{sum(found.frames.values())} frames {found.bytes} bytes {sum(found.accepted.values())} taken"
    found.lines.append(f"{totals} {digest.hexdigest()[:16]}")
    return found


def false_accept_probability(
    entry: FuzzedCodec, target: FuzzTarget, kind: str, data: bytes, places: Sequence[int]
) -> float:
    """The probability, at most, that damage of this kind makes another frame that is lawful."""
    if kind == "garbled":
        return target.odds.garbled(places[0])
    if kind == "substituted":
        return target.odds.substituted(tuple(places))
    shifts = 1 + getattr(entry.reference, "resync", 0)
    return shifts * sum(chance for size, chance in target.noise if size <= len(data))


def _try_frame(entry: FuzzedCodec, target: FuzzTarget, kind: str, data: bytes, cut: float, found: BlockResult) -> bytes:
    """Feed and judge one frame; what came of it, for the digest."""
    try:
        what, wrong = feed_incrementally(target.decode, data, cut, entry.longest)
    except Exception as error:
        found.violations.append(f"I8 {_describe(entry, target, kind, data)}: {type(error).__name__}: {error}")
        return b"escaped"
    if wrong:
        found.violations.append(f"G01 {_describe(entry, target, kind, data)}: {wrong}")
    size = accepted_size(what, data)
    lawful = entry.reference.accepted_size(target.sent, data)
    if size != lawful:
        found.violations.append(
            f"G02 {_describe(entry, target, kind, data)}: codec takes {size}, judge {lawful}; {what}"
        )
    name = what.kind if isinstance(what, RefusedBytes) else type(what).__name__
    found.outcomes[name] += 1
    if size is not None:
        _on_accepted(entry, target, kind, data, what, size, found)
    return name.encode() + data


def _on_accepted(
    entry: FuzzedCodec, target: FuzzTarget, kind: str, data: bytes, what: DecodeOutcome, size: int, found: BlockResult
) -> None:
    if target.sent:
        try:
            entry.interpret(what.message)  # type: ignore[union-attr]
        except Exception as error:
            found.violations.append(f"I8 {_describe(entry, target, kind, data)}: {type(error).__name__}: {error}")
    if data[:size] == target.frame[: len(data)]:
        return
    found.accepted[kind] += 1
    if kind in CHANCE_DAMAGE_KINDS:
        found.lines.append(f"taken {_describe(entry, target, kind, data)}: {size}")


def _describe(entry: FuzzedCodec, target: FuzzTarget, kind: str, data: bytes) -> str:
    side = f"reply to {target.sent.hex(' ')}" if target.sent else "request"
    return f"{entry.name} {side}: {kind} {data.hex(' ')}"
