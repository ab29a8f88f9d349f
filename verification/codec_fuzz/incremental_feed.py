"""Bytes into a decoder in every way they may come: whole, byte by byte, as it asks for them, in random pieces.

A decoder is pure: it is given the beginning of the bytes again and again. So what it says of every beginning, up to the
first that is final, tells what any pieces would have got: the first final answer at or after it. Of the beginnings
beyond the first final one, one at random and the one that ``need`` would have led to are tried besides the whole.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from drivebus.errors import ProtocolError
from drivebus.protocols.codec import Complete, CompleteIfSilent, DecodeResult, Incomplete

DecodeFunction = Callable[[bytes], DecodeResult]


@dataclass(frozen=True, slots=True)
class RefusedBytes:
    """A protocol error with all that it says."""

    kind: str
    key: str
    params: dict[str, Any]
    size: int


DecodeOutcome = DecodeResult | RefusedBytes


def decode_outcome(decode: DecodeFunction, data: bytes) -> DecodeOutcome:
    """What the decoder says, its protocol error told as a value; anything else escapes (I8)."""
    try:
        return decode(data)
    except ProtocolError as error:
        return RefusedBytes(type(error).__name__, error.key, error.params, error.size)


def feed_incrementally(decode: DecodeFunction, data: bytes, cut: float, longest: int) -> tuple[DecodeOutcome, str]:
    """The answer to the whole, and what is wrong with how it came about ("" if nothing).

    ``cut``: 0 to 1, where the random piece ends. ``longest``: no more bytes than that may ever be needed.
    """
    whole, end, need, asked_at = None, 0, 0, 0
    total = len(data)
    for end in range(total + 1):
        found = decode_outcome(decode, data[:end])
        if isinstance(found, Incomplete):
            if not (end < found.need <= longest and need <= found.need):
                return found, f"need {found.need} at {end} bytes, {need} before"
        elif not isinstance(found, CompleteIfSilent) or end == total:
            whole = found
            break
        elif found.need <= end or found.size > end:
            return found, f"{found} at {end} bytes"
        if end >= asked_at:
            asked_at = found.need
        need = found.need
    else:
        return found, ""
    if isinstance(whole, Complete) and (end < need or whole.size > end):
        return whole, f"{whole} at {end} bytes, {need} needed"
    for place in {total, max(end, min(total, asked_at)), end + int(cut * (total - end))} - {end}:
        again = decode_outcome(decode, data[:place])
        if again != whole:
            return whole, f"{place} bytes: {again}; {end} bytes: {whole}"
    return whole, ""


def accepted_size(what: DecodeOutcome, data: bytes) -> int | None:
    """How many of these bytes are the message, if nothing follows them; None: they are none."""
    if isinstance(what, Complete) or (isinstance(what, CompleteIfSilent) and what.size == len(data)):
        return what.size
    return None
