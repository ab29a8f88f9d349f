"""Holds what every frame writes against I7: on the manuals' lists, within the range, and within the EEPROM budget.

The tables are the observer's own; no codec, profile or dialect of drivebus is used.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from datetime import date
from typing import NamedTuple

from verification.drive_variants import DriveVariant
from verification.scenario.frame_rules import ClassifiedFrame

EEPROM_WRITES_PER_DAY = 20
"""Saves of one parameter a day."""
C320_WITH_HZ = frozenset({0x10, 0x11, 0x12, 0x13, 0x14, 0x15, 0x16})
"""C320 2.4.4: operations that bring a frequency."""
DZB100_LAST_PARAMETER, VC660_LAST_INDEX = 80, 450
"""The highest parameter of DZB100 and the highest index of VC660."""
VC660_BITS, DF800_BITS = 0x027F, 0x001F
"""2000H: VC660 start, stop, direction, jogs, coast, emergency stop, reset; DF800 command, direction, reset."""
DF800_TOGGLE = 0x0C
"""T16."""
DF800_PARAMETERS = range(100, 1000)
"""g x 100 + nn; group 0 are monitors."""


class ReferenceWrite(NamedTuple):
    """What one frame writes: a frequency in Hz, or a parameter by its place, saved in the EEPROM or not."""

    hz: float | None = None
    parameter: int | None = None
    saved: bool = False


def decode_write(kind: DriveVariant, frame: bytes) -> ReferenceWrite:
    """What a frame that is no read writes. Raises ValueError for what is on no list."""
    if kind.model == "c320":
        return _c320(kind, frame)
    if kind.model == "dzb100":
        return _dzb100(frame)
    words = frame[:-2] if kind.encoding == "rtu" else bytes.fromhex(frame[1:-2].decode())[:-1]
    register, value = int.from_bytes(words[2:4]), int.from_bytes(words[4:6])
    if register == 0x2001:
        return ReferenceWrite(hz=value / 100)
    if register == 0x2000:
        _check_word(kind, value)
        return ReferenceWrite()
    known = register & 0x7FFF <= VC660_LAST_INDEX if kind.model == "vc660" else register in DF800_PARAMETERS
    if not known:
        raise ValueError(f"register {register:04X}H is on no list")
    saved = kind.model == "df800" or register >= 0x8000
    return ReferenceWrite(parameter=register & 0x7FFF, saved=saved)


def _c320(kind: DriveVariant, frame: bytes) -> ReferenceWrite:
    def field(first: int, width: int) -> int:
        part = frame[first : first + width]
        return int(part, 16) if kind.encoding == "ascii" else int.from_bytes(part)

    group = field(3, 1)
    if group in (3, 5):
        return ReferenceWrite(parameter=field(6, 1) << 8 | field(7, 2), saved=group == 5)
    return ReferenceWrite(hz=field(6, 4) / 100) if field(4, 2) in C320_WITH_HZ else ReferenceWrite()


def _dzb100(frame: bytes) -> ReferenceWrite:
    if frame[:1] == b"C":
        return ReferenceWrite(hz=int(frame[7:11], 16) / 10)
    if int(frame[5:7]) > DZB100_LAST_PARAMETER:
        raise ValueError(f"parameter {int(frame[5:7])} is on no list")
    return ReferenceWrite(parameter=int(frame[5:7]), saved=True)


def _check_word(kind: DriveVariant, value: int) -> None:
    vc660 = kind.model == "vc660"
    if value & ~(VC660_BITS if vc660 else DF800_BITS) or (not vc660 and value & DF800_TOGGLE == DF800_TOGGLE):
        raise ValueError(f"no command is {value:04X}H")


class WriteRules:
    """What a host may write, and how often."""

    def __init__(self, kind: DriveVariant, violation: Callable[[str], None]) -> None:
        self._kind, self._violation = kind, violation
        self._saved: Counter[tuple[int, int, date]] = Counter()

    def on_write(self, frame: ClassifiedFrame, data: bytes, today: date) -> None:
        """A frame that is no read has left."""
        try:
            found = decode_write(self._kind, data)
        except ValueError as error:
            return self._violation(f"I7 {frame.effect} to {frame.address}: {error}")
        if found.hz is not None and found.hz > self._kind.maximum_hz:
            self._violation(f"I7 {frame.effect} to {frame.address} with {found.hz} Hz")
        if (
            found.saved
            and found.parameter is not None
            and frame.user_command is not None
            and frame.user_command.day == today
        ):
            place = frame.address, found.parameter, today
            self._saved[place] += 1
            if self._saved[place] > EEPROM_WRITES_PER_DAY:
                self._violation(f"I7 save {self._saved[place]} of parameter {found.parameter:X} of {frame.address}")
        return None
