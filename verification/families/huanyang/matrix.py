"""Huanyang HY in the fault matrix."""

from __future__ import annotations

from collections.abc import Iterator
from random import Random
from typing import Any

from drivebus.families.huanyang import codec as h
from verification.drive_variants import DriveVariant
from verification.families.huanyang.facts import EFFECTS
from verification.fault_matrix.matrix_family import ErrorReply, MatrixFamily


def error_replies(variant: DriveVariant) -> tuple[ErrorReply, ...]:
    """Return the rejection, which names the parameter."""
    return ((14, lambda request: h.HuanyangReply(1, request.function, request.index, accepted=False)),)


def short_error(variant: DriveVariant, rng: Random) -> tuple[Any, int]:
    return h.HuanyangReply(1, h.STATUS, rng.randrange(256), accepted=False), 6


def forbidden_broadcasts(variant: DriveVariant) -> Iterator[Any]:
    yield from (h.control(0, 0x01), h.control(0, 0x11), h.set_frequency(0, 500), h.write_parameter(0, 14, 10, 2))


def undocumented_commands(variant: DriveVariant) -> tuple[Any, ...]:
    return tuple(h.control(1, value) for value in range(256) if value not in EFFECTS)


MATRIX = MatrixFamily(
    error_replies=error_replies,
    short_error=short_error,
    forbidden_broadcasts=forbidden_broadcasts,
    undocumented_commands=undocumented_commands,
)
