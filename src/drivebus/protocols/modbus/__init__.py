"""Modbus over a serial line, for masters and stations.

messages   requests and replies as values
pdu        requests and replies to octets and back
rtu ascii  the codecs of the two encodings
classify   registers that a request frame writes
describe   frames for people
family     the entry of the family registry
"""

from drivebus.protocols.modbus.ascii import ModbusAsciiCodec
from drivebus.protocols.modbus.classify import (
    RegisterWrite,
    parse_request_frame,
    registers_written,
    request_writes,
)
from drivebus.protocols.modbus.describe import describe
from drivebus.protocols.modbus.messages import (
    BROADCAST,
    EXCEPTION_NAMES,
    MAX_READ_BITS,
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
from drivebus.protocols.modbus.pdu import COIL_OFF, COIL_ON, IllegalRequest
from drivebus.protocols.modbus.rtu import ErrorForm, ModbusRtuCodec

__all__ = [
    "BROADCAST",
    "COIL_OFF",
    "COIL_ON",
    "EXCEPTION_NAMES",
    "MAX_READ_BITS",
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
    "request_writes",
]
