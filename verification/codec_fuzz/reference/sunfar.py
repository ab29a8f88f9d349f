"""C320 frames, judged (manual sections 2.3, 2.4 and 3; the odd spellings of its examples 4.5 and 4.6)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import ClassVar

from verification.codec_fuzz.reference.frame_shapes import FrameShape
from verification.codec_fuzz.reference.sunfar_shapes import (
    DigitSpellings,
    Field,
    reply_fields,
    request_fields,
    sunfar_shape,
)

SUNFAR_OPERATIONS = (0, 1, 2, 3, 4, 5, 6, 0x10, 0x11, 0x12, 0x13, 0x14, 0x15, 0x16, 0x20, 0x21)
SUNFAR_STATES = (0, 1, 2, 3, 4, 5, 0x11, 0x12, 0x13, 0x14, 0x15, 0x16, 0x20, 0x21)
SUNFAR_FAULT_STATE = 0x20
SUNFAR_BROADCAST = 31
READ, CONTROL, WRITE, SHORT = (2, 1, 2, 1, 2), (2, 1, 2, 4), (2, 1, 2, 1, 2, 4), (2, 1, 2)
IDENTITY = (2, 1, 2, 1, 1, 1, 4)
CLASSES = {0: READ, 1: READ, 2: READ, 3: WRITE, 4: CONTROL, 5: WRITE}
BY_LENGTH = {11: SHORT, 14: READ, 15: CONTROL, 18: WRITE}
CAPITALS = b"0123456789ABCDEF"

ParsedFields = tuple[list[int], int | None]
"""The fields' numbers, and what the data are nibble by nibble where nothing decides (T03)."""


@dataclass(frozen=True, slots=True)
class SunfarReference:
    """``loose``: of ASCII, that a-f and 3AH-3FH are digits (T02); of hex, that nibble frames count (T03)."""

    encoding: str
    tolerant: bool = False
    marks: int = 1
    """Bytes at a frame's end that are always the same."""
    address: ClassVar[slice] = slice(1, 3)
    """Where a frame has its address."""

    @property
    def head(self) -> int:
        return ord("*") if self.encoding == "ascii" else ord("Z")

    def accepted_size(self, sent: bytes, got: bytes) -> int | None:
        """How many bytes of ``got`` are the reply to ``sent`` (or, with nothing sent, a request); None: nothing is."""
        if len(got) < 11 or got[0] != self.head:
            return None
        kind = self.digit(got[3])
        widths = _reply_widths(self.parse_request(sent)[1], kind) if sent else CLASSES.get(kind)
        if widths is None or len(got) < sum(widths) + 6:
            return None
        frame = got[: sum(widths) + 6]
        fits = self._is_reply_to(sent, frame, widths) if sent else _is_request(self._read(frame, widths))
        return len(frame) if fits else None

    def is_well_formed(self, frame: bytes) -> bool:
        """End mark, digits and sum are right, whatever the fields say."""
        widths = BY_LENGTH.get(len(frame))
        return widths is not None and frame[0] == self.head and self._read(frame, widths) is not None

    def seal(self, frame: bytes) -> bytes:
        """The frame with end mark and sum right, in capitals or packed."""
        total = sum(frame[1:-5])
        return frame[:-5] + (b"%04X" % total if self.encoding == "ascii" else total.to_bytes(4, "big")) + b"\r"

    def forms(self, sent: bytes) -> tuple[FrameShape, ...]:
        """All lawful frames; their codes and states count digit by digit, so as some more than there are."""
        all_fields = reply_fields(tuple(self.parse_request(sent))) if sent else request_fields()
        return tuple(self._form(fields) for fields in all_fields)

    def parse_request(self, sent: bytes) -> list[int]:
        """The fields of a request of ours."""
        return _parse_request(SunfarReference(self.encoding), sent)

    def digit(self, byte: int) -> int:
        """0-15, or -1."""
        if self.encoding == "hex":
            return byte if byte < 16 else -1
        if self.tolerant and byte in b"abcdef":
            return byte - ord("a") + 10
        if self.tolerant and 0x3A <= byte <= 0x3F:
            return byte - 0x30
        return CAPITALS.find(byte)

    def _digits(self, text: bytes) -> int:
        """The number that these digits write, or -1."""
        number = 0
        for byte in text:
            digit = self.digit(byte)
            if digit < 0:
                return -1
            number = number * 16 + digit
        return number

    def _read(self, frame: bytes, widths: tuple[int, ...]) -> ParsedFields | None:
        """The fields, where end mark, sum and digits are right."""
        total, check = sum(frame[1:-5]), frame[-5:-1]
        if frame[-1] != 13:
            return None
        if self.encoding == "hex" and int.from_bytes(check, "big") == total:
            return _mixed(_split(frame, widths)) if self.tolerant else _packed(_split(frame, widths))
        if (self.encoding == "ascii" or self.tolerant) and self._digits(check) == total:
            numbers = [self._digits(text) for text in _split(frame, widths)]
            return None if -1 in numbers else (numbers, None)
        return None

    def _is_reply_to(self, sent: bytes, frame: bytes, widths: tuple[int, ...]) -> bool:
        found = self._read(frame, widths)
        if found is None and widths is IDENTITY:  # [OPEN] a fault code of 10H or more in place of digits 7 and 8
            found = self._read(frame, WRITE)
            if found is not None and found[0][2] != SUNFAR_FAULT_STATE:
                return False
        return found is not None and _is_valid_reply(self.parse_request(sent), *found)

    def _form(self, fields: tuple[Field, ...]) -> FrameShape:
        ways = (1, 1) if not self.tolerant else (3**4, 3) if self.encoding == "ascii" else (2, 2)
        return sunfar_shape(self.head, fields, _digit_spellings(self), self.encoding == "hex", self.tolerant, ways)


