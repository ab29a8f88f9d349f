"""Raw words and quantities: the only place that scales one into the other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Coding = Literal["binary", "signed", "bcd"]


@dataclass(frozen=True, slots=True)
class Scale:
    """value = raw × factor + offset. ``decimals`` is how many places the drive's own display shows."""

    factor: float = 1.0
    offset: float = 0.0
    coding: Coding = "binary"
    decimals: int = 0

    def value(self, raw: int) -> float:
        """The quantity of a 16-bit word. Raises ValueError for a BCD word with a digit above 9."""
        return round(self._number(raw) * self.factor + self.offset, self.decimals + 3)

    def raw(self, value: float) -> int:
        """The nearest word. Raises ValueError where it does not fit 16 bits."""
        number = round((value - self.offset) / self.factor)
        if self.coding == "signed" and -0x8000 <= number < 0:
            number += 0x10000
        elif self.coding == "bcd" and 0 <= number <= 9999:
            return int(str(number), 16)
        if not 0 <= number <= (9999 if self.coding == "bcd" else 0xFFFF):
            raise ValueError(f"{value} does not fit a 16-bit word at a step of {self.factor}")
        return number

    def _number(self, raw: int) -> int:
        if self.coding == "signed" and raw >= 0x8000:
            return raw - 0x10000
        if self.coding == "bcd":
            digits = f"{raw:X}"
            if not digits.isdecimal():
                raise ValueError(f"word {raw:04X}H is no decimal number")
            return int(digits)
        return raw
