"""Mitsubishi's computer link in the fault matrix."""

from __future__ import annotations

from functools import partial
from random import Random
from typing import Any

from drivebus.families.mitsubishi import codec as f
from verification.drive_variants import DriveVariant
from verification.families.mitsubishi.facts import EFFECTS
from verification.fault_matrix.matrix_family import ErrorReply, MatrixFamily
from verification.reference.mitsubishi import MitsubishiReference

STATUS_SIZE, FREQUENCY_SIZE = 8, 10
"""Characters of the replies to 7A and 6F."""


def error_replies(variant: DriveVariant) -> tuple[ErrorReply, ...]:
    """Return a NAK with each error digit."""
    return tuple((code, partial(_rejection, code)) for code in range(16))


def _rejection(code: int, request: Any) -> f.MitsubishiReply:
    return f.MitsubishiReply(1, error=code)


def short_error(variant: DriveVariant, rng: Random) -> tuple[Any, int]:
    return f.MitsubishiReply(1, error=rng.randrange(16)), 4


def undocumented_commands(variant: DriveVariant) -> tuple[Any, ...]:
    return tuple(f.MitsubishiRequest(1, f.RUN_COMMAND, value) for value in range(256) if value not in EFFECTS)


def falsify_state(variant: DriveVariant, data: bytes, *, stopped: bool) -> bytes:
    """Return the reply with no bit and 0 Hz, or with forward and 20 Hz, and a correct sum."""
    if len(data) not in (STATUS_SIZE, FREQUENCY_SIZE) or data[:1] != b"\x02":
        return data
    status = len(data) == STATUS_SIZE
    digits = (b"00" if stopped else b"03") if status else (b"0000" if stopped else b"07D0")
    return MitsubishiReference().reseal(data[:3] + digits + data[-3:])


MATRIX = MatrixFamily(
    error_replies=error_replies,
    short_error=short_error,
    undocumented_commands=undocumented_commands,
    falsify_state=falsify_state,
)
