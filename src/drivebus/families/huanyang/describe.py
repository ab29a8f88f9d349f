"""Descriptions of Huanyang frames for people. The codec decides validity."""

from __future__ import annotations

from typing import Any

from drivebus.errors import ProtocolError
from drivebus.families.huanyang.codec import (
    CONTROL,
    FREQUENCY,
    READ,
    RUN_FORWARD,
    RUN_REVERSE,
    STATUS,
    STOP,
    WRITE,
    ControlState,
    HuanyangCodec,
    HuanyangReply,
    HuanyangRequest,
    frame_effect,
)
from drivebus.profiles import DriveProfile
from drivebus.profiles.notation import format_locator
from drivebus.protocols.codec import Effect, canonical_request
from drivebus.protocols.describe import FrameDescription, FrameDirection, decode_frame, error_note, note

COMMAND_NAMES = {RUN_FORWARD: "run_forward", RUN_REVERSE: "run_reverse", STOP: "stop"}
_CODEC = HuanyangCodec()


def describe(
    profile: DriveProfile, data: bytes, encoding: str, direction: FrameDirection | None, request: bytes | None
) -> FrameDescription:
    """Describe a frame. Without ``direction`` and ``request``, bytes that are a request are one.

    The reply to a control request has the form of a control request: only the request before it tells them apart.
    """
    guessed = direction or ("response" if request is not None or canonical_request(_CODEC, data) is None else "request")
    try:
        message: HuanyangRequest | HuanyangReply = decode_frame(_CODEC, data, guessed, request, _fitting_request)
    except ProtocolError as error:
        return FrameDescription(
            family="huanyang", encoding="rtu", direction=guessed, valid=False, problems=(error_note(error),)
        )
    moves = guessed == "request" and frame_effect(data) is Effect.MOTION
    return FrameDescription(
        family="huanyang",
        encoding="rtu",
        direction=guessed,
        valid=True,
        fields=_fields(profile, message),
        hazards=(note("huanyang.moves", address=data[0]),) if moves else (),
        canonical=data,
    )


def _fitting_request(data: bytes) -> HuanyangRequest:
    """Return a request that this reply would fit."""
    address, function = data[0] if data else 0, data[1] & 0x7F if len(data) > 1 else READ
    value = int.from_bytes(data[3:5], "big") if function == FREQUENCY else 0
    return HuanyangRequest(address, function, data[3] if len(data) > 3 else 0, value)


def _fields(profile: DriveProfile, message: HuanyangRequest | HuanyangReply) -> dict[str, Any]:
    fields: dict[str, Any] = {"address": message.address, "function": message.function}
    if isinstance(message, HuanyangReply):
        fields["accepted"] = message.accepted
        if not message.accepted:
            return fields | {"data": message.index}
    if message.function in (READ, WRITE):
        fields["notation"] = format_locator(("parameter", message.index), profile)
    elif message.function == STATUS:
        fields["notation"] = format_locator(("item", message.index), profile)
    if message.function == CONTROL and isinstance(message, HuanyangReply):
        fields["state_bits"] = [str(bit.name).lower() for bit in ControlState if message.value & bit]
    elif message.function == CONTROL:
        fields |= {"command": message.value, "name": COMMAND_NAMES.get(message.value, "")}
    has_value = isinstance(message, HuanyangReply) or message.function in (WRITE, FREQUENCY)
    return fields | ({"data": message.value} if has_value else {})
