"""Modbus over a serial line, for masters and stations: the names that the rest of the house uses.

messages   requests and replies as values
requests   requests to octets and back (with ``replies`` and the shared ``pdu``: the PDU level)
rtu ascii  the two encodings: the codecs
effects    what a request changes, from its bytes
describe   what a frame says, for people
"""

from drivebus.protocols.modbus.ascii import ModbusAsciiCodec
from drivebus.protocols.modbus.classify import RegisterWrite, parse_request_frame, registers_written
from drivebus.protocols.modbus.describe import describe
from drivebus.protocols.modbus.messages import (
    BitValues,
    Diagnostics,
    DiagnosticsReply,
    ExceptionReply,
    ModbusReply,
    ModbusRequest,
    ReadBits,
    ReadRegisters,
    RegisterValues,
    WriteAck,
    WriteBit,
    WriteBits,
    WriteRegister,
    WriteRegisters,
)
from drivebus.protocols.modbus.requests import IllegalRequest
from drivebus.protocols.modbus.rtu import ErrorForm, ModbusRtuCodec

__all__ = [
    "BitValues",
    "Diagnostics",
    "DiagnosticsReply",
    "ErrorForm",
    "ExceptionReply",
    "IllegalRequest",
    "ModbusAsciiCodec",
    "ModbusReply",
    "ModbusRequest",
    "ModbusRtuCodec",
    "ReadBits",
    "ReadRegisters",
    "RegisterValues",
    "RegisterWrite",
    "WriteAck",
    "WriteBit",
    "WriteBits",
    "WriteRegister",
    "WriteRegisters",
    "describe",
    "parse_request_frame",
    "registers_written",
]
