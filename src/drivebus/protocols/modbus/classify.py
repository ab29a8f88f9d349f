"""Registers and coils that a Modbus request frame writes; the profile says what a write of them does."""

from __future__ import annotations

from typing import Final

from drivebus.protocols.codec import Codec
from drivebus.protocols.describe import whole_message
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
    """Parse bytes that are exactly one request. Raises ProtocolError for all others."""
    request: ModbusRequest = whole_message(_CODECS[encoding].decode_request(frame), frame)
    return request


def registers_written(frame: bytes, encoding: str = "rtu") -> tuple[RegisterWrite, ...]:
    """Return every ``(space, register, value)`` that a request frame writes; empty for a read or for diagnostics.

    Raises ProtocolError where the bytes are not one whole request; a caller must then assume that they move a motor.
    """
    if encoding == "rtu" and len(frame) == 8 and frame[1] in READ_FUNCTIONS:
        return ()
    return request_writes(parse_request_frame(frame, encoding))


def request_writes(request: ModbusRequest) -> tuple[RegisterWrite, ...]:
    """Return every ``(space, register, value)`` that a request writes; empty for a read or for diagnostics."""
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
