"""What a C320 request does to the drive that obeys it, from its bytes alone. Doubt counts as motion."""

from __future__ import annotations

from drivebus.errors import ProtocolError
from drivebus.protocols.checksum import STRICT_HEX_DIGITS
from drivebus.protocols.codec import Complete, Effect
from drivebus.protocols.sunfar.frame import ASCII_HEAD, AsciiFormat, PackedFormat
from drivebus.protocols.sunfar.messages import ReceivedRequest, SunfarControl, SunfarWriteParameter
from drivebus.protocols.sunfar.requests import decode_request
from drivebus.protocols.sunfar.tables import SunfarOperation

OPERATION_EFFECTS = {
    SunfarOperation.NONE: Effect.NONE,
    SunfarOperation.STOP: Effect.STOP,
    SunfarOperation.JOG_STOP: Effect.STOP,
    SunfarOperation.STOP_AT: Effect.STOP,
    SunfarOperation.JOG_STOP_AT: Effect.STOP,
    SunfarOperation.EMERGENCY_STOP: Effect.STOP,
    SunfarOperation.SET_FREQUENCY: Effect.SETTING,
    SunfarOperation.RESET_FAULT: Effect.SETTING,
}
"""The others move."""
_ASCII_FORMAT = AsciiFormat(STRICT_HEX_DIGITS)
_PACKED_FORMAT = PackedFormat()


def classify_frame(frame: bytes) -> Effect:
    """The effect of one whole request. The operation acts in every class (T01).

    STOP only where the frame can do nothing but take motion away: a stop that also brings a frequency or writes a
    parameter is a SETTING. A frame that is not canonical, not whole or followed by anything is MOTION.
    """
    try:
        verdict = decode_request(_ASCII_FORMAT if frame[:1] == bytes((ASCII_HEAD,)) else _PACKED_FORMAT, frame)
    except ProtocolError:
        return Effect.MOTION
    if not isinstance(verdict, Complete) or verdict.size != len(frame):
        return Effect.MOTION
    return _request_effect(verdict.message)


def _request_effect(heard: ReceivedRequest) -> Effect:
    ordered = OPERATION_EFFECTS.get(heard.operation, Effect.MOTION)
    request = heard.request
    writes = isinstance(request, SunfarWriteParameter) or (isinstance(request, SunfarControl) and request.data != 0)
    return Effect.SETTING if writes and ordered is not Effect.MOTION else ordered
