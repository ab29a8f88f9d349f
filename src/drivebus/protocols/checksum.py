"""Checksums and strict digits that the protocols share.

Digits are decoded by 256-entry tables, because ``int(text, 16)`` also accepts ``+1``, `` 1`` and ``1_0``.
"""

from __future__ import annotations

from drivebus.errors import AlphabetError

_NOT_A_DIGIT = 0
"""Table entry of a byte that is no digit."""


def _digit_table(*spellings: tuple[bytes, bytes]) -> bytes:
    """Return a table from every allowed spelling to its canonical digit, and from other bytes to ``_NOT_A_DIGIT``."""
    table = bytearray(256)
    for written, meant in spellings:
        for byte, digit in zip(written, meant, strict=True):
            table[byte] = digit
    return bytes(table)


_CANONICAL_DIGITS = b"0123456789ABCDEF"
DECIMAL_DIGITS = _digit_table((_CANONICAL_DIGITS[:10], _CANONICAL_DIGITS[:10]))
"""0-9."""
STRICT_HEX_DIGITS = _digit_table((_CANONICAL_DIGITS, _CANONICAL_DIGITS))
"""0-9 and A-F (41H-46H)."""
TOLERANT_HEX_DIGITS = _digit_table(
    (_CANONICAL_DIGITS, _CANONICAL_DIGITS), (b"abcdef", b"ABCDEF"), (b"\x3a\x3b\x3c\x3d\x3e\x3f", b"ABCDEF")
)
"""Also a-f and 3AH-3FH, the second spelling of A-F in the C320 manual."""


def _crc_entry(byte: int) -> int:
    for _ in range(8):
        byte = (byte >> 1) ^ 0xA001 if byte & 1 else byte >> 1
    return byte


_CRC_TABLE = tuple(map(_crc_entry, range(256)))


def sum16(data: bytes) -> int:
    """Return the 16-bit sum of the bytes (Sunfar)."""
    return sum(data) & 0xFFFF


def lrc(data: bytes) -> int:
    """Return the LRC of Modbus ASCII: two's complement of the sum of the *decoded* bytes."""
    return -sum(data) & 0xFF


def crc16(data: bytes, crc: int = 0xFFFF) -> int:
    """Return the CRC-16/MODBUS (polynomial A001H reflected, start FFFFH); its low byte is sent first.

    ``crc`` is the CRC of the preceding bytes. Over a whole frame with its CRC the result is 0.
    """
    table = _CRC_TABLE
    for byte in data:
        crc = (crc >> 8) ^ table[(crc ^ byte) & 0xFF]
    return crc


def hex_digits(value: int, width: int) -> bytes:
    """Return ``value`` as ``width`` upper-case ASCII hex digits. Raises ValueError where it does not fit."""
    if not 0 <= value < 1 << 4 * width:
        raise ValueError(f"{value} does not fit {width} hex digits")
    return b"%0*X" % (width, value)


def decimal_digits(value: int, width: int) -> bytes:
    """Return ``value`` as ``width`` ASCII decimal digits. Raises ValueError where it does not fit."""
    if not 0 <= value < 10**width:
        raise ValueError(f"{value} does not fit {width} decimal digits")
    return b"%0*d" % (width, value)


def hex_pairs(data: bytes) -> bytes:
    """Return each byte as two upper-case ASCII hex digits (Modbus ASCII)."""
    return data.hex().upper().encode("ascii")


def canonical_digits(digits: bytes, table: bytes = STRICT_HEX_DIGITS, start: int = 0) -> bytes:
    """Return the digits in their canonical spelling.

    Raises AlphabetError with the first bad byte and its position (counted from ``start``).
    """
    canonical = digits.translate(table)
    if _NOT_A_DIGIT in canonical:
        raise _alphabet_error("0-9 A-F", digits, canonical, start)
    return canonical


def _alphabet_error(expected: str, digits: bytes, canonical: bytes, start: int) -> AlphabetError:
    at = canonical.index(_NOT_A_DIGIT)
    return AlphabetError("protocols.alphabet", expected=expected, found=digits[at], position=start + at)


def hex_value(digits: bytes, start: int = 0) -> int:
    """Return the number in ASCII hex digits. Raises AlphabetError for anything but 0-9 and A-F."""
    return int(canonical_digits(digits, start=start), 16)


def decimal_value(digits: bytes, start: int = 0) -> int:
    """Return the number in ASCII decimal digits. Raises AlphabetError for anything but 0-9."""
    canonical = digits.translate(DECIMAL_DIGITS)
    if _NOT_A_DIGIT in canonical:
        raise _alphabet_error("0-9", digits, canonical, start)
    return int(canonical)


def hex_bytes(digits: bytes, *, start: int = 0) -> bytes:
    """Return the bytes in pairs of hex digits. Raises AlphabetError for a bad digit, ValueError for an odd count."""
    return bytes.fromhex(canonical_digits(digits, start=start).decode("ascii"))
