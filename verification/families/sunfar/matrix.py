"""C320 in the fault matrix."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from random import Random
from typing import Any

from drivebus.protocols import sunfar
from verification.drive_variants import DriveVariant
from verification.fault_matrix.matrix_family import ErrorReply, MatrixFamily

ERROR_CODES = (1, 2, 3, 4, 6, 7, 8)
SHORT_CODES = (6, 7, 8)
"""2.4.5: the short form, 11 characters."""


def error_replies(variant: DriveVariant) -> tuple[ErrorReply, ...]:
    return tuple((code, partial(_error_reply, code)) for code in ERROR_CODES)


def _error_reply(code: int, request: Any) -> sunfar.SunfarReply:
    response = sunfar.SunfarResponse(code)
    if code in SHORT_CODES:
        return sunfar.SunfarReply(address=1, response=response)
    state, group, item = sunfar.SunfarState.STOPPED, request.group, request.item
    return sunfar.SunfarReply(address=1, response=response, state=state, group=group, item=item, data=0)


def short_error(variant: DriveVariant, rng: Random) -> tuple[Any, int]:
    return sunfar.SunfarReply(address=1, response=sunfar.SunfarResponse(rng.choice(SHORT_CODES))), 11


def forbidden_broadcasts(variant: DriveVariant) -> Iterator[Any]:
    for operation in ("RUN_FORWARD", "RUN_REVERSE_AT", "JOG_FORWARD", "SET_FREQUENCY", "RESET_FAULT"):
        yield sunfar.SunfarControl(31, sunfar.SunfarOperation[operation], 0)
    yield sunfar.SunfarWriteParameter(31, 1, 10, 0, False)


def falsify_state(variant: DriveVariant, data: bytes, *, stopped: bool) -> bytes:
    """Return the reply with 03H or 01H in the state field and a correct sum."""
    if len(data) != 18:
        return data
    hexed = variant.encoding == "hex"
    state = bytes((0, 3) if stopped else (0, 1)) if hexed else b"03" if stopped else b"01"
    body = data[1:4] + state + data[6:13]
    total = sum(body) & 0xFFFF
    return data[:1] + body + (total.to_bytes(4) if hexed else b"%04X" % total) + data[17:]


MATRIX = MatrixFamily(
    error_replies=error_replies,
    short_error=short_error,
    forbidden_broadcasts=forbidden_broadcasts,
    falsify_state=falsify_state,
    ram_parameters=frozenset({"F1.10"}),
)
