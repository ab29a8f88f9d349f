"""Effect of a request on a drive, read from its bytes by the manuals' tables alone.

``classify_request`` takes requests that the manuals define and raises for others; ``worst_effect`` takes any bytes and
assumes motion wherever no manual names what they do.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import StrEnum

from verification.drive_variants import DriveVariant


class RequestEffect(StrEnum):
    """Effect on a drive that executes the request."""

    READ = "read"
    SETTING = "set"
    """Writes a setpoint or a parameter, or resets a fault; starts nothing."""
    MOTION = "move"
    """Starts or jogs the motor, or turns it round."""
    STOP = "stop"
    """Can only take motion away."""
    RELEASE = "rest"
    """VC660: the level bits without any pulse, written after each pulse."""


C320_STOPS = frozenset({0x03, 0x06, 0x21})
"""C320 2.4.4: stop, jog stop, emergency stop."""
C320_STOPS_WITH_FREQUENCY = frozenset({0x13, 0x16})
C320_MOTIONS = frozenset({0x01, 0x02, 0x04, 0x05, 0x11, 0x12, 0x14, 0x15})
"""C320 2.4.4: run and jog either way, without and with a frequency. They act in every class (T01, T07)."""
C320_SETTINGS = frozenset({0x10, 0x20})
"""C320 2.4.4: set frequency, fault reset."""
C320_LENGTHS = {0: 14, 1: 14, 2: 14, 3: 18, 4: 15, 5: 18}
C320_WRITES = (3, 5)
C320_CONTROL = 4
DZB100_STOPS, DZB100_MOTIONS, DZB100_RESET = b"02", b"134567", b"8"
"""DZB100, low digit of MM."""
COMMAND_REGISTER = 0x2000
"""VC660 and DF800; up to 2FFFH only 2001H, the setpoint, is published besides."""
VC660_STARTS = 0x0001 | 0x0008 | 0x0010
"""VC660 §5: b0 start, b3 and b4 jog."""
VC660_STOPS = 0x0002 | 0x0020 | 0x0040
"""VC660 §5: b1 stop, b5 coast, b6 emergency stop."""
VC660_REVERSE, VC660_RESET = 0x0004, 0x0200
"""VC660 §5: b2 direction, b9 fault reset."""


def classify_request(family: str, encoding: str, frame: bytes) -> tuple[int, RequestEffect]:
    """Return a request's address and effect. Raises ValueError or IndexError for what the manual does not define."""
    if family == "c320":
        address, kind, operation = _c320_fields(encoding, frame)
        return address, _c320_effect(kind, operation)
    if family == "dzb100":
        return int(frame[3:5]), _dzb100_effect(frame)
    octets = modbus_octets(encoding, frame)
    return octets[0], _vc660_effect(octets) if family == "vc660" else _df800_effect(octets)


def modbus_octets(encoding: str, frame: bytes) -> bytes:
    """Return a Modbus frame without its check."""
    return frame[:-2] if encoding == "rtu" else bytes.fromhex(frame[1:-2].decode())[:-1]


def _c320_fields(encoding: str, frame: bytes) -> tuple[int, int, int]:
    """Return address, class and operation (2.3)."""
    if encoding == "ascii":
        return int(frame[1:3], 16), int(frame[3:4]), int(frame[4:6], 16)
    return frame[2], frame[3], frame[5]


def _c320_effect(kind: int, operation: int) -> RequestEffect:
    if operation in C320_STOPS | C320_STOPS_WITH_FREQUENCY:
        return RequestEffect.STOP
    if operation in C320_MOTIONS:
        return RequestEffect.MOTION
    if operation in C320_SETTINGS or kind in C320_WRITES:
        return RequestEffect.SETTING
    if operation or kind not in (0, 1, 2):
        raise ValueError(f"class {kind}, operation {operation:02X}")
    return RequestEffect.READ


