"""Block of the campaign ``fuzz``: frames are damaged, fed to a codec and compared with its reference.

A block is a function of seed, codec and number.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from hashlib import sha256
from random import Random
from typing import Any

from drivebus.errors import ProtocolError
from drivebus.protocols.codec import Complete, CompleteIfSilent, DecodeResult, Incomplete
from verification.codec_fuzz.collision_odds import CollisionOdds, noise_odds
from verification.codec_fuzz.fuzzed_codec import FuzzedCodec, ValidExchange
from verification.families.campaigns import FUZZED_CODECS
from verification.reference.frame_shapes import FrameShape

# --- kinds of damage --------------------------------------------------------------------------------------------------

MAX_DAMAGED_LENGTH = 300
"""Largest length of noise, in bytes."""


@dataclass(frozen=True, slots=True)
class DamageBase:
    """Frame to damage, and the frame that may be joined to it."""

    frame: bytes
    other: bytes
    """Valid frame of another exchange."""
    alphabet: bytes
    marks: int
    """Number of bytes at the end that are not damaged."""
    seal: Callable[[bytes], bytes]


DamagedBytes = tuple[bytes, tuple[int, ...]]
"""Damaged bytes, and their random places where the odds are computed."""


def noise(rng: Random, base: DamageBase) -> DamagedBytes:
    """Return random bytes, half of them of the frame's length."""
    size = len(base.frame) if rng.random() < 0.5 else rng.randrange(MAX_DAMAGED_LENGTH if rng.random() < 0.02 else 48)
    return rng.randbytes(size), ()


def garbled(rng: Random, base: DamageBase) -> DamagedBytes:
    """Return the frame with a random end from the codec's alphabet, as after a collision."""
    end = len(base.frame) - base.marks
    start = rng.randrange(1, end)
    tail = bytes(rng.choices(base.alphabet, k=end - start))
    return base.frame[:start] + tail + base.frame[end:], (start,)


def substituted(rng: Random, base: DamageBase) -> DamagedBytes:
    """Replace one to three bytes."""
    frame, places = bytearray(base.frame), rng.sample(range(len(base.frame)), rng.randint(1, 3))
    for place in places:
        frame[place] ^= rng.randint(1, 255)
    return bytes(frame), tuple(sorted(places))


def flipped(rng: Random, base: DamageBase) -> DamagedBytes:
    """Flip one to four bits."""
    frame = bytearray(base.frame)
    for bit in rng.sample(range(8 * len(frame)), rng.randint(1, 4)):
        frame[bit >> 3] ^= 1 << (bit & 7)
    return bytes(frame), ()


def shifted(rng: Random, base: DamageBase) -> DamagedBytes:
    """Swap two neighbours, lose, double or insert a byte, or cut off the end."""
    frame, place = base.frame, rng.randrange(len(base.frame) - 1)
    one, two = frame[place : place + 1], frame[place + 1 : place + 2]
    put = rng.choice((two + one, two, one + one + two, one + rng.randbytes(1) + two, b""))
    return frame[:place] + put + (frame[place + 2 :] if put else b""), ()


def concatenated(rng: Random, base: DamageBase) -> DamagedBytes:
    """Join frames and parts of frames without a gap, or add junk."""
    frame, other, junk = base.frame, base.other, rng.randbytes(rng.randint(1, 5))
    cut, place = rng.randrange(len(frame)), rng.randrange(len(other))
    return rng.choice(
        (frame + other, other + frame, frame[:cut] + other[place:], frame[cut:] + other, junk + frame, frame + junk)
    ), ()


def resealed(rng: Random, base: DamageBase) -> DamagedBytes:
    """Replace some bytes and correct the check."""
    frame = bytearray(base.frame)
    for _ in range(rng.randint(1, 2)):
        source = base.alphabet if rng.random() < 0.8 else range(256)
        frame[rng.randrange(len(frame))] = rng.choice(source)
    return base.seal(bytes(frame)), ()


def foreign(rng: Random, base: DamageBase) -> DamagedBytes:
    """Return a valid frame of another exchange."""
    return base.other, ()


DAMAGE_KINDS: dict[str, Callable[[Random, DamageBase], DamagedBytes]] = {
    kind.__name__: kind for kind in (noise, garbled, substituted, flipped, shifted, concatenated, resealed, foreign)
}
DAMAGE_WEIGHTS = (6, 4, 5, 3, 3, 3, 3, 1)


# --- feeding a decoder ------------------------------------------------------------------------------------------------

DecodeFunction = Callable[[bytes], DecodeResult]


@dataclass(frozen=True, slots=True)
class RefusedBytes:
    """Protocol error as a value."""

    kind: str
    key: str
    params: dict[str, Any]
    size: int


DecodeOutcome = DecodeResult | RefusedBytes


def decode_outcome(decode: DecodeFunction, data: bytes) -> DecodeOutcome:
    """Return the decoder's result, with a protocol error as a value; other exceptions escape (I8)."""
    try:
        return decode(data)
    except ProtocolError as error:
        return RefusedBytes(type(error).__name__, error.key, error.params, error.size)


