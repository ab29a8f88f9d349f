"""How a C320 may spell its replies where the manual prints frames in two ways [OPEN]. Pure; bytes in, bytes out.

Written from the printed frames, not from the host's reader: ``digits`` is T02, ``nibbles`` is T03.
"""

from __future__ import annotations

from drivebus.protocols.checksum import sum16

_ODD_DIGITS = bytes.maketrans(b"ABCDEF", b":;<=>?")
_FIELD_WIDTHS = {12: (2, 1, 2, 1, 2, 4), 5: (2, 1, 2)}
"""Digits of each field of a whole and of a short reply, by the length of the fields together."""


def tolerant_digits(frame: bytes) -> bytes:
    """An ASCII frame with 3AH-3FH for the digits A-F, in its sum too (manual 4.5). Hex frames as they are."""
    if frame[:1] != b"*":
        return frame
    body = frame[1:-5].translate(_ODD_DIGITS)
    return b"*%b%b\r" % (body, (b"%04X" % sum16(body)).translate(_ODD_DIGITS))


def unpacked_nibbles(frame: bytes) -> bytes:
    """A hex frame with a digit in each byte and a packed sum (manual 4.5, 4.6). ASCII frames as they are."""
    if frame[:1] != b"Z":
        return frame
    body, at = b"", 1
    for width in _FIELD_WIDTHS[len(frame) - 6]:
        body += _unpack_field(frame[at : at + width])
        at += width
    return b"Z%b%b\r" % (body, sum16(body).to_bytes(4, "big"))


def _unpack_field(packed: bytes) -> bytes:
    """Identity digits stand one in a byte already."""
    value, width = int.from_bytes(packed, "big"), len(packed)
    if value >= 16**width:
        return packed
    return bytes(value >> 4 * place & 0xF for place in reversed(range(width)))
