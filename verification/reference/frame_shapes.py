"""Shapes of valid frames, byte by byte, from which the odds of accidental frames are computed.

Where the bytes of a field depend on each other, each by itself may have more values than they have together.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Bytes = frozenset[int]
CheckRule = Literal["none", "sum", "crc"]
ANY: Bytes = frozenset(range(256))
REMEMBERED_REQUESTS = 4096
"""Parsed requests that a reference codec remembers: long campaigns keep their memory."""


@dataclass(frozen=True, slots=True)
class FrameShape:
    """Kind of valid frame: the bytes allowed at each place, and the places of its checksum."""

    places: tuple[Bytes, ...]
    check: range
    check_rule: CheckRule = "sum"
    checksum_spellings: int = 1
    """Spellings of the checksum that fit one content."""
    byte_spellings: int = 1
    """Values of one byte that can fit when all other bytes are given, at most."""

    @property
    def size(self) -> int:
        return len(self.places)

    def matches(self, frame: bytes) -> bool:
        """Return whether every byte is allowed at its place; the checksum is not computed."""
        return len(frame) >= self.size and all(byte in place for byte, place in zip(frame, self.places, strict=False))


def literal_places(text: bytes) -> tuple[Bytes, ...]:
    """Return places that allow just these bytes."""
    return tuple(frozenset((byte,)) for byte in text)
