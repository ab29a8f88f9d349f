"""Line arithmetic: what baud rate and character format mean in seconds. No clock lives here."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Parity = Literal["N", "E", "O"]


@dataclass(frozen=True, slots=True)
class SerialSettings:
    """Baud rate and character format of one RS485 line, e.g. 9600 8E1."""

    baud: int = 9600
    data_bits: int = 8
    parity: Parity = "N"
    stop_bits: int = 1

    def __post_init__(self) -> None:
        if not 50 <= self.baud <= 4_000_000:
            raise ValueError(f"baud {self.baud}: expected 50 to 4000000")
        if self.data_bits not in (7, 8) or self.parity not in ("N", "E", "O") or self.stop_bits not in (1, 2):
            raise ValueError(f"format {self.format}: expected 7 or 8 data bits, parity N, E or O, 1 or 2 stop bits")

    @classmethod
    def parse(cls, baud: int, format: str = "8N1") -> SerialSettings:
        """Read a format such as ``8E1``. Raises ValueError with what was found and expected."""
        text = format.strip().upper()
        if len(text) != 3 or text[0] not in "78" or text[1] not in "NEO" or text[2] not in "12":
            raise ValueError(f"format {format!r}: expected data bits, parity and stop bits such as 8N1 or 8E1")
        parity: Parity = "N" if text[1] == "N" else "E" if text[1] == "E" else "O"
        return cls(baud, int(text[0]), parity, int(text[2]))

    @property
    def format(self) -> str:
        """Data bits, parity, stop bits, such as ``8E1``."""
        return f"{self.data_bits}{self.parity}{self.stop_bits}"

    @property
    def character_bits(self) -> int:
        """Bits of a character on the wire: start, data, parity, stop (10 at 8N1, 11 at 8E1)."""
        return 1 + self.data_bits + (self.parity != "N") + self.stop_bits

    @property
    def character_s(self) -> float:
        """Seconds that one character takes."""
        return self.character_bits / self.baud

    def seconds(self, characters: float) -> float:
        """Seconds that so many characters (or so much silence) take."""
        return characters * self.character_s

    def __str__(self) -> str:
        return f"{self.baud} {self.format}"
