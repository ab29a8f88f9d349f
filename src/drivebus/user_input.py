"""Texts that a user types or writes into a file: numbers, words for on and off, addresses, full-width characters."""

from __future__ import annotations

import re
from collections.abc import Iterable
from math import isinf

HEX_WORD = re.compile(r"0[xX]([0-9A-Fa-f]{1,4})|([0-9][0-9A-Fa-f]{0,4}|[A-Fa-f][0-9A-Fa-f]{3})[hH]", re.ASCII)
"""Hexadecimal notation of the manuals and of programmers: ``0010H``, ``FA00H``, ``0x10``; a letter first needs all four
digits, so that no name is taken for a number.
"""
DECIMAL_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?", re.ASCII)


def parse_decimal(text: str) -> float:
    """Return a number that a user typed. Raises ValueError for another notation, which ``float`` may read as a number.

    ``float("1_0")`` is ten, where a point or a second digit may have been meant; 400 digits are infinite.
    """
    if DECIMAL_NUMBER.fullmatch(text) is None or isinf(number := float(text)):
        raise ValueError(text)
    return number


YES_WORDS = frozenset({"y", "yes", "是"})
"""Answers that agree to a question, as ``normalize_answer`` returns them."""
_TRUE, _FALSE = frozenset({"true", "yes", "on", "1"}), frozenset({"false", "no", "off", "0"})


def parse_boolean(text: str) -> bool | None:
    """Return what a user typed for on or off (yes, true, 1, no, false, 0) in any case; None for another word."""
    word = text.lower()
    return True if word in _TRUE else False if word in _FALSE else None


_HALF_WIDTH = {code: code - 0xFEE0 for code in range(0xFF01, 0xFF5F)} | {
    ord(full): half for full, half in zip("\u3000。、“”‘’【】—–−", " .,\"\"''[]---", strict=True)
}
"""The signs of a Chinese input method, and their ASCII character where a command or a file needs that."""
_CHINESE_RANGE = re.compile(r"(?<=\d)～(?=\d)")


def half_width(text: str) -> str:
    """Return a text with ASCII characters in place of the full-width ones that a Chinese input method types.

    A Chinese range, ``1～8``, becomes ``1-8``.
    """
    return _CHINESE_RANGE.sub("-", text).translate(_HALF_WIDTH)


def normalize_answer(text: str) -> str:
    """Return a typed key or word as without Caps Lock and without the full-width mode of an input method."""
    return half_width(text).lower()


def parse_hex_word(text: str) -> int | None:
    """Return the 16-bit word of a hexadecimal notation; None for another notation or above FFFFH."""
    match = HEX_WORD.fullmatch(text)
    word = int(match[1] or match[2], 16) if match else None
    return word if word is not None and word <= 0xFFFF else None


HIGHEST_ADDRESS = 247
"""Highest station address of any model, that of Modbus; each model has its own range."""


def parse_addresses(text: str, highest: int = HIGHEST_ADDRESS) -> tuple[int, ...]:
    """Return the station addresses of ``0-3,7``, each once: 0, 1, 2, 3, 7.

    Raises ValueError for another notation, an address above ``highest``, and a range that ends before it begins.
    """
    addresses: list[int] = []
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        low, high = _parse_address(first, highest), _parse_address(last if dash else first, highest)
        if high < low:
            raise ValueError(part)
        addresses += range(low, high + 1)
    return tuple(dict.fromkeys(addresses))


def format_addresses(addresses: Iterable[int]) -> str:
    """Return ascending addresses as ``parse_addresses`` reads them: ``1-3,7``."""
    ranges: list[list[int]] = []
    for address in addresses:
        if ranges and ranges[-1][-1] == address - 1:
            ranges[-1][1:] = [address]
        else:
            ranges.append([address])
    return ",".join("-".join(map(str, ends)) for ends in ranges)


def _parse_address(text: str, highest: int) -> int:
    if not (text.isascii() and text.isdecimal() and int(text) <= highest):
        raise ValueError(text)
    return int(text)
