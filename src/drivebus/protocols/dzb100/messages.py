"""Requests, replies, the state word and the frequency codings of the DZB100 protocol as values."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import ClassVar, Literal

from drivebus.errors import CodeError

BROADCAST = 0
"""Also the factory setting of parameter 78: a drive left at 0 obeys every broadcast and answers nothing."""
LAST_ADDRESS = 31
LAST_PARAMETER = 80
LAST_QUERY_ITEM = 3


class Dzb100Command(IntEnum):
    """Command number of a control frame: only the low digit counts; 0 and 2 both stop."""

    STOP = 0
    FORWARD = 1
    STOP_2 = 2
    REVERSE = 3
    JOG_FORWARD = 4
    JOG_FORWARD_2 = 5
    JOG_REVERSE = 6
    JOG_REVERSE_2 = 7
    RESET = 8

    @property
    def is_stop(self) -> bool:
        return self in (Dzb100Command.STOP, Dzb100Command.STOP_2)


COMMAND_BY_CODE = {int(command): command for command in Dzb100Command}


@dataclass(frozen=True, slots=True)
class Dzb100Control:
    """Head C: a command with its frequency word. ``broadcast`` addresses all drives (A = 02, address 00)."""

    address: int
    command: Dzb100Command
    data: int = 0
    broadcast: bool = False
    head: ClassVar[int] = ord("C")

    @property
    def index(self) -> int:
        return int(self.command)


@dataclass(frozen=True, slots=True)
class Dzb100WriteParameter:
    """Head P. There is no RAM form, so every write wears the EEPROM."""

    address: int
    parameter: int
    data: int
    head: ClassVar[int] = ord("P")

    @property
    def index(self) -> int:
        return self.parameter


@dataclass(frozen=True, slots=True)
class Dzb100ReadParameter:
    """Head R, not P as the manual's text has it: eleven bytes of P would write 0."""

    address: int
    parameter: int
    data: ClassVar[int] = 0
    head: ClassVar[int] = ord("R")

    @property
    def index(self) -> int:
        return self.parameter


@dataclass(frozen=True, slots=True)
class Dzb100Query:
    """Head Q: 0 frequency command, 1 output frequency, 2 output current, 3 ``StateWord``."""

    address: int
    item: int
    data: ClassVar[int] = 0
    head: ClassVar[int] = ord("Q")

    @property
    def index(self) -> int:
        return self.item


Dzb100Request = Dzb100Control | Dzb100WriteParameter | Dzb100ReadParameter | Dzb100Query


@dataclass(frozen=True, slots=True, kw_only=True)
class Dzb100Reply:
    """Reply of a drive. Byte B is 06 (``accepted``), 07 (not) or, in a C reply, a state digit (``accepted`` None).

    Byte B never proves whether the motor turns.
    """

    head: str
    address: int
    index: int
    data: int
    accepted: bool | None
    digit: int | None = None


FrequencyCoding = Literal["hex-0.1", "hex-0.01", "decimal-0.1", "hex-1"]
FaultCoding = Literal["decimal", "hex"]
LAST_FAULT_CODE = 20


@dataclass(frozen=True, slots=True)
class StateWord:
    """Query item 3, digits ABCD: last command, state bits (not published), fault code 0-20."""

    command: int
    state: int
    fault_code: int

    @classmethod
    def parse(cls, data: int, fault_coding: FaultCoding = "decimal") -> StateWord:
        """Parse a data word. Raises CodeError for a command above 8 or a fault code that the manual does not list."""
        command, state, fault = data >> 12, data >> 8 & 0x0F, data & 0xFF
        if command > Dzb100Command.RESET:
            raise CodeError("protocols.dzb100.command_digit", expected=int(Dzb100Command.RESET), found=command)
        digits = f"{fault:02X}"
        if fault_coding == "decimal" and not digits.isdecimal():
            raise CodeError("protocols.dzb100.fault_digits", expected="00-20", found=digits)
        code = int(digits) if fault_coding == "decimal" else fault
        if code > LAST_FAULT_CODE:
            raise CodeError("protocols.dzb100.fault_code", expected=LAST_FAULT_CODE, found=code)
        return cls(command, state, code)

    def encode(self, fault_coding: FaultCoding = "decimal") -> int:
        """Return the 16 bits that a drive sends."""
        fault = int(str(self.fault_code), 16) if fault_coding == "decimal" else self.fault_code
        return self.command << 12 | self.state << 8 | fault


_STEPS_PER_HZ: dict[FrequencyCoding, int] = {"hex-0.1": 10, "hex-0.01": 100, "decimal-0.1": 10, "hex-1": 1}
"""Steps of the data word per hertz."""
FREQUENCY_CODINGS: tuple[FrequencyCoding, ...] = ("hex-0.1", "hex-0.01", "decimal-0.1", "hex-1")


def encode_frequency(hz: float, coding: FrequencyCoding) -> int:
    """Return the word of a frequency, rounded to the step of the coding. Raises ValueError above four digits."""
    limit = 9999 if coding == "decimal-0.1" else 0xFFFF
    words = hz * _STEPS_PER_HZ[coding]
    if not 0 <= words <= limit:
        raise ValueError(f"{hz} Hz does not fit a word of coding {coding}")
    return int(str(round(words)), 16) if coding == "decimal-0.1" else round(words)


def decode_frequency(word: int, coding: FrequencyCoding) -> float:
    """Return the frequency of a word in Hz. Raises ValueError for a word that is not decimal under decimal-0.1."""
    digits = f"{word:X}"
    if coding == "decimal-0.1" and not digits.isdecimal():
        raise ValueError(f"word {word:04X}H is no decimal number")
    return (int(digits) if coding == "decimal-0.1" else word) / _STEPS_PER_HZ[coding]
