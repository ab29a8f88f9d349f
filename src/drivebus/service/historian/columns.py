"""Columns of numbers as little-endian bytes that deflate well, without any loss.

Integers: ``<qB`` the first, width w (1, 2, 4 or 8); then the steps from each to the next, signed, w bytes each: all
lowest bytes, then all second bytes ….
Floats: ``<bI`` decimal places d, number of exceptions e; e × uint32 positions, e × float64; the values × 10^d as
integers. At an exception, a value that this does not restore bit by bit (NaN, infinite, −0, more places), the integer
has no meaning. d = −1: n × float64.
"""

from __future__ import annotations

import struct
import sys
from array import array
from collections.abc import Iterable, Sequence
from contextlib import suppress
from itertools import accumulate, repeat
from math import isfinite
from operator import mul, sub, truediv

_INTEGERS = struct.Struct("<qB")
_FLOATS = struct.Struct("<bI")
_STEP_CODES = {1: "b", 2: "h", 4: "i", 8: "q"}
"""``array`` type codes by width in bytes."""
_MAX_PLACES = 7
"""Most decimal places of a reading: see ``values.Scale``."""
_EXCEPTIONS_DIVISOR = 8
"""A column with more exceptions than its length divided by this is stored as floats."""
_PROBES = 16
"""Values by which decimal places are rejected before a whole column is scaled."""


class DamagedBlock(ValueError):
    """The bytes of a row are not a valid block."""


def pack(code: str, numbers: Iterable[float]) -> bytes:
    """Return numbers of one ``array`` type code as little-endian bytes. Raises OverflowError."""
    numbers_array = array(code, numbers)
    if sys.byteorder == "big":
        numbers_array.byteswap()
    return numbers_array.tobytes()


def unpack(code: str, data: bytes) -> list[int]:
    """Return the numbers of ``pack``."""
    column = array(code)
    column.frombytes(data)
    if sys.byteorder == "big":
        column.byteswap()
    return column.tolist()


def unpack_floats(data: bytes) -> list[float]:
    return unpack("d", data)  # type: ignore[return-value]


def pack_integers(numbers: Sequence[int]) -> bytes:
    """Pack one or more integers. Raises OverflowError where one or a step has more than 63 bits."""
    if not -(2**63) <= numbers[0] < 2**63:
        raise OverflowError(numbers[0])
    steps = list(map(sub, numbers[1:], numbers))
    for width, code in _STEP_CODES.items():
        with suppress(OverflowError):
            packed = pack(code, steps)
            return _INTEGERS.pack(numbers[0], width) + b"".join(packed[n::width] for n in range(width))
    raise OverflowError("a step has more than 63 bits")


def pack_floats(values: Sequence[float]) -> bytes:
    """Pack one or more floats, every bit of them."""
    probe = values[:: len(values) // _PROBES + 1]
    for places in range(_MAX_PLACES + 1):
        factor = 10.0**places
        if 2 * sum(map(float.__eq__, _restore(_scale(probe, factor), factor), probe)) < len(probe):
            continue
        scaled = _scale(values, factor)
        positions = _differing(_restore(scaled, factor), values)
        if len(positions) * _EXCEPTIONS_DIVISOR <= len(values):
            exceptions = pack("I", positions) + pack("d", [values[n] for n in positions])
            with suppress(OverflowError):
                return _FLOATS.pack(places, len(positions)) + exceptions + pack_integers(scaled)
    return _FLOATS.pack(-1, 0) + pack("d", values)


def _scale(values: Sequence[float], factor: float) -> list[int]:
    """Return values × ``factor``, rounded; the number before where the product is not finite."""
    products = list(map(mul, values, repeat(factor)))
    try:
        # The method itself takes half the time of round().
        return list(map(float.__round__, products))
    except (ValueError, OverflowError):
        return list(accumulate(products, lambda last, value: round(value) if isfinite(value) else last, initial=0))[1:]


def _restore(scaled: Iterable[int], factor: float) -> list[float]:
    return list(map(truediv, scaled, repeat(factor)))


def _differing(restored: Sequence[float], values: Sequence[float]) -> list[int]:
    """Return the positions at which two columns differ in any bit."""
    if restored == values and 0.0 not in restored:  # 0.0 equals −0.0
        return []
    pairs = zip(unpack("q", pack("d", restored)), unpack("q", pack("d", values)), strict=True)
    return [n for n, (first, other) in enumerate(pairs) if first != other]


def _equal_steps(first: int, step: int, n: int) -> list[int]:
    """Return ``n`` integers with equal steps: the times and counts of most rollups, in a fifth of the time."""
    return [first] * n if step == 0 else list(range(first, first + n * step, step))


class ColumnReader:
    """Reader of consecutive columns of ``n`` numbers. Raises DamagedBlock where one is invalid."""

    def __init__(self, data: bytes, n: int) -> None:
        self._data, self._n, self._at = data, n, 0
        self.wanted = slice(0, n)
        """Positions that ``integers``, ``floats`` and ``octets`` return; others are checked only by their size."""

    def take(self, size: int) -> bytes:
        begin, self._at = self._at, self._at + size
        if self._at > len(self._data):
            raise DamagedBlock(f"{len(self._data)} bytes end within a column")
        return self._data[begin : self._at]

    def close(self) -> None:
        """Check that nothing follows the last column."""
        if self._at != len(self._data):
            raise DamagedBlock(f"{len(self._data) - self._at} bytes follow the last column")

    def octets(self) -> bytes:
        return self.take(self._n)[self.wanted]

    def integers(self) -> list[int]:
        first, width = _INTEGERS.unpack(self.take(_INTEGERS.size))
        if width not in _STEP_CODES:
            raise DamagedBlock(f"steps of {width} bytes")
        data = self._interleaved(width)
        begin, end = self.wanted.start, self.wanted.stop
        if data and data == data[:width] * (self._n - 1):
            step = int.from_bytes(data[:width], "little", signed=True)
            return _equal_steps(first + begin * step, step, end - begin)
        steps = unpack(_STEP_CODES[width], data)
        if begin:
            first += sum(steps[:begin])
        return list(accumulate(steps[begin : end - 1], initial=first))[: end - begin]

    def _interleaved(self, width: int) -> bytes:
        """Take the steps and return them number by number."""
        size = self._n - 1
        if width == 1:
            return self.take(size)
        planes, data = self.take(size * width), bytearray(size * width)
        for n in range(width):
            data[n::width] = planes[n * size : (n + 1) * size]
        return bytes(data)

    def floats(self) -> list[float]:
        places, exceptions = _FLOATS.unpack(self.take(_FLOATS.size))
        begin, end = self.wanted.start, self.wanted.stop
        if places == -1:
            return unpack_floats(self.take(8 * self._n)[8 * begin : 8 * end])
        if not 0 <= places <= _MAX_PLACES:
            raise DamagedBlock(f"{places} decimal places")
        positions = unpack("I", self.take(4 * exceptions))
        exact = unpack_floats(self.take(8 * exceptions))
        values = _restore(self.integers(), 10.0**places)
        for position, value in zip(positions, exact, strict=True):
            if position >= self._n:
                raise DamagedBlock(f"position {position} of {self._n}")
            if begin <= position < end:
                values[position - begin] = value
        return values