@cache
def _parse_request(judge: SunfarReference, sent: bytes) -> list[int]:
    found = judge._read(sent, CLASSES[judge.digit(sent[3])])
    assert found is not None
    return found[0]


def _split(frame: bytes, widths: tuple[int, ...]) -> list[bytes]:
    return [frame[1 + sum(widths[:n]) : 1 + sum(widths[: n + 1])] for n in range(len(widths))]


@cache
def _digit_spellings(judge: SunfarReference) -> DigitSpellings:
    return tuple(frozenset(byte for byte in range(256) if judge.digit(byte) == digit) for digit in range(16))


def _reply_widths(asked_class: int, code: int) -> tuple[int, ...] | None:
    if code in (6, 7, 8):
        return SHORT
    if not 0 <= code <= 4:
        return None
    return IDENTITY if asked_class == 0 else WRITE


def _packed(raw: list[bytes]) -> ParsedFields | None:
    numbers = [int.from_bytes(text, "big") for text in raw]
    fits = all(number < 16 ** len(text) for number, text in zip(numbers, raw, strict=True))
    return (numbers, None) if fits else None


def _mixed(raw: list[bytes]) -> ParsedFields | None:
    """Each field as its own bytes say; four bytes 00 00 0x 0y as the others say; packed where nobody does."""
    kinds = [_frame_class(text) for text in raw]
    known = {kind for kind in kinds if kind in ("packed", "nibbles")}
    for text, kind in zip(raw, kinds, strict=True):
        if (kind == "nibbles" or len(text) == 1) and max(text) > 15:
            return None
    numbers = [
        _nibbles(t) if kind == "nibbles" else int.from_bytes(t, "big") for t, kind in zip(raw, kinds, strict=True)
    ]
    if "open" not in kinds:
        return numbers, None
    other = _nibbles(raw[kinds.index("open")])
    if known == {"nibbles"}:
        numbers[kinds.index("open")] = other
    return numbers, None if len(known) == 1 else other


def _frame_class(text: bytes) -> str:
    half = len(text) // 2
    if half and any(text[:half]):
        return "nibbles"
    if half and max(text[half:]) > 15:
        return "packed"
    return "open" if len(text) == 4 and text[2] else "alike"


def _nibbles(text: bytes) -> int:
    return int.from_bytes(text, "big") if len(text) == 1 else sum(b << 4 * n for n, b in enumerate(reversed(text)))


def _is_request(found: ParsedFields | None) -> bool:
    if found is None:
        return False
    address, kind, operation, *rest = found[0]
    if address > SUNFAR_BROADCAST or operation not in SUNFAR_OPERATIONS:
        return False
    return not ((kind == 0 and rest[1]) or (kind == 1 and rest[0]))


def _is_valid_reply(asked: list[int], found: list[int], other: int | None) -> bool:
    if found[0] != asked[0] or asked[0] == SUNFAR_BROADCAST:
        return False
    if len(found) == len(SHORT):
        return found[2] == 0
    code, state, group = found[1:4]
    if state not in SUNFAR_STATES or group != (0 if asked[1] == 4 else asked[3]):
        return False
    if asked[1] in (0, 4):
        return True
    if state != SUNFAR_FAULT_STATE and found[4] != asked[4]:  # T05
        return False
    if asked[1] in (1, 2):
        return True
    return asked[5] in (found[5], other) if code == 0 else found[5] == 0  # note of section 3 (4); T21
