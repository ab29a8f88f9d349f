"""What a frame may do to a motor, read from its bytes by the manuals' tables alone: no codec, no dialect, no profile.

A second reading of the manuals for the gate campaign. Where the manual does not name a code, it may move.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum


class FrameEffect(Enum):
    """What the bytes do, worst first."""

    MOTION = "moves"
    """Starts, jogs or turns round a motor, or nobody published what it does."""
    SETTING = "sets"
    """Acts, and starts nothing: a setpoint, a fault reset, a parameter."""
    STOP = "stops"
    """Can only take motion away."""
    READ = "reads"


C320_START_OPERATIONS = frozenset({0x01, 0x02, 0x04, 0x05, 0x11, 0x12, 0x14, 0x15})
"""Manual 2.4.4: run and jog either way, without and with a frequency. They act in every class (T01)."""
C320_STOP_ONLY_OPERATIONS = frozenset({0x03, 0x06, 0x21})
C320_REQUEST_LENGTHS = {0: 14, 1: 14, 2: 14, 3: 18, 4: 15, 5: 18}


def c320(frame: bytes, held: int = 0) -> FrameEffect:
    """``2AH``, address(2), class(1), operation(2), …: hexadecimal digits (manual 2.3)."""
    if len(frame) < 6 or frame[0] != 0x2A or C320_REQUEST_LENGTHS.get(frame[3] - 0x30) != len(frame):
        return FrameEffect.MOTION
    kind, operation = frame[3] - 0x30, int(frame[4:6].decode("ascii"), 16)
    if operation in C320_START_OPERATIONS or operation not in {0x00, 0x03, 0x06, 0x10, 0x13, 0x16, 0x20, 0x21}:
        return FrameEffect.MOTION
    if operation == 0:
        return FrameEffect.READ if kind < 3 else FrameEffect.SETTING
    return FrameEffect.STOP if kind == 4 and operation in C320_STOP_ONLY_OPERATIONS else FrameEffect.SETTING


def dzb100(frame: bytes, held: int = 0) -> FrameEffect:
    """Eleven bytes: head, 03H, A, address(2), command(2), data(4). MM: the low digit counts."""
    if len(frame) != 11 or frame[0] not in b"CPRQ":
        return FrameEffect.MOTION
    if frame[0] != ord("C"):
        return FrameEffect.SETTING if frame[0] == ord("P") else FrameEffect.READ
    if frame[6] in b"02":
        return FrameEffect.STOP if frame[7:11] == b"0000" else FrameEffect.MOTION  # T11: a flipped bit of it is a run
    return FrameEffect.SETTING if frame[6] in b"8" else FrameEffect.MOTION


VC660_STARTS, VC660_STOPS, VC660_REVERSE, VC660_RESET = (
    0x0001 | 0x0008 | 0x0010,
    0x0002 | 0x0020 | 0x0040,
    0x0004,
    0x0200,
)
"""2000H: b0 start, b3 and b4 jog; b1 stop, b5 coast, b6 emergency stop; b2 direction; b9 fault reset (manual §5)."""


def vc660(frame: bytes, held: int = 0) -> FrameEffect:
    """A write to 2000H, or none. ``held``: the word sent before; a changed direction turns a running motor round."""
    value = _command_or_effect(frame)
    if isinstance(value, FrameEffect):
        return value
    known = VC660_STARTS | VC660_STOPS | VC660_REVERSE | VC660_RESET
    if value & ~known or value & VC660_STARTS:
        return FrameEffect.MOTION
    if value & VC660_STOPS:
        return FrameEffect.STOP
    if (value ^ held) & VC660_REVERSE:
        return FrameEffect.MOTION
    return FrameEffect.SETTING if value & VC660_RESET else FrameEffect.STOP


def df800(frame: bytes, held: int = 0) -> FrameEffect:
    """2000H: b1 b0 = 01 stop, 10 start, 11 jog; two direction bits; b4 fault reset (manual, communication)."""
    value = _command_or_effect(frame)
    if isinstance(value, FrameEffect):
        return value
    return {0x00: FrameEffect.STOP, 0x01: FrameEffect.STOP, 0x10: FrameEffect.SETTING}.get(value, FrameEffect.MOTION)


def _command_or_effect(frame: bytes) -> FrameEffect | int:
    """The word that a Modbus RTU frame writes to 2000H; else what the frame does."""
    if len(frame) != 8:
        return FrameEffect.MOTION
    function, register = frame[1], frame[2] << 8 | frame[3]
    if function in (3, 8):
        return FrameEffect.READ
    if function != 6 or 0x2002 <= register <= 0x2FFF:
        return FrameEffect.MOTION
    return frame[4] << 8 | frame[5] if register == 0x2000 else FrameEffect.SETTING


EFFECT_READERS: dict[str, Callable[[bytes, int], FrameEffect]] = {
    "c320": c320,
    "dzb100": dzb100,
    "vc660": vc660,
    "df800": df800,
}


def command_word(frame: bytes) -> int | None:
    """The word that a Modbus frame writes to 2000H: what a VC660 holds from then on; None where it writes none."""
    value = _command_or_effect(frame)
    return None if isinstance(value, FrameEffect) else value