def _dzb100_effect(frame: bytes) -> RequestEffect:
    head, command = frame[:1], frame[6:7]
    if head in (b"Q", b"R"):
        return RequestEffect.READ
    if head == b"P" or (head == b"C" and command == DZB100_RESET):
        return RequestEffect.SETTING
    if head != b"C" or not command or command not in DZB100_STOPS + DZB100_MOTIONS:
        raise ValueError(frame.hex(" "))
    return RequestEffect.STOP if command in DZB100_STOPS else RequestEffect.MOTION


def _vc660_effect(octets: bytes) -> RequestEffect:
    value = _command_or_effect(octets, reads=(3, 8))
    if isinstance(value, RequestEffect):
        return value
    if value & VC660_STOPS:
        return RequestEffect.STOP
    if value & VC660_STARTS:
        return RequestEffect.MOTION
    return RequestEffect.SETTING if value & VC660_RESET else RequestEffect.RELEASE


def _df800_effect(octets: bytes) -> RequestEffect:
    """2000H: b1-b0 01 stop, 10 start, 11 jog; b4 fault reset."""
    value = _command_or_effect(octets, reads=(3,))
    if isinstance(value, RequestEffect):
        return value
    return (RequestEffect.SETTING, RequestEffect.STOP, RequestEffect.MOTION, RequestEffect.MOTION)[value & 3]


def _command_or_effect(octets: bytes, reads: tuple[int, ...]) -> int | RequestEffect:
    """Return the word written to the command register, else the effect."""
    if octets[1] in reads:
        return RequestEffect.READ
    if octets[1] != 6:
        raise ValueError(octets.hex(" "))
    if int.from_bytes(octets[2:4], "big") != COMMAND_REGISTER:
        return RequestEffect.SETTING
    return octets[4] << 8 | octets[5]


# --- the worst that any bytes may do ----------------------------------------------------------------------------------


def worst_effect(model: str, frame: bytes, command_word: int = 0) -> RequestEffect:
    """Return the worst effect of any bytes (C320 in ASCII, Modbus in RTU).

    ``command_word``: the word that a VC660 was sent before; a changed direction turns a running motor round.
    """
    return _WORST[model](frame, command_word)


def command_word(frame: bytes) -> int | None:
    """Return the word that a Modbus RTU frame writes to the command register; None where it writes none."""
    value = _worst_command(frame)
    return None if isinstance(value, RequestEffect) else value


def _worst_c320(frame: bytes, _: int) -> RequestEffect:
    if len(frame) < 6 or frame[0] != 0x2A or C320_LENGTHS.get(frame[3] - 0x30) != len(frame):
        return RequestEffect.MOTION
    kind, operation = frame[3] - 0x30, int(frame[4:6].decode("ascii"), 16)
    if operation == 0:
        return RequestEffect.READ if kind < 3 else RequestEffect.SETTING
    if operation in C320_STOPS:
        return RequestEffect.STOP if kind == C320_CONTROL else RequestEffect.SETTING
    known = operation in C320_SETTINGS | C320_STOPS_WITH_FREQUENCY
    return RequestEffect.SETTING if known else RequestEffect.MOTION


def _worst_dzb100(frame: bytes, _: int) -> RequestEffect:
    if len(frame) != 11 or frame[0] not in b"CPRQ":
        return RequestEffect.MOTION
    if frame[0] != ord("C"):
        return RequestEffect.SETTING if frame[0] == ord("P") else RequestEffect.READ
    if frame[6] in DZB100_STOPS:  # a stop carries 0000: with other data one flipped bit makes it a run (T11)
        return RequestEffect.STOP if frame[7:11] == b"0000" else RequestEffect.MOTION
    return RequestEffect.SETTING if frame[6] in DZB100_RESET else RequestEffect.MOTION


