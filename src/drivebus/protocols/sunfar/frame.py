"""Fields of a Sunfar frame to bytes and back; their meaning is in ``messages`` and ``codec``.

A frame is head, fields, checksum (4 bytes), 0DH, and 0DH, 2AH and 5AH are ordinary bytes of hex frames. A field has the
same number of bytes in every encoding: ASCII hex digits after ``2AH``; right-aligned bytes after ``5AH`` (C320 manual
2.3); or one nibble a byte after ``5AH``, as sections 4.5 and 4.6 misprint it.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import Protocol

from drivebus.errors import AlphabetError, ChecksumError, HeaderError, TerminatorError
from drivebus.protocols.checksum import canonical_digits

ASCII_HEAD = 0x2A
HEX_HEAD = 0x5A
END_MARK = 0x0D
CHECKSUM_WIDTH = 4
NIBBLE_DIGITS = b"0123456789ABCDEF" + bytes(240)
"""Table from a byte that holds one nibble to its digit."""


@dataclass(frozen=True, slots=True)
class FrameLayout:
    """Widths of a frame's fields in bytes, in order, without head, checksum and end mark."""

    widths: tuple[int, ...]
    size: int = field(init=False)
    ascii_template: bytes = field(init=False)
    packed: struct.Struct = field(init=False)
    spans: tuple[tuple[int, int], ...] = field(init=False)
    """(shift, mask) of each field and of the checksum in the number that all digits form."""
    zero_mask: int = field(init=False)
    """Bits that packed fields leave 0."""

    def __post_init__(self) -> None:
        widths = (*self.widths, CHECKSUM_WIDTH)
        ends = [sum(widths[: n + 1]) for n in range(len(widths))]
        assign = object.__setattr__
        assign(self, "size", ends[-1] + 2)
        assign(self, "ascii_template", b"".join(b"%%0%dX" % width for width in self.widths))
        assign(self, "packed", struct.Struct(">" + "".join({1: "B", 2: "H", 4: "I"}[width] for width in widths)))
        assign(self, "spans", tuple((4 * (ends[-1] - end), 16**w - 1) for w, end in zip(widths, ends, strict=True)))
        used = sum((16**w - 1) << 8 * (ends[-1] - end) for w, end in zip(widths, ends, strict=True))
        assign(self, "zero_mask", 256 ** ends[-1] - 1 - used)


READ_LAYOUT = FrameLayout((2, 1, 2, 1, 2))
"""Address, class, operation, group, item: classes 0, 1, 2."""
WRITE_LAYOUT = FrameLayout((2, 1, 2, 1, 2, 4))
"""The same with data: classes 3 and 5, and every full reply (response and state for class and operation)."""
CONTROL_LAYOUT = FrameLayout((2, 1, 2, 4))
"""Address, class, operation, data: class 4."""
IDENTITY_LAYOUT = FrameLayout((2, 1, 2, 1, 1, 1, 4))
"""Reply to class 0: digits 7 and 8 are separate fields."""
SHORT_LAYOUT = FrameLayout((2, 1, 2))
"""Response codes 6, 7, 8."""


@dataclass(frozen=True, slots=True)
class FrameFields:
    """Field values in the layout's order; ``nibble_data`` is set where the data also read as one nibble a byte."""

    values: tuple[int, ...]
    nibble_data: int | None = None


class FieldFormat(Protocol):
    """Encoding of fields."""

    head: int

    def build(self, layout: FrameLayout, *values: int) -> bytes:
        """Return the frame of field values that fit their widths."""
        ...

    def digit(self, byte: int, position: int) -> int:
        """Return the value of a field of one byte. Raises AlphabetError with its position."""
        ...

    def read(self, layout: FrameLayout, frame: bytes) -> FrameFields:
        """Return the fields of a frame of the layout's size. Raises TerminatorError, AlphabetError, ChecksumError."""
        ...


def check_head(fmt: FieldFormat, data: bytes) -> None:
    """Raise HeaderError unless ``data`` is empty or begins with the head of the encoding."""
    if data and data[0] != fmt.head:
        raise HeaderError("protocols.header", expected=fmt.head, found=data[0])


def _check_end_mark(frame: bytes) -> None:
    if frame[-1] != END_MARK:
        raise TerminatorError("protocols.terminator", expected=END_MARK, found=frame[-1], position=len(frame) - 1)


def _check_checksum(frame: bytes, found: int) -> None:
    computed = sum(frame[1:-5])
    if found != computed:
        raise ChecksumError("protocols.checksum", expected=computed, found=found)


