"""What a Modbus request changes, told from its bytes alone. What that means is the profile's to say."""

from __future__ import annotations

from typing import Final

from drivebus.protocols.codec import Codec
from drivebus.protocols.describe import require_whole_frame
from drivebus.protocols.modbus.ascii import ModbusAsciiCodec
from drivebus.protocols.modbus.messages import (
    READ_FUNCTIONS,
    ModbusRequest,
    WriteBit,
    WriteBits,
    WriteRegister,
    WriteRegisters,
)
from drivebus.protocols.modbus.rtu import ModbusRtuCodec

RegisterWrite = tuple[str, int, int]
"""Space ("holding" or "coil"), register, value."""
_CODECS: Final[dict[str, Codec]] = {"rtu": ModbusRtuCodec(), "ascii": ModbusAsciiCodec()}


def parse_request_frame(frame: bytes, encoding: str) -> ModbusRequest:
    """The request that these bytes are, all of them. Raises ProtocolError for anything else."""
    verdict = _CODECS[encoding].decode_request(frame)
    require_whole_frame(verdict, frame)
    request: ModbusRequest = verdict.message  # type: ignore[union-attr]
    return request


def registers_written(frame: bytes, encoding: str = "rtu") -> tuple[RegisterWrite, ...]:
    """Every ``(space, register, value)`` that this encoded request writes; empty for a read or a loop-back.

    Raises ProtocolError where the bytes are not one whole request: whoever asks must then expect the worst.
    """
    if encoding == "rtu" and len(frame) == 8 and frame[1] in READ_FUNCTIONS:
        return ()
    request = parse_request_frame(frame, encoding)
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
