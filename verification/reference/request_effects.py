"""Effect and content of a request: what the fields that the reference codecs read mean for a drive.

``classify_request`` and ``decode_write`` take requests that the manuals define and raise for others; ``worst_effect``
takes any bytes and assumes motion wherever no manual names what they do.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import StrEnum
from typing import NamedTuple

from verification.drive_variants import DriveVariant
from verification.reference.dzb100 import COMMANDS, Dzb100Reference
from verification.reference.modbus import ModbusReference
from verification.reference.sunfar import OPERATIONS, SunfarReference


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


def _effect_of_name(name: str) -> RequestEffect:
    """Return the effect of an operation by its name in the manual. It acts in every class of the C320 (T01, T07)."""
    if "stop" in name:
        return RequestEffect.STOP
    if name.startswith(("run", "jog", "forward", "reverse")):
        return RequestEffect.MOTION
    return RequestEffect.READ if name == "none" else RequestEffect.SETTING


C320_EFFECTS = {operation: _effect_of_name(name) for operation, name in OPERATIONS.items()}
C320_WITH_FREQUENCY = frozenset(operation for operation, name in OPERATIONS.items() if name.endswith("frequency"))
C320_WRITES, C320_SAVES, C320_CONTROL = (3, 5), 5, 4
"""Classes (2.4.3)."""
C320_STANDSTILL = (0x00, 0x03, 0x20, 0x21)
"""States (2.4.6): DC bus not ready, stopped, fault, emergency stop."""
DZB100_EFFECTS = {command: _effect_of_name(name) for command, name in COMMANDS.items()}
COMMAND_REGISTER, FREQUENCY_REGISTER, LAST_PUBLISHED_REGISTER = 0x2000, 0x2001, 0x2FFF
"""VC660 and DF800; up to 2FFFH no other register is published."""
VC660_STATUS_REGISTER, VC660_RUNNING = 0x3000, 0x08
VC660_STARTS = 0x0001 | 0x0008 | 0x0010
"""VC660 §5: b0 start, b3 and b4 jog."""
VC660_STOPS = 0x0002 | 0x0020 | 0x0040
"""VC660 §5: b1 stop, b5 coast, b6 emergency stop."""
VC660_REVERSE, VC660_RESET = 0x0004, 0x0200
"""VC660 §5: b2 direction, b9 fault reset."""
VC660_BITS = VC660_STARTS | VC660_STOPS | VC660_REVERSE | VC660_RESET
DF800_BITS = 0x001F
"""2000H of the DF800: b1-b0 01 stop, 10 start, 11 jog; b3-b2 direction; b4 fault reset."""
DF800_TOGGLE = 0x0C
"""Direction bits of the DF800 that toggle the direction (T16)."""
DF800_PARAMETERS = range(100, 1000)
"""Parameter registers of the DF800: group × 100 + number; group 0 holds monitors."""
DZB100_LAST_PARAMETER, VC660_LAST_INDEX = 80, 450
"""The highest parameter of DZB100 and the highest index of VC660."""
VC660_EEPROM = 0x8000
"""VC660: set in the address of a parameter that is saved."""


def classify_request(family: str, encoding: str, frame: bytes) -> tuple[int, RequestEffect]:
    """Return a request's address and effect. Raises ValueError for what the manual does not define."""
    if family == "c320":
        address, kind, operation, *_ = SunfarReference(encoding).parse_request(frame)
        return address, _c320_effect(kind, operation)
    if family == "dzb100":
        what, address, number, _ = Dzb100Reference().parse_request(frame)
        return address, _dzb100_effect(what, number)
    octets = ModbusReference(encoding).parse_request(frame)
    return octets[0], _vc660_effect(octets) if family == "vc660" else _df800_effect(octets)


def _c320_effect(kind: int, operation: int) -> RequestEffect:
    effect = C320_EFFECTS[operation]
    if effect is not RequestEffect.READ:
        return effect
    if kind == C320_CONTROL:
        raise ValueError(f"class {kind}, operation {operation:02X}")
    return RequestEffect.SETTING if kind in C320_WRITES else RequestEffect.READ


def _dzb100_effect(what: str, number: int) -> RequestEffect:
    if what == "control":
        return DZB100_EFFECTS[number % 10]
    return RequestEffect.SETTING if what == "write" else RequestEffect.READ


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
    value = _command_or_effect(octets, reads=(3,))
    if isinstance(value, RequestEffect):
        return value
    return (RequestEffect.SETTING, RequestEffect.STOP, RequestEffect.MOTION, RequestEffect.MOTION)[value & 3]


