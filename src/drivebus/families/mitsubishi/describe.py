"""Descriptions of computer link frames for people. The codec decides validity."""

from __future__ import annotations

from typing import Any

from drivebus.errors import ProtocolError
from drivebus.families.mitsubishi.codec import (
    ENQ,
    OUTPUT_FREQUENCY,
    READ_DIGITS,
    RUN_COMMAND,
    RUN_FORWARD,
    RUN_REVERSE,
    SET_FREQUENCY,
    STATUS,
    STOP,
    STX,
    MitsubishiCodec,
    MitsubishiReply,
    MitsubishiRequest,
    frame_effect,
)
from drivebus.profiles import DriveProfile
from drivebus.protocols.codec import Effect
from drivebus.protocols.describe import FrameDescription, FrameDirection, decode_frame, error_note, note

COMMAND_NAMES = {STOP: "stop", RUN_FORWARD: "run_forward", RUN_REVERSE: "run_reverse"}
STATUS_REPLY_SIZE = 8
_CODEC = MitsubishiCodec()


def describe(
    profile: DriveProfile, data: bytes, encoding: str, direction: FrameDirection | None, request: bytes | None
) -> FrameDescription:
    """Describe a frame; the direction follows from its first byte."""
    chosen = direction or ("request" if request is None and data[:1] == bytes((ENQ,)) else "response")
    try:
        message: MitsubishiRequest | MitsubishiReply = decode_frame(_CODEC, data, chosen, request, _fitting_request)
    except ProtocolError as error:
        return FrameDescription(
            family="mitsubishi", encoding="ascii", direction=chosen, valid=False, problems=(error_note(error),)
        )
    moves = chosen == "request" and frame_effect(data) is Effect.MOTION
    return FrameDescription(
        family="mitsubishi",
        encoding="ascii",
        direction=chosen,
        valid=True,
        fields=_reply_fields(message) if isinstance(message, MitsubishiReply) else _request_fields(message),
        hazards=(note("mitsubishi.moves", address=message.address),) if moves else (),
        canonical=data,
    )


def _fitting_request(data: bytes) -> MitsubishiRequest:
    """Return a request to the same station that this reply would fit."""
    try:
        address = int(data[1:3], 16)
    except ValueError:
        address = 0
    read = STATUS if len(data) <= STATUS_REPLY_SIZE else OUTPUT_FREQUENCY
    return MitsubishiRequest(address, read if data[:1] == bytes((STX,)) else SET_FREQUENCY)


def _request_fields(request: MitsubishiRequest) -> dict[str, Any]:
    fields: dict[str, Any] = {"address": request.address, "notation": f"H{request.code:02X}"}
    if request.code == RUN_COMMAND:
        return fields | {"command": request.data, "name": COMMAND_NAMES.get(request.data, "")}
    return fields if request.code in READ_DIGITS else fields | {"data": request.data}


def _reply_fields(reply: MitsubishiReply) -> dict[str, Any]:
    fields: dict[str, Any] = {"address": reply.address, "accepted": reply.error is None}
    if reply.error is not None:
        return fields | {"error": reply.error}
    return fields | ({"data": reply.data} if reply.digits else {})
