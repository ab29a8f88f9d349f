"""The shape of lawful frames, byte by byte: what chance must hit.

Where the bytes of a field depend on each other, each by itself may be more than they are together.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Bytes = frozenset[int]
Check = Literal["none", "sum", "crc"]
ANY: Bytes = frozenset(range(256))


@dataclass(frozen=True, slots=True)
class FrameShape:
    """One kind of lawful frame: the bytes that may stand at each place, and where its check stands."""

    places: tuple[Bytes, ...]
    check: range
    """Places of the check."""
    check_rule: Check = "sum"
    checksum_spellings: int = 1
    """So many spellings of the check fit one content."""
    byte_spellings: int = 1
    """With all other bytes given, so many values of one byte can fit at most."""

    @property
    def size(self) -> int:
        return len(self.places)

    def matches(self, frame: bytes) -> bool:
        """Every byte is one that may stand there; the check is not looked at."""
        return len(frame) >= self.size and all(byte in place for byte, place in zip(frame, self.places, strict=False))


def literal_places(text: bytes) -> tuple[Bytes, ...]:
    """Places where just these bytes may stand."""
    return tuple(frozenset((byte,)) for byte in text)
