"""Mutations of a reply on its way; each takes a random generator and a frame and returns another frame."""

from __future__ import annotations

from random import Random

DIGITS = b"0123456789ABCDEF"


def mostly(rng: Random, right: int, other: int) -> int:
    """Return ``right``, or ``other`` once in twelve times."""
    return other if rng.randrange(12) == 0 else right


def flip(rng: Random, frame: bytes, bits: int = 1) -> bytes:
    found = bytearray(frame)
    for _ in range(bits):
        found[rng.randrange(len(found))] ^= 1 << rng.randrange(8)
    return bytes(found)


def two_flips(rng: Random, frame: bytes) -> bytes:
    return flip(rng, frame, 2)


def swap_neighbours(rng: Random, frame: bytes) -> bytes:
    """Swap adjacent bytes, which no sum detects."""
    at = rng.randrange(len(frame) - 1)
    return frame[:at] + frame[at + 1 : at + 2] + frame[at : at + 1] + frame[at + 2 :]


def swap_any(rng: Random, frame: bytes) -> bytes:
    found = bytearray(frame)
    one, other = rng.randrange(len(found)), rng.randrange(len(found))
    found[one], found[other] = found[other], found[one]
    return bytes(found)


def another_digit(rng: Random, frame: bytes) -> bytes:
    at = rng.randrange(len(frame))
    return frame[:at] + bytes((rng.choice(DIGITS),)) + frame[at + 1 :]


def another_byte(rng: Random, frame: bytes) -> bytes:
    at = rng.randrange(len(frame))
    return frame[:at] + bytes((rng.randrange(256),)) + frame[at + 1 :]


def truncate(rng: Random, frame: bytes) -> bytes:
    return frame[: rng.randrange(len(frame))]


def extend(rng: Random, frame: bytes) -> bytes:
    return frame + rng.randbytes(rng.randint(1, 8))


def insert(rng: Random, frame: bytes) -> bytes:
    at = rng.randrange(len(frame))
    return frame[:at] + rng.randbytes(1) + frame[at:]


def drop(rng: Random, frame: bytes) -> bytes:
    at = rng.randrange(len(frame))
    return frame[:at] + frame[at + 1 :]


def lower_case(rng: Random, frame: bytes) -> bytes:
    """Replace A-F by a-f."""
    return frame[:1] + frame[1:].lower()


def noise(rng: Random, frame: bytes) -> bytes:
    return rng.randbytes(rng.choice((0, 1, 10, 11, 12, 17, 18, 19)))


ANY_FRAME = (
    flip,
    two_flips,
    swap_neighbours,
    swap_any,
    another_digit,
    another_byte,
    truncate,
    extend,
    insert,
    drop,
    lower_case,
    noise,
)