class AsciiFormat:
    """Encoding with head ``2AH``: every byte is a digit of ``table``."""

    head = ASCII_HEAD

    def __init__(self, table: bytes) -> None:
        self.table = table

    def build(self, layout: FrameLayout, *values: int) -> bytes:
        body = layout.ascii_template % values
        return b"*%b%04X\r" % (body, sum(body))

    def digit(self, byte: int, position: int) -> int:
        value = self.table[byte]
        if not value:
            canonical_digits(bytes((byte,)), self.table, position)  # raises
        return value - 0x30 if value <= 0x39 else value - 0x37

    def read(self, layout: FrameLayout, frame: bytes) -> FrameFields:
        _check_end_mark(frame)
        values = _digit_values(layout, frame, self.table)
        _check_checksum(frame, values[-1])
        return FrameFields(values[:-1])


def _digit_values(layout: FrameLayout, frame: bytes, table: bytes) -> tuple[int, ...]:
    number = int(canonical_digits(frame[1:-1], table, 1), 16)
    return tuple([number >> shift & mask for shift, mask in layout.spans])


class PackedFormat:
    """Encoding with head ``5AH``: right-aligned bytes, unused leading ones 0."""

    head = HEX_HEAD

    def build(self, layout: FrameLayout, *values: int) -> bytes:
        body = layout.packed.pack(*values, 0)[:-CHECKSUM_WIDTH]
        return b"Z%b%b\r" % (body, sum(body).to_bytes(CHECKSUM_WIDTH, "big"))

    def digit(self, byte: int, position: int) -> int:
        if byte > 0x0F:
            raise AlphabetError("protocols.sunfar.digit", expected=0x0F, found=byte, position=position)
        return byte

    def read(self, layout: FrameLayout, frame: bytes) -> FrameFields:
        _check_end_mark(frame)
        fields = frame[1:-1]
        if stray := int.from_bytes(fields, "big") & layout.zero_mask:
            raise _stray_bits_error(fields, stray)
        values = layout.packed.unpack(fields)
        _check_checksum(frame, values[-1])
        return FrameFields(values[:-1])


def _stray_bits_error(fields: bytes, stray: int) -> AlphabetError:
    """Return the error for bits that a right-aligned field leaves 0."""
    at = next(n for n, byte in enumerate(stray.to_bytes(len(fields), "big")) if byte)
    return AlphabetError("protocols.sunfar.stray", expected=0, found=fields[at], position=at + 1)


class MixedFormat(PackedFormat):
    """Encoding that reads packed fields and one nibble a byte alike, and writes packed fields."""

    def read(self, layout: FrameLayout, frame: bytes) -> FrameFields:
        _check_end_mark(frame)
        if int.from_bytes(frame[-5:-1], "big") == sum(frame[1:-5]):
            return _read_mixed(layout, frame)
        values = _digit_values(layout, frame, NIBBLE_DIGITS)  # one nibble a byte throughout (request of 4.5)
        _check_checksum(frame, values[-1])
        return FrameFields(values[:-1])


def _read_mixed(layout: FrameLayout, frame: bytes) -> FrameFields:
    """Read each field as its bytes decide; undecided data follow the other fields, else they are packed."""
    values: list[int] = []
    decisions: set[bool] = set()
    open_at: int | None = None
    at = 1
    for width in layout.widths:
        raw = frame[at : at + width]
        nibbles = _is_nibble_field(raw)
        if nibbles is None and width == CHECKSUM_WIDTH and raw[2]:
            open_at = len(values)
        elif nibbles is not None:
            decisions.add(nibbles)
        values.append(_read_field(raw, nibbles=bool(nibbles), at=at))
        at += width
    if open_at is None:
        return FrameFields(tuple(values))
    other = values[open_at] >> 4 & 0xF0 | values[open_at] & 0x0F
    if decisions == {True}:
        values[open_at] = other
    return FrameFields(tuple(values), None if len(decisions) == 1 else other)


def _is_nibble_field(raw: bytes) -> bool | None:
    """Return whether each byte of a field holds one digit; None where the bytes fit both encodings."""
    if any(raw[: len(raw) // 2]):
        return True
    return False if max(raw) > 0x0F else None


def _read_field(raw: bytes, *, nibbles: bool, at: int) -> int:
    if nibbles:
        return int(canonical_digits(raw, NIBBLE_DIGITS, at), 16)
    if raw[0] > 0x0F:  # a wider field has 0 here
        raise AlphabetError("protocols.sunfar.digit", expected=0x0F, found=raw[0], position=at)
    return int.from_bytes(raw, "big")
