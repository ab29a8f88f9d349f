"""Modbus over a serial line, for masters and stations: the names that the rest of the house uses.

messages   requests and replies as values
requests   requests to octets and back (with ``replies`` and the shared ``pdu``: the PDU level)
rtu ascii  the two encodings: the codecs
effects    what a request changes, from its bytes
describe   what a frame says, for people
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
from drivebus.protocols.modbus.requests import BadRequest
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