def _command_or_effect(octets: bytes, reads: tuple[int, ...]) -> int | RequestEffect:
    """Return the word written to the command register, else the effect."""
    if octets[1] in reads:
        return RequestEffect.READ
    written = _register_write(octets)
    if written is None:
        raise ValueError(f"function {octets[1]}: {octets.hex(' ')}")
    return written[1] if written[0] == COMMAND_REGISTER else RequestEffect.SETTING


def _register_write(octets: bytes) -> tuple[int, int] | None:
    """Return register and value that function 6 writes; None for other functions."""
    return (int.from_bytes(octets[2:4]), int.from_bytes(octets[4:6])) if octets[1] == 6 else None


# --- the worst that any bytes may do ----------------------------------------------------------------------------------


def worst_effect(model: str, frame: bytes, command_word: int = 0) -> RequestEffect:
    """Return the worst effect of any bytes (C320 in ASCII, Modbus in RTU).

    ``command_word``: the word that a VC660 was sent before; a changed direction turns a running motor round.
    """
    try:
        return _WORST[model](frame, command_word)
    except ValueError:
        return RequestEffect.MOTION


def command_word(frame: bytes) -> int | None:
    """Return the word that a Modbus RTU frame writes to the command register; None where it writes none."""
    try:
        written = _register_write(ModbusReference("rtu").parse_request(frame))
    except ValueError:
        return None
    return written[1] if written is not None and written[0] == COMMAND_REGISTER else None


def _worst_c320(frame: bytes, _: int) -> RequestEffect:
    kind, operation = SunfarReference("ascii").parse_request(frame)[1:3]
    effect = C320_EFFECTS[operation]
    if effect is RequestEffect.READ and kind in (*C320_WRITES, C320_CONTROL):
        return RequestEffect.SETTING
    if effect is RequestEffect.STOP and (kind != C320_CONTROL or operation in C320_WITH_FREQUENCY):
        return RequestEffect.SETTING
    return effect


def _worst_dzb100(frame: bytes, _: int) -> RequestEffect:
    what, _, number, data = Dzb100Reference().parse_request(frame)
    effect = _dzb100_effect(what, number)
    # a stop carries 0000: with other data one flipped bit makes it a run (T11)
    return RequestEffect.MOTION if effect is RequestEffect.STOP and data else effect


def _worst_vc660(frame: bytes, held: int) -> RequestEffect:
    value = _worst_command(frame)
    if isinstance(value, RequestEffect):
        return value
    if value & ~VC660_BITS or value & VC660_STARTS:
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
    octets = ModbusReference("rtu").parse_request(frame)
    written = _register_write(octets)
    if written is not None and FREQUENCY_REGISTER < written[0] <= LAST_PUBLISHED_REGISTER:
        return RequestEffect.MOTION
    return _command_or_effect(octets, reads=(3, 8))


_WORST: Mapping[str, Callable[[bytes, int], RequestEffect]] = {
    "c320": _worst_c320,
    "dzb100": _worst_dzb100,
    "vc660": _worst_vc660,
    "df800": _worst_df800,
}


# --- content of writes ------------------------------------------------------------------------------------------------


class ReferenceWrite(NamedTuple):
    """Content of a write: a frequency in Hz, or a parameter by its address, saved in the EEPROM or not."""

    hz: float | None = None
    parameter: int | None = None
    saved: bool = False


def decode_write(variant: DriveVariant, frame: bytes) -> ReferenceWrite:
    """Return what a request that is no read writes. Raises ValueError for an address or word that no manual lists."""
    if variant.model == "c320":
        return _c320_write(SunfarReference(variant.encoding).parse_request(frame))
    if variant.model == "dzb100":
        return _dzb100_write(*Dzb100Reference().parse_request(frame))
    written = modbus_write(variant, frame)
    if written is None:
        raise ValueError(f"no write: {frame.hex(' ')}")
    register, value = written
    if register == FREQUENCY_REGISTER:
        return ReferenceWrite(hz=value / 100)
    if register == COMMAND_REGISTER:
        _check_command_word(variant, value)
        return ReferenceWrite()
    parameter = register & ~VC660_EEPROM if variant.model == "vc660" else register
    listed = range(VC660_LAST_INDEX + 1) if variant.model == "vc660" else DF800_PARAMETERS
    if parameter not in listed:
        raise ValueError(f"register {register:04X}H is on no list")
    return ReferenceWrite(parameter=parameter, saved=variant.model == "df800" or register >= VC660_EEPROM)


