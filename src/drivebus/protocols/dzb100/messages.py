"""Requests and replies of the DZB100 protocol as values. No bytes are read here."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import ClassVar

BROADCAST = 0
"""Also the factory setting of parameter 78: a drive left at 0 hears everything and can be asked nothing (T10)."""
LAST_ADDRESS = 31
LAST_PARAMETER = 80
LAST_QUERY_ITEM = 3


class Dzb100Command(IntEnum):
    """MM: only the low digit counts; 0 and 2 both stop."""

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
    """C: a command with its frequency word. ``everyone`` speaks to all drives (A = 02, address 00)."""

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
    """P. There is no RAM form: every write is an EEPROM write (ruling 8)."""

    address: int
    parameter: int
    data: int
    head: ClassVar[int] = ord("P")

    @property
    def index(self) -> int:
        return self.parameter


@dataclass(frozen=True, slots=True)
class Dzb100ReadParameter:
    """R, never P: eleven bytes of P would write 0 (T09)."""

    address: int
    parameter: int
    data: ClassVar[int] = 0
    head: ClassVar[int] = ord("R")

    @property
    def index(self) -> int:
        return self.parameter


@dataclass(frozen=True, slots=True)
class Dzb100Query:
    """Q: 0 frequency command, 1 output frequency, 2 output current, 3 ``StateWord``."""

    address: int
    item: int
    data: ClassVar[int] = 0
    head: ClassVar[int] = ord("Q")

    @property
    def index(self) -> int:
        return self.item


Dzb100Request = Dzb100Control | Dzb100WriteParameter | Dzb100ReadParameter | Dzb100Query


@dataclass(frozen=True, slots=True)
class Dzb100Reply:
    """A drive's answer. B 06 is ``accepted`` True, 07 False; else ``digit`` and ``accepted`` None (C only, T20).

    B never tells whether the motor turns.
    """

    head: str
    address: int
    index: int
    data: int
    accepted: bool | None
    digit: int | None = None
