"""What a C320 request does to the drive that obeys it, from its bytes alone. Doubt counts as motion."""

from __future__ import annotations

from drivebus.errors import ProtocolError
from drivebus.message import Complete, Effect
from drivebus.protocols.checksum import STRICT
from drivebus.protocols.sifang.frame import ASCII_HEAD, AsciiForm, PackedForm
from drivebus.protocols.sifang.messages import Control, Heard, WriteParameter
from drivebus.protocols.sifang.requests import hear
from drivebus.protocols.sifang.tables import Operation

OPERATION_EFFECTS = {
    Operation.NONE: Effect.NONE,
    Operation.STOP: Effect.STOP,
    Operation.JOG_STOP: Effect.STOP,
    Operation.STOP_AT: Effect.STOP,
    Operation.JOG_STOP_AT: Effect.STOP,
    Operation.EMERGENCY_STOP: Effect.STOP,
    Operation.SET_FREQUENCY: Effect.SETTING,
    Operation.RESET_FAULT: Effect.SETTING,
}
"""The others move."""
_ASCII = AsciiForm(STRICT)
_PACKED = PackedForm()


def effect(frame: bytes) -> Effect:
    """The effect of one whole request. The operation acts in every class (T01).

    STOP only where the frame can do nothing but take motion away: a stop that also brings a frequency or writes a
    parameter is a SETTING. A frame that is not canonical, not whole or followed by anything is MOTION.
    """
    try:
        verdict = hear(_ASCII if frame[:1] == bytes((ASCII_HEAD,)) else _PACKED, frame)
    except ProtocolError:
        return Effect.MOTION
    if not isinstance(verdict, Complete) or verdict.size != len(frame):
        return Effect.MOTION
    return _of(verdict.message)


def _of(heard: Heard) -> Effect:
    ordered = OPERATION_EFFECTS.get(heard.operation, Effect.MOTION)
    request = heard.request
    writes = isinstance(request, WriteParameter) or (isinstance(request, Control) and request.data != 0)
    return Effect.SETTING if writes and ordered is not Effect.MOTION else ordered
