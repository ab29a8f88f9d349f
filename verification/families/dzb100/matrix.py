"""DZB100 in the fault matrix."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from drivebus.protocols import dzb100
from verification.drive_variants import DriveVariant
from verification.fault_matrix.matrix_family import ErrorReply, MatrixFamily


def error_replies(variant: DriveVariant) -> tuple[ErrorReply, ...]:
    return ((7, _rejection),)


def _rejection(request: Any) -> dzb100.Dzb100Reply:
    return dzb100.Dzb100Reply(head="P", address=1, index=request.parameter, data=request.data, accepted=False)


def forbidden_broadcasts(variant: DriveVariant) -> Iterator[Any]:
    for command in ("FORWARD", "REVERSE", "JOG_FORWARD", "RESET"):
        yield dzb100.Dzb100Control(0, dzb100.Dzb100Command[command], 0, broadcast=True)


def falsify_state(variant: DriveVariant, data: bytes, *, stopped: bool) -> bytes:
    """Return the reply to Q01 with 0 or 10.0 Hz."""
    return data[:7] + (b"0000" if stopped else b"0064") + data[11:] if data[5:7] == b"01" else data


MATRIX = MatrixFamily(
    error_replies=error_replies,
    short_error=lambda variant, rng: None,
    forbidden_broadcasts=forbidden_broadcasts,
    falsify_state=falsify_state,
)