def feed_incrementally(decode: DecodeFunction, data: bytes, cut: float, longest: int) -> tuple[DecodeOutcome, str]:
    """Return the result for all bytes, and the first inconsistency ("" if none).

    Every prefix up to the first final result is decoded, then the prefix that ``need`` asks for and a random one
    (``cut``, 0 to 1). ``longest``: largest number of bytes that may be needed.
    """
    whole, end, need, needed_at = None, 0, 0, 0
    total = len(data)
    for end in range(total + 1):
        found = decode_outcome(decode, data[:end])
        if isinstance(found, Incomplete):
            if not (end < found.need <= longest and need <= found.need):
                return found, f"need {found.need} at {end} bytes, {need} before"
        elif not isinstance(found, CompleteIfSilent) or end == total:
            whole = found
            break
        elif found.need <= end or found.size > end:
            return found, f"{found} at {end} bytes"
        if end >= needed_at:
            needed_at = found.need
        need = found.need
    else:
        return found, ""
    if isinstance(whole, Complete) and (end < need or whole.size > end):
        return whole, f"{whole} at {end} bytes, {need} needed"
    for place in {total, max(end, min(total, needed_at)), end + int(cut * (total - end))} - {end}:
        again = decode_outcome(decode, data[:place])
        if again != whole:
            return whole, f"{place} bytes: {again}; {end} bytes: {whole}"
    return whole, ""


def accepted_size(what: DecodeOutcome, data: bytes) -> int | None:
    """Return how many of these bytes are the message if nothing follows; None where they are no message."""
    if isinstance(what, Complete) or (isinstance(what, CompleteIfSilent) and what.size == len(data)):
        return what.size
    return None


# --- blocks -----------------------------------------------------------------------------------------------------------

BLOCK_BYTES = 200_000
"""Bytes of one block."""
EXCHANGES_PER_BLOCK = 48
"""Exchanges whose frames one block damages."""
CHANCE_DAMAGE_KINDS = ("noise", "garbled", "substituted")
"""Kinds of damage with known odds; other accepted frames are valid by the reference or violations."""


@dataclass(slots=True, kw_only=True)
class FuzzResult:
    """Result of one or more blocks of a codec."""

    bytes: int = 0
    frames: Counter[str] = field(default_factory=Counter)
    """Number of frames, by kind of damage."""
    outcomes: Counter[str] = field(default_factory=Counter)
    """Number of results, by result or error."""
    accepted: Counter[str] = field(default_factory=Counter)
    """Number of accepted frames other than the original, by kind of damage."""
    expected: dict[str, float] = field(default_factory=lambda: dict.fromkeys(CHANCE_DAMAGE_KINDS, 0.0))
    """Upper bound of the expected number of accepted frames."""
    lines: list[str] = field(default_factory=list)
    violations: list[str] = field(default_factory=list)

    def add(self, other: FuzzResult) -> None:
        """Add another block's counts, without its lines and violations."""
        self.bytes += other.bytes
        self.frames.update(other.frames)
        self.outcomes.update(other.outcomes)
        self.accepted.update(other.accepted)
        for kind, probability in other.expected.items():
            self.expected[kind] += probability


@dataclass(frozen=True, slots=True)
class FuzzTarget:
    """Side of an exchange."""

    decode: DecodeFunction
    sent: bytes
    """Bytes of the answered request; empty at a station."""
    frame: bytes
    odds: CollisionOdds
    noise: tuple[tuple[int, float], ...]


@cache
def _station_noise(name: str) -> tuple[tuple[int, float], ...]:
    return noise_odds(FUZZED_CODECS[name].forms(b""))


def fuzz_targets(entry: FuzzedCodec, exchange: ValidExchange) -> tuple[FuzzTarget, FuzzTarget]:
    """Return the master's side and the station's side of an exchange."""

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


def run_block(entry: FuzzedCodec, rng: Random, size: int = BLOCK_BYTES) -> FuzzResult:
    """Decode damaged frames until ``size`` bytes are used."""
    found = FuzzResult()
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
    """Return an upper bound of the probability that this damage makes another valid frame."""
    if kind == "garbled":
        return target.odds.garbled(places[0])
    if kind == "substituted":
        return target.odds.substituted(tuple(places))
    shifts = 1 + getattr(entry.reference, "resync", 0)
    return shifts * sum(probability for size, probability in target.noise if size <= len(data))


def _try_frame(entry: FuzzedCodec, target: FuzzTarget, kind: str, data: bytes, cut: float, found: FuzzResult) -> bytes:
    """Decode one frame and compare it with the reference; return the result for the digest."""
    try:
        what, wrong = feed_incrementally(target.decode, data, cut, entry.longest)
    except Exception as error:
        found.violations.append(f"I8 {_describe(entry, target, kind, data)}: {type(error).__name__}: {error}")
        return b"escaped"
    if wrong:
        found.violations.append(f"feed: {_describe(entry, target, kind, data)}: {wrong}")
    size = accepted_size(what, data)
    reference_size = entry.reference.accepted_size(target.sent, data)
    if size != reference_size:
        found.violations.append(
            f"reference: {_describe(entry, target, kind, data)}: "
            f"codec accepts {size}, reference {reference_size}; {what}"
        )
    name = what.kind if isinstance(what, RefusedBytes) else type(what).__name__
    found.outcomes[name] += 1
    if size is not None:
        _on_accepted(entry, target, kind, data, what, size, found)
    return name.encode() + data


def _on_accepted(
    entry: FuzzedCodec, target: FuzzTarget, kind: str, data: bytes, what: DecodeOutcome, size: int, found: FuzzResult
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