def _c320_write(fields: list[int]) -> ReferenceWrite:
    _, kind, operation, *_, data = fields
    if operation and kind != C320_CONTROL:
        raise ValueError(f"class {kind} carries operation {operation:02X} (T01)")
    if kind in C320_WRITES:
        group, item = fields[3:5]
        return ReferenceWrite(parameter=group << 8 | item, saved=kind == C320_SAVES)
    return ReferenceWrite(hz=data / 100) if operation in C320_WITH_FREQUENCY else ReferenceWrite()


def _dzb100_write(what: str, _: int, number: int, data: int) -> ReferenceWrite:
    if what == "control":
        return ReferenceWrite(hz=data / 10)
    if number > DZB100_LAST_PARAMETER:
        raise ValueError(f"parameter {number} is on no list")
    return ReferenceWrite(parameter=number, saved=True)


def _check_command_word(variant: DriveVariant, value: int) -> None:
    vc660 = variant.model == "vc660"
    if value & ~(VC660_BITS if vc660 else DF800_BITS) or (not vc660 and value & DF800_TOGGLE == DF800_TOGGLE):
        raise ValueError(f"no command is {value:04X}H")


# --- requests and replies of the checks -------------------------------------------------------------------------------


def c320_class_and_operation(variant: DriveVariant, frame: bytes) -> tuple[int, int]:
    """Return class and operation of a request of the C320 (2.4.3, 2.4.4)."""
    kind, operation = SunfarReference(variant.encoding).parse_request(frame)[1:3]
    return kind, operation


def is_sync_probe(variant: DriveVariant, frame: bytes) -> bool:
    """Return whether a request is a sync probe.

    C320: class 2 with a group; DZB100: R; VC660: function 08; DF800: a read of two registers, which no other request
    uses.
    """
    if variant.model == "c320":
        _, kind, _, group, *_ = SunfarReference(variant.encoding).parse_request(frame)
        return kind == 2 and group != 0
    if variant.model == "dzb100":
        return Dzb100Reference().parse_request(frame)[0] == "read"
    octets = ModbusReference(variant.encoding).parse_request(frame)
    return octets[1] == 8 if variant.model == "vc660" else octets[1] == 3 and octets[4:6] == b"\x00\x02"


def modbus_write(variant: DriveVariant, frame: bytes) -> tuple[int, int] | None:
    """Return register and value of a Modbus write; None for other requests."""
    return _register_write(ModbusReference(variant.encoding).parse_request(frame))


def status_read_key(variant: DriveVariant, request: bytes) -> bytes | None:
    """Return the key of a status read, equal for equal reads; None for other requests."""
    if variant.model == "c320":
        return request if c320_class_and_operation(variant, request)[0] == 1 else None
    if variant.model == "dzb100":
        what, _, number, _ = Dzb100Reference().parse_request(request)
        return request if what == "query" and number in (1, 3) else None
    octets = ModbusReference(variant.encoding).parse_request(request)
    register = int.from_bytes(octets[2:4])
    return octets[2:4] if variant.model == "vc660" and octets[1] == 3 and register == VC660_STATUS_REGISTER else None


def shows_standstill(variant: DriveVariant, request: bytes, reply: bytes) -> bool | None:
    """Return whether a reply shows that the output is off; None where it shows neither."""
    if variant.model == "c320":
        meaning = SunfarReference(variant.encoding).decode_reply(request, reply)
        return None if meaning is None or "state" not in meaning else meaning["state"] in C320_STANDSTILL
    if variant.model == "dzb100":
        known = Dzb100Reference().decode_reply(request, reply)
        if known is None or known["kind"] != "query" or known["result"] != "right":
            return None
        if known["number"] == 3:  # A is the run command
            return DZB100_EFFECTS[known["command"]] is RequestEffect.STOP
        return known["data"] == 0 if known["number"] == 1 else None
    if status_read_key(variant, request) is None:
        return None
    return not ModbusReference(variant.encoding).octets(reply)[4] & VC660_RUNNING
