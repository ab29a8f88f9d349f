"""VC660 and DF800 in the fault matrix."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from random import Random
from typing import Any

from drivebus.protocols import modbus
from verification.drive_variants import DriveVariant
from verification.fault_matrix.matrix_family import ErrorReply, MatrixFamily


def error_codes(variant: DriveVariant) -> tuple[int | None, ...]:
    """Return the error codes of the manuals: VC660 section 5, DF800 none."""
    return (1, 2, 3, 4) if variant.model == "vc660" else (None,)


def error_replies(variant: DriveVariant) -> tuple[ErrorReply, ...]:
    return tuple((code, partial(_exception, code)) for code in error_codes(variant))


def _exception(code: int | None, request: Any) -> modbus.ExceptionReply:
    return modbus.ExceptionReply(1, 6, code)


def short_error(variant: DriveVariant, rng: Random) -> tuple[Any, int]:
    reply = modbus.ExceptionReply(1, 3, rng.choice(error_codes(variant)))
    return reply, 5 if variant.encoding == "rtu" else 11


def forbidden_broadcasts(variant: DriveVariant) -> Iterator[Any]:
    words = ((0x2000, 0x01), (0x2000, 0x02), (0x2000, 0x10), (0x2000, 0x200), (0x2001, 500), (2, 500))
    stop = 0x02 if variant.model == "vc660" else 0x01
    for register, value in words:
        if (register, value) != (0x2000, stop):
            yield modbus.WriteRegister(0, register, value)


MATRIX = MatrixFamily(
    error_replies=error_replies,
    short_error=short_error,
    forbidden_broadcasts=forbidden_broadcasts,
    ram_parameters=frozenset({"F00.02"}),
)
