"""What a request does, read from its bytes by the manuals' tables alone: the observer's own alphabet.

No codec, profile or dialect of drivebus is used here, so that a misreading there is not repeated by whoever watches.
"""

from __future__ import annotations

from enum import StrEnum


class RequestEffect(StrEnum):
    """What a drive that obeys this request does."""

    READ = "read"
    SET = "set"
    """Writes a setpoint or a parameter, resets a fault."""
    MOVE = "move"
    """Starts or jogs the motor."""
    STOP = "stop"
    RELEASE = "rest"
    """VC660: the level bits without any pulse, written after each pulse."""


C320_STOP_OPERATIONS = frozenset({0x03, 0x06, 0x13, 0x16, 0x21})
"""C320 2.4.4: stop, jog stop, the same with a frequency, emergency stop."""
C320_MOTION_OPERATIONS = frozenset({0x01, 0x02, 0x04, 0x05, 0x11, 0x12, 0x14, 0x15})
DZB100_STOP_COMMANDS, DZB100_MOTION_COMMANDS = b"02", b"134567"
"""DZB100, MM: its low digit counts."""


def classify_request(family: str, encoding: str, frame: bytes) -> tuple[int, RequestEffect]:
    """The station that a request of drivebus speaks to, and what it does there.

    Raises ValueError or IndexError for bytes that the manual knows no request for.
    """
    if family == "c320":
        return _c320(frame) if encoding == "ascii" else _c320_hex(frame)
    if family == "dzb100":
        return _dzb100(frame)
    words = frame[:-2] if encoding == "rtu" else bytes.fromhex(frame[1:-2].decode())[:-1]
    return words[0], _vc660(words) if family == "vc660" else _df800(words)


def _c320(frame: bytes) -> tuple[int, RequestEffect]:
    return int(frame[1:3], 16), _c320_effect(int(frame[3:4]), int(frame[4:6], 16))


def _c320_hex(frame: bytes) -> tuple[int, RequestEffect]:
    return frame[2], _c320_effect(frame[3], frame[5])


def _c320_effect(kind: int, operation: int) -> RequestEffect:
    """The operation acts in every class (T01, T07)."""
    if operation in C320_STOP_OPERATIONS:
        return RequestEffect.STOP
    if operation in C320_MOTION_OPERATIONS:
        return RequestEffect.MOVE
    if operation in (0x10, 0x20) or kind in (3, 5):
        return RequestEffect.SET
    if operation or kind not in (0, 1, 2):
        raise ValueError(f"class {kind}, operation {operation:02X}")
    return RequestEffect.READ


def _dzb100(frame: bytes) -> tuple[int, RequestEffect]:
    address, head, command = int(frame[3:5]), frame[:1], frame[6:7]
    if head in (b"Q", b"R"):
        return address, RequestEffect.READ
    if head == b"P" or (head == b"C" and command == b"8"):
        return address, RequestEffect.SET
    if head != b"C" or command not in DZB100_STOP_COMMANDS + DZB100_MOTION_COMMANDS:
        raise ValueError(frame.hex(" "))
    return address, RequestEffect.STOP if command in DZB100_STOP_COMMANDS else RequestEffect.MOVE


def _vc660(words: bytes) -> RequestEffect:
    """2000H: b0 start, b1 stop, b3 and b4 jog, b5 coast, b6 emergency stop, b9 fault reset."""
    if words[1] in (3, 8):
        return RequestEffect.READ
    if words[1] != 6:
        raise ValueError(words.hex(" "))
    if words[2:4] != b"\x20\x00":
        return RequestEffect.SET
    if words[5] & 0x62:
        return RequestEffect.STOP
    if words[5] & 0x19:
        return RequestEffect.MOVE
    return RequestEffect.SET if words[4] & 0x02 else RequestEffect.RELEASE


def _df800(words: bytes) -> RequestEffect:
    """2000H: b1-b0 01 stop, 10 start, 11 jog; b4 fault reset."""
    if words[1] == 3:
        return RequestEffect.READ
    if words[1] != 6:
        raise ValueError(words.hex(" "))
    if words[2:4] != b"\x20\x00":
        return RequestEffect.SET
    return (RequestEffect.SET, RequestEffect.STOP, RequestEffect.MOVE, RequestEffect.MOVE)[words[5] & 3]