def _worst_vc660(frame: bytes, held: int) -> RequestEffect:
    value = _worst_command(frame)
    if isinstance(value, RequestEffect):
        return value
    known = VC660_STARTS | VC660_STOPS | VC660_REVERSE | VC660_RESET
    if value & ~known or value & VC660_STARTS:
        return RequestEffect.MOTION
    if value & VC660_STOPS:
        return RequestEffect.STOP
    if (value ^ held) & VC660_REVERSE:
        return RequestEffect.MOTION
    return RequestEffect.SETTING if value & VC660_RESET else RequestEffect.STOP


def _worst_df800(frame: bytes, _: int) -> RequestEffect:
    value = _worst_command(frame)
    if isinstance(value, RequestEffect):
        return value
    known = {0x00: RequestEffect.STOP, 0x01: RequestEffect.STOP, 0x10: RequestEffect.SETTING}
    return known.get(value, RequestEffect.MOTION)


def _worst_command(frame: bytes) -> RequestEffect | int:
    if len(frame) != 8:
        return RequestEffect.MOTION
    function, register = frame[1], frame[2] << 8 | frame[3]
    if function in (3, 8):
        return RequestEffect.READ
    if function != 6 or COMMAND_REGISTER + 2 <= register <= 0x2FFF:
        return RequestEffect.MOTION
    return frame[4] << 8 | frame[5] if register == COMMAND_REGISTER else RequestEffect.SETTING


_WORST: Mapping[str, Callable[[bytes, int], RequestEffect]] = {
    "c320": _worst_c320,
    "dzb100": _worst_dzb100,
    "vc660": _worst_vc660,
    "df800": _worst_df800,
}


# --- fields of frames -------------------------------------------------------------------------------------------------


def c320_field(kind: DriveVariant, frame: bytes, first: int, width: int) -> int:
    """Return a number of ``width`` characters, in hex frames of ``width`` bytes (C320 2.4)."""
    part = frame[first : first + width]
    return int(part, 16) if kind.encoding == "ascii" else int.from_bytes(part)


def is_sync_probe(kind: DriveVariant, frame: bytes) -> bool:
    """Return whether a request is a sync probe.

    C320: class 2 with a group; DZB100: R; VC660: function 08; DF800: a read of two registers, which no other request
    uses.
    """
    if kind.model == "c320":
        return c320_field(kind, frame, 3, 1) == 2 and c320_field(kind, frame, 6, 1) != 0
    if kind.model == "dzb100":
        return frame[:1] == b"R"
    words = modbus_octets(kind.encoding, frame)
    return words[1] == 8 if kind.model == "vc660" else words[1] == 3 and words[4:6] == b"\x00\x02"


def modbus_write(kind: DriveVariant, frame: bytes) -> tuple[int, int] | None:
    """Return register and value of a Modbus write; None for other requests."""
    words = modbus_octets(kind.encoding, frame)
    return (int.from_bytes(words[2:4]), int.from_bytes(words[4:6])) if words[1] == 6 else None


def shows_standstill(kind: DriveVariant, request: bytes, reply: bytes) -> bool | None:
    """Return whether a reply shows that the output is off; None where it shows neither."""
    if kind.model == "c320":
        return c320_field(kind, reply, 4, 2) in (0x03, 0x21, 0x20, 0x00) if len(reply) == 18 else None
    if kind.model == "dzb100" and request[:1] == b"Q":
        return {b"01": reply[7:11] == b"0000", b"03": reply[7:8] in b"02"}.get(request[5:7])
    if kind.model == "vc660" and request[1] == 3 and request[2:4] == b"\x30\x00":
        return not reply[4] & 0x08
    return None


def status_read_key(kind: DriveVariant, request: bytes) -> bytes | None:
    """Return the key of a status read, equal for equal reads; None for other requests."""
    if kind.model == "c320":
        return request if c320_field(kind, request, 3, 1) == 1 else None
    if kind.model == "dzb100":
        return request if request[:1] == b"Q" and request[5:7] in (b"01", b"03") else None
    return request[2:4] if kind.model == "vc660" and request[1] == 3 and request[2:4] == b"\x30\x00" else None
