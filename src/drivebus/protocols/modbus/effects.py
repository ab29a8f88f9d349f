"""What a Modbus request changes, told from its bytes alone. What that means is the profile's to say."""

from __future__ import annotations

from typing import Final

from drivebus.message import Codec
from drivebus.protocols.describe import check_whole
from drivebus.protocols.modbus.ascii import AsciiCodec
from drivebus.protocols.modbus.messages import (
    READ_FUNCTIONS,
    Request,
    WriteBit,
    WriteBits,
    WriteRegister,
    WriteRegisters,
)
from drivebus.protocols.modbus.rtu import RtuCodec

Change = tuple[str, int, int]
"""Space ("holding" or "coil"), register, value."""
_CODECS: Final[dict[str, Codec]] = {"rtu": RtuCodec(), "ascii": AsciiCodec()}


def request_of(frame: bytes, encoding: str) -> Request:
    """The request that these bytes are, all of them. Raises ProtocolError for anything else."""
    verdict = _CODECS[encoding].decode_request(frame)
    check_whole(verdict, frame)
    request: Request = verdict.message  # type: ignore[union-attr]
    return request


def written(frame: bytes, encoding: str = "rtu") -> tuple[Change, ...]:
    """Every ``(space, register, value)`` that this encoded request writes; empty for a read or a loop-back.

    Raises ProtocolError where the bytes are not one whole request: whoever asks must then expect the worst.
    """
    if encoding == "rtu" and len(frame) == 8 and frame[1] in READ_FUNCTIONS:
        return ()
    request = request_of(frame, encoding)
    match request:
        case WriteRegister(register=register, value=value):
            return (("holding", register, value),)
        case WriteRegisters(register=register, values=values):
            return tuple(("holding", register + place, value) for place, value in enumerate(values))
        case WriteBit(register=register, value=value):
            return (("coil", register, int(value)),)
        case WriteBits(register=register, values=bits):
            return tuple(("coil", register + place, int(value)) for place, value in enumerate(bits))
        case _:
            return ()
