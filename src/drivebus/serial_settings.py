"""Serial format of a bus, timing of a station, and what both mean in seconds."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Literal

ANY_REPLY_LATENESS_S = 5.0  # no reply of any drive is later than this; each model has a limit of its own

Parity = Literal["N", "E", "O"]


@dataclass(frozen=True, slots=True)
class SerialSettings:
    """Baud rate and character format, e.g. 9600 8E1."""

    baud: int = 9600
    data_bits: int = 8
    parity: Parity = "N"
    stop_bits: int = 1

    def __post_init__(self) -> None:
        """Raises ValueError for a value out of range."""
        if not 50 <= self.baud <= 4_000_000:
            raise ValueError(f"baud {self.baud}: expected 50 to 4000000")
        if self.data_bits not in (7, 8) or self.parity not in ("N", "E", "O") or self.stop_bits not in (1, 2):
            raise ValueError(f"format {self.format}: expected 7 or 8 data bits, parity N, E or O, 1 or 2 stop bits")

    @classmethod
    def parse(cls, baud: int, format: str = "8N1") -> SerialSettings:
        """Parse a format such as ``8E1``. Raises ValueError with the text found and expected."""
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
        """Duration of one character in seconds."""
        return self.character_bits / self.baud

    def seconds(self, characters: float) -> float:
        """Return the duration of a number of characters, or of as much silence."""
        return characters * self.character_s

    def __str__(self) -> str:
        return f"{self.baud} {self.format}"


@dataclass(frozen=True, slots=True, kw_only=True)
class StationTiming:
    """Timing rules of a station. Seconds unless the name says characters."""

    gap_characters: float = 3.5
    """Silence before each of our frames, from the last byte received or our own computed last bit."""
    gap_floor_s: float = 0.0
    """The gap is never shorter than this (e.g. 1.75 ms above 19,200 baud for Modbus RTU)."""
    reply_delay_s: float = 0.1
    """Longest time from our last bit to the first byte of the reply, as the manual specifies it."""
    reply_delay_characters: float = 0.0
    """The same where the manual counts in characters (C320: 8); both are added."""
    adapter_latency_s: float = 0.02
    """Allowance for the adapter and the operating system."""
    turnaround_s: float = 0.1
    """Silence after a broadcast, which no station answers."""
    max_reply_lateness_s: float = 0.5
    """Quarantine after a timeout: the latest reply of this model, at most ``ANY_REPLY_LATENESS_S``."""
    tolerate_leading_noise: bool = False
    """Accept one stray byte before a reply (a driver-enable glitch), in Modbus ASCII a few."""

    def __post_init__(self) -> None:
        """Raises ValueError for a negative or infinite time: every frame of the bus would wait, stops too."""
        for name in self.__slots__:
            value = getattr(self, name)
            if not 0 <= value < inf:
                raise ValueError(f"timing {name} {value}: expected a finite number, 0 or more")

    def gap_s(self, settings: SerialSettings) -> float:
        """Return the silence before each of our frames."""
        return max(settings.seconds(self.gap_characters), self.gap_floor_s)

    def timeout_s(self, settings: SerialSettings, reply_bytes: int) -> float:
        """Return the time from our last bit to the last bit of the longest permitted reply."""
        return self.reply_delay_s + settings.seconds(self.reply_delay_characters + reply_bytes) + self.adapter_latency_s
