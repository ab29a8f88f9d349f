"""Pieces that Modbus requests and replies share: words and bits as octets, and ranges. No message and no check.

``octets`` in this package are the station address and the PDU: RTU sends them as they are, ASCII as digits.
"""

from __future__ import annotations

from struct import Struct
from struct import error as StructError
from typing import Final

from drivebus.errors import CodeError

FIXED_PDU: Final = Struct(">BBHH")
"""Address, function and two words: most requests and every echo."""
WORD_STRUCTS: Final = tuple(Struct(f">{count}H") for count in range(126))
COIL_ON: Final = 0xFF00
COIL_OFF: Final = 0x0000
"""The two values of a coil (05)."""


def check_range(name: str, value: int, low: int, high: int) -> int:
    """The value. Raises ValueError with it and its limits where it lies outside."""
    if not low <= value <= high:
        raise ValueError(f"{name} {value}: expected {low} to {high}")
    return value


def pack_words(values: tuple[int, ...]) -> bytes:
    """Registers to octets, high byte first. Raises ValueError for a value beyond 16 bits."""
    try:
        return WORD_STRUCTS[len(values)].pack(*values)
    except StructError:
        for value in values:
            check_range("value", value, 0, 0xFFFF)
        raise


def pack_bits(bits: tuple[bool, ...]) -> bytes:
    """Bits to octets, the first in the lowest place (V1.1b3, 6.1)."""
    number = sum(1 << place for place, bit in enumerate(bits) if bit)
    return number.to_bytes(-(-len(bits) // 8), "little")


def unpack_bits(octets: bytes, count: int) -> tuple[bool, ...]:
    """The first ``count`` bits. Raises CodeError where the padding is not zero (V1.1b3, 6.1)."""
    number = int.from_bytes(octets, "little")
    if number >> count:
        raise CodeError("modbus.padding", expected=0, found=number >> count)
    return tuple(bool(number >> place & 1) for place in range(count))
