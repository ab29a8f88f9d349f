"""Enumerated values and names of the C320 protocol (manual sections 2.4.3 to 2.4.6 and 3). No bytes are read here."""

from __future__ import annotations

from enum import IntEnum
from typing import Literal

BROADCAST = 31
"""Every station hears it, nobody answers (2.4.2)."""

MonitorIndexCoding = Literal["binary", "bcd"]


class SunfarOperation(IntEnum):
    """What bytes 4-5 of a request order, *in every class* (2.4.4, T01). ``*_AT`` sets the frequency as well."""

    NONE = 0x00
    RUN_FORWARD = 0x01
    RUN_REVERSE = 0x02
    STOP = 0x03
    JOG_FORWARD = 0x04
    JOG_REVERSE = 0x05
    JOG_STOP = 0x06
    SET_FREQUENCY = 0x10
    RUN_FORWARD_AT = 0x11
    RUN_REVERSE_AT = 0x12
    STOP_AT = 0x13
    JOG_FORWARD_AT = 0x14
    JOG_REVERSE_AT = 0x15
    JOG_STOP_AT = 0x16
    RESET_FAULT = 0x20
    EMERGENCY_STOP = 0x21

    @property
    def sets_frequency(self) -> bool:
        """The data of a class-4 frame is then the frequency."""
        return self & 0xF0 == 0x10


class SunfarState(IntEnum):
    """What the drive is doing (2.4.6)."""

    NOT_READY = 0x00
    """The DC bus is not charged."""
    RUNNING_FORWARD = 0x01
    RUNNING_REVERSE = 0x02
    STOPPED = 0x03
    JOGGING_FORWARD = 0x04
    JOGGING_REVERSE = 0x05
    ACCELERATING_FORWARD = 0x11
    ACCELERATING_REVERSE = 0x12
    RESTARTING = 0x13
    """After an instantaneous power loss."""
    DECELERATING_FORWARD = 0x14
    DECELERATING_REVERSE = 0x15
    DC_BRAKING = 0x16
    FAULT = 0x20
    """The item field then holds the fault code (T05)."""
    EMERGENCY_STOP = 0x21


class SunfarResponse(IntEnum):
    """What became of the request (2.4.5). 6, 7 and 8 come in the short frame (T06)."""

    OK = 0
    OUT_OF_RANGE = 1
    RUNNING = 2
    """Not to be changed while running."""
    PASSWORD = 3
    RESERVED = 4
    """A reserved or hidden parameter."""
    BAD_CODE = 6
    """No such parameter or address."""
    BAD_ASCII = 7
    BAD_COMMAND = 8
    """No such class or operation."""

    @property
    def is_short(self) -> bool:
        """Sent as 11 bytes without state and data."""
        return self >= SunfarResponse.BAD_CODE


GROUP_LETTERS = "0123456789CEFHLP"
"""F0 … F9 = 0 … 9, FC = A, FE = B, FF = C, FH = D, FL = E, FP = F (section 3)."""


def parameter_name(group: int, item: int) -> str:
    """The manual's notation, e.g. (1, 10) → ``F1.10``."""
    return f"F{GROUP_LETTERS[group]}.{item}"


def parse_parameter(notation: str) -> tuple[int, int]:
    """(group, item) of a notation such as ``F1.10`` or ``FC.3``. Raises ValueError for anything else."""
    head, _, item = notation.strip().upper().partition(".")
    known = len(head) == 2 and head[0] == "F" and head[1] in GROUP_LETTERS
    if not (known and item.isascii() and item.isdigit() and int(item) <= 0xFF):
        raise ValueError(f"{notation!r}: expected a parameter such as F0.1 or FC.12")
    return GROUP_LETTERS.index(head[1]), int(item)


def monitor_item(index: int, coding: MonitorIndexCoding = "binary") -> int:
    """The item that asks for monitor d.``index``: binary (d.15 → 0FH), or as the manual's table prints it (15H)."""
    limit = 0xFF if coding == "binary" else 99
    if not 0 <= index <= limit:
        raise ValueError(f"monitor d.{index}: expected d.0 to d.{limit}")
    return index if coding == "binary" else int(str(index), 16)


def monitor_index(item: int, coding: MonitorIndexCoding = "binary") -> int | None:
    """The n of d.n that an item asks for; None where the item is no decimal number under "bcd"."""
    if coding == "binary":
        return item
    return int(f"{item:X}") if f"{item:X}".isdecimal() else None


CLASS_OFFSET = 3
"""The byte whose digit tells the length: class of a request, response code of a reply."""
OPERATION_BY_CODE = {int(operation): operation for operation in SunfarOperation}
STATE_BY_CODE = {int(state): state for state in SunfarState}
RESPONSE_BY_CODE = {int(response): response for response in SunfarResponse}
