"""How many flipped bits the check of each family lets through, with and without what the host expects besides.

"check": end mark, digits and check sum are right, whatever the fields say. "echo": besides, it is the reply to the one
request outstanding: address, function or class, item, register or count, known codes. "parity": a ninth bit of each
character is checked too, so that only patterns with an even number of flips in every character pass: none of one or
three, few of two and four.
The judges decide, on the frames named; campaigns hold the codecs to them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import combinations
from math import comb

from verification.codec_fuzz.registry import FUZZED_CODECS

FlipMask = tuple[tuple[int, int], ...]
"""(byte, bits of it that are flipped)."""


@dataclass(frozen=True, slots=True)
class StrengthCase:
    """One read or write answer, and the request it answers."""

    name: str
    codec: str
    sent: str
    frame: str


STRENGTH_CASES = (
    StrengthCase("Modbus RTU, 03, one register", "modbus-rtu", "01 03 30 01 00 01 DA CA", "01 03 02 13 88 B5 12"),
    StrengthCase("Modbus RTU, 06", "modbus-rtu", "01 06 00 02 0B B8 2F 48", "01 06 00 02 0B B8 2F 48"),
    StrengthCase(
        "Modbus ASCII, 03, one register",
        "df800-ascii",
        "3A 30 31 30 33 32 30 30 30 30 30 30 31 44 42 0D 0A",
        "3A 30 31 30 33 30 32 30 31 32 30 44 39 0D 0A",
    ),
    StrengthCase(
        "Modbus ASCII, 06",
        "df800-ascii",
        "3A 30 31 30 36 32 30 30 31 31 33 38 38 33 44 0D 0A",
        "3A 30 31 30 36 32 30 30 31 31 33 38 38 33 44 0D 0A",
    ),
    StrengthCase(
        "C320 ASCII",
        "c320-ascii",
        "2A 30 30 31 30 30 30 30 30 30 31 38 31 0D",
        "2A 30 30 30 30 31 30 30 30 30 33 45 37 30 32 36 30 0D",
    ),
    StrengthCase(
        "C320 hex",
        "c320-hex",
        "5A 00 00 01 00 00 00 00 00 00 00 00 01 0D",
        "5A 00 00 00 00 01 00 00 00 00 00 03 E7 00 00 00 EB 0D",
    ),
    StrengthCase("DZB100", "dzb100", "52 03 01 30 33 32 33 30 30 30 30", "52 03 06 30 33 32 33 30 30 36 34"),
)


def undetected_shares(most: int) -> dict[str, dict[str, object]]:
    """For each row the undetected share of all patterns of 1 … ``most`` flipped bits, and with parity of 2 and 4."""
    return {row.name: _case_shares(row, most) for row in STRENGTH_CASES}


def _case_shares(row: StrengthCase, most: int) -> dict[str, object]:
    sent, frame = bytes.fromhex(row.sent), bytes.fromhex(row.frame)
    judge = FUZZED_CODECS[row.codec].reference
    tests: dict[str, Callable[[bytes], bool]] = {
        "check": judge.is_well_formed,
        "echo": lambda data: judge.accepted_size(sent, data) == len(frame),
    }
    found: dict[str, object] = {"frame": row.frame, "request": row.sent, "acceptor": row.codec}
    for name, test in tests.items():
        for bits in range(1, most + 1):
            passed = sum(test(_flipped(frame, mask)) for mask in _flip_patterns(frame, bits))
            found[f"{name}_{bits}_bit"] = _share(passed, comb(8 * len(frame), bits))
        for bits in (2, 4)[: most - 1]:
            passed = sum(test(_flipped(frame, mask)) for mask in _parity_preserving_patterns(frame, bits))
            found[f"{name}_{bits}_bit_parity"] = _share(passed, comb(9 * len(frame), bits))
    return found


def _share(passed: int, tried: int) -> dict[str, float]:
    return {"passed": passed, "tried": tried, "share": float(f"{passed / tried:.3g}")}


def _flipped(frame: bytes, mask: FlipMask) -> bytes:
    damaged = bytearray(frame)
    for place, bits in mask:
        damaged[place] ^= bits
    return bytes(damaged)


def _flip_patterns(frame: bytes, bits: int) -> Iterator[FlipMask]:
    """Every pattern of so many flips in the data bits."""
    for places in combinations(range(8 * len(frame)), bits):
        yield tuple((place >> 3, 1 << (place & 7)) for place in places)


def _parity_preserving_patterns(frame: bytes, bits: int) -> Iterator[FlipMask]:
    """Every pattern of so many flips of which each character, its parity bit among them, has an even number."""
    if bits == 2:
        yield from (((place, mask),) for place in range(len(frame)) for mask in _character_patterns(2))
        return
    yield from (((place, mask),) for place in range(len(frame)) for mask in _character_patterns(4))
    for one, two in combinations(range(len(frame)), 2):
        yield from (
            ((one, first), (two, second)) for first in _character_patterns(2) for second in _character_patterns(2)
        )


def _character_patterns(bits: int) -> tuple[int, ...]:
    """What so many flips of eight bits and parity do to the eight."""
    return tuple(sum(1 << place for place in places) & 255 for places in combinations(range(9), bits))
