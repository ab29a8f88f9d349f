"""Frames that are not what they were: the kinds of damage that garbage, noise, echoes and collisions do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from random import Random

MAX_DAMAGED_LENGTH = 300
"""Now and then noise is this long."""


@dataclass(frozen=True, slots=True)
class DamageBase:
    """The frame that is damaged, and what may be glued to it."""

    frame: bytes
    other: bytes
    """A lawful frame of another exchange."""
    alphabet: bytes
    marks: int
    """So many bytes at its end stay."""
    seal: Callable[[bytes], bytes]


DamagedBytes = tuple[bytes, tuple[int, ...]]
"""The bytes, and the places where something was drawn by chance, if the odds of that are to be reckoned."""


def noise(rng: Random, base: DamageBase) -> DamagedBytes:
    """Any bytes: half of them as many as the frame has."""
    size = len(base.frame) if rng.random() < 0.5 else rng.randrange(MAX_DAMAGED_LENGTH if rng.random() < 0.02 else 48)
    return rng.randbytes(size), ()


def garbled(rng: Random, base: DamageBase) -> DamagedBytes:
    """The frame up to some byte, and then what comes by chance from the codec's alphabet: two stations at once."""
    end = len(base.frame) - base.marks
    start = rng.randrange(1, end)
    tail = bytes(rng.choices(base.alphabet, k=end - start))
    return base.frame[:start] + tail + base.frame[end:], (start,)


def substituted(rng: Random, base: DamageBase) -> DamagedBytes:
    """One to three bytes are others."""
    frame, places = bytearray(base.frame), rng.sample(range(len(base.frame)), rng.randint(1, 3))
    for place in places:
        frame[place] ^= rng.randint(1, 255)
    return bytes(frame), tuple(sorted(places))


def flipped(rng: Random, base: DamageBase) -> DamagedBytes:
    """One to four bits are others."""
    frame = bytearray(base.frame)
    for bit in rng.sample(range(8 * len(frame)), rng.randint(1, 4)):
        frame[bit >> 3] ^= 1 << (bit & 7)
    return bytes(frame), ()


def shifted(rng: Random, base: DamageBase) -> DamagedBytes:
    """Two neighbours swapped, a byte lost, doubled or put in, the end cut off."""
    frame, place = base.frame, rng.randrange(len(base.frame) - 1)
    one, two = frame[place : place + 1], frame[place + 1 : place + 2]
    put = rng.choice((two + one, two, one + one + two, one + rng.randbytes(1) + two, b""))
    return frame[:place] + put + (frame[place + 2 :] if put else b""), ()


def concatenated(rng: Random, base: DamageBase) -> DamagedBytes:
    """Frames and pieces of frames without a gap, or with junk around them."""
    frame, other, junk = base.frame, base.other, rng.randbytes(rng.randint(1, 5))
    cut, place = rng.randrange(len(frame)), rng.randrange(len(other))
    return rng.choice(
        (frame + other, other + frame, frame[:cut] + other[place:], frame[cut:] + other, junk + frame, frame + junk)
    ), ()


def resealed(rng: Random, base: DamageBase) -> DamagedBytes:
    """Some bytes are others, out of the alphabet or not, and the check is right again."""
    frame = bytearray(base.frame)
    for _ in range(rng.randint(1, 2)):
        source = base.alphabet if rng.random() < 0.8 else range(256)
        frame[rng.randrange(len(frame))] = rng.choice(source)
    return base.seal(bytes(frame)), ()


def foreign(rng: Random, base: DamageBase) -> DamagedBytes:
    """A lawful frame, but of another exchange."""
    return base.other, ()


DAMAGE_KINDS: dict[str, Callable[[Random, DamageBase], DamagedBytes]] = {
    kind.__name__: kind for kind in (noise, garbled, substituted, flipped, shifted, concatenated, resealed, foreign)
}
DAMAGE_WEIGHTS = (6, 4, 5, 3, 3, 3, 3, 1)
