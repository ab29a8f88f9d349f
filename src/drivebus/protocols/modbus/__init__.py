"""Modbus over a serial line, for masters and stations: the names that the rest of the house uses.

PDU in ``messages`` and ``pdu``, the two encodings in ``rtu`` and ``ascii``, ``effects`` and ``describe`` beside them.
"""

from drivebus.protocols.modbus.ascii import AsciiCodec
from drivebus.protocols.modbus.describe import describe
from drivebus.protocols.modbus.effects import Change, request_of, written
from drivebus.protocols.modbus.messages import (
    Bits,
    ErrorReply,
    Loopback,
    Looped,
    ReadBits,
    ReadRegisters,
    Registers,
    Reply,
    Request,
    WriteBit,
    WriteBits,
    WriteRegister,
    WriteRegisters,
    Written,
)
from drivebus.protocols.modbus.pdu import BadRequest
from drivebus.protocols.modbus.rtu import ErrorForm, RtuCodec

__all__ = [
    "AsciiCodec",
    "BadRequest",
    "Bits",
    "Change",
    "ErrorForm",
    "ErrorReply",
    "Loopback",
    "Looped",
    "ReadBits",
    "ReadRegisters",
    "Registers",
    "Reply",
    "Request",
    "RtuCodec",
    "WriteBit",
    "WriteBits",
    "WriteRegister",
    "WriteRegisters",
    "Written",
    "describe",
    "request_of",
    "written",
]
