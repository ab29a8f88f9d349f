"""What a word of data may mean: frequencies in four codings (T08), and the state word of Q03."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from drivebus.errors import CodeError
from drivebus.protocols.dzb100.messages import Dzb100Command

FrequencyCoding = Literal["hex-0.1", "hex-0.01", "decimal-0.1", "hex-1"]
FaultCoding = Literal["decimal", "hex"]
LAST_FAULT_CODE = 20


@dataclass(frozen=True, slots=True)
class StateWord:
    """Q03, digits ABCD: the command that was last given, drive state bits (not published), fault code 0-20."""

    command: int
    state: int
    fault_code: int

    @classmethod
    def parse(cls, data: int, fault_coding: FaultCoding = "decimal") -> StateWord:
        """Raises CodeError for a command above 8 or a fault code that the manual does not list."""
        command, state, fault = data >> 12, data >> 8 & 0x0F, data & 0xFF
        if command > Dzb100Command.RESET:
            raise CodeError("protocols.dzb.command_digit", expected=int(Dzb100Command.RESET), found=command)
        digits = f"{fault:02X}"
        if fault_coding == "decimal" and not digits.isdecimal():
            raise CodeError("protocols.dzb.fault_digits", expected="00-20", found=digits)
        code = int(digits) if fault_coding == "decimal" else fault
        if code > LAST_FAULT_CODE:
            raise CodeError("protocols.dzb.fault_code", expected=LAST_FAULT_CODE, found=code)
        return cls(command, state, code)

    def encode(self, fault_coding: FaultCoding = "decimal") -> int:
        """The 16 bits that a drive sends."""
        fault = int(str(self.fault_code), 16) if fault_coding == "decimal" else self.fault_code
        return self.command << 12 | self.state << 8 | fault


_STEPS_PER_HZ: dict[FrequencyCoding, int] = {"hex-0.1": 10, "hex-0.01": 100, "decimal-0.1": 10, "hex-1": 1}
"""Words per hertz."""
FREQUENCY_CODINGS: tuple[FrequencyCoding, ...] = ("hex-0.1", "hex-0.01", "decimal-0.1", "hex-1")


def encode_frequency(hz: float, coding: FrequencyCoding) -> int:
    """The word for a frequency, rounded to the coding's step. Raises ValueError where it does not fit four digits."""
    limit = 9999 if coding == "decimal-0.1" else 0xFFFF
    words = hz * _STEPS_PER_HZ[coding]
    if not 0 <= words <= limit:
        raise ValueError(f"{hz} Hz does not fit a word of coding {coding}")
    return int(str(round(words)), 16) if coding == "decimal-0.1" else round(words)


def decode_frequency(word: int, coding: FrequencyCoding) -> float:
    """Hertz of a word. Raises ValueError for a word that is no decimal number under decimal-0.1."""
    digits = f"{word:X}"
    if coding == "decimal-0.1" and not digits.isdecimal():
        raise ValueError(f"word {word:04X}H is no decimal number")
    return (int(digits) if coding == "decimal-0.1" else word) / _STEPS_PER_HZ[coding]
