"""Modbus replies ↔ octets, for the station that says them and the master that judges them. No check, no framing.

A length is decided by the first three octets and the request, never by searching. Source: Modbus Application Protocol
V1.1b3, 6 and 7; VC660 section 5; DF800 frame tables.
"""

from __future__ import annotations

from drivebus.errors import AddressError, CodeError, EchoError, HeaderError, LengthError
from drivebus.protocols.modbus.messages import (
    ADDRESSES,
    BROADCAST,
    ECHO_FUNCTIONS,
    EXCEPTION_CODES,
    MAX_READ,
    MAX_READ_BITS,
    READ_FUNCTIONS,
    REGISTER_FUNCTIONS,
    BitValues,
    DiagnosticsReply,
    ExceptionReply,
    ModbusReply,
    ModbusRequest,
    ReadBits,
    ReadRegisters,
    RegisterValues,
    WriteAck,
)
from drivebus.protocols.modbus.pdu import FIXED_PDU, WORD_STRUCTS, check_range, pack_bits, pack_words, unpack_bits
from drivebus.protocols.modbus.requests import encode_unchecked


def encode_reply(reply: ModbusReply) -> bytes:
    """The octets of a station's reply. Raises ValueError for a field out of range."""
    check_range("address", reply.address, ADDRESSES.start, ADDRESSES.stop - 1)
    match reply:
        case RegisterValues(address=address, function=function, values=values):
            check_range("function", function, 3, 4)
            check_range("count", len(values), 1, MAX_READ)
            content = pack_words(values)
        case BitValues(address=address, function=function, values=bits):
            check_range("function", function, 1, 2)
            check_range("count", len(bits), 1, MAX_READ_BITS)
            content = pack_bits(bits)
        case WriteAck(address=address, function=function, register=register, value=value):
            if function not in ECHO_FUNCTIONS or function == 8:
                raise ValueError(f"function {function}: expected 5, 6, 15 or 16")
            check_range("register", register, 0, 0xFFFF)
            return FIXED_PDU.pack(address, function, register, check_range("value", value, 0, 0xFFFF))
        case DiagnosticsReply(address=address, data=data):
            return FIXED_PDU.pack(address, 8, 0, check_range("data", data, 0, 0xFFFF))
        case ExceptionReply(address=address, function=function, code=code):
            check_range("function", function, 1, 0x7F)
            if code is None:
                return bytes((address, function, 0))
            return bytes((address, function | 0x80, check_range("code", code, 1, 0xFF)))
        case _:
            raise ValueError(f"{reply!r} is no Modbus reply")
    return bytes((address, function, len(content))) + content


def normal_reply_length(request: ModbusRequest) -> int:
    """Octets of the normal reply, without its check."""
    if isinstance(request, ReadRegisters):
        return 3 + 2 * request.count
    if isinstance(request, ReadBits):
        return 3 + (request.count + 7) // 8
    return 6


def reply_length(request: ModbusRequest, head: bytes, short: bool) -> int:
    """How many octets a reply has that begins with ``head`` (three or more); ``short``: DF800's error form counts.

    A write's short error is not told from its echo here: the encodings do that (T15). Raises a ProtocolError for what
    can't be the reply of the station, nor of another one.
    """
    function, found = request.function, head[1]
    if head[0] != request.address or head[0] == BROADCAST:
        return _foreign_reply_length(request, head, short)
    if found == function:
        if function not in READ_FUNCTIONS:
            return 6
        expected = normal_reply_length(request)
        if head[2] + 3 == expected:
            return expected
        if short and head[2] == 0:
            return 3
        raise LengthError("modbus.byte_count", expected=expected - 3, found=head[2])
    if found == function | 0x80:
        return 3
    raise EchoError("modbus.function", expected=function, found=found)


def _foreign_reply_length(request: ModbusRequest, head: bytes, short: bool) -> int:
    """Another station's frame: its length where its function tells, else AddressError at once (F02)."""
    address, function, count = head[0], head[1], head[2]
    if request.address == BROADCAST:
        raise HeaderError("modbus.broadcast_answered", expected=0, found=address)
    if function & 0x80:
        return 3
    if function in ECHO_FUNCTIONS:
        return 6
    if function in READ_FUNCTIONS and (count or short) and (function < 3 or count % 2 == 0):
        return 3 + count
    raise AddressError("modbus.address", expected=request.address, found=address)


def parse_reply(request: ModbusRequest, octets: bytes) -> ModbusReply:
    """The reply that these octets (of ``reply_extent``, check good) are. Raises a ProtocolError with both numbers."""
    address, function = octets[0], octets[1]
    if address != request.address:
        raise AddressError("modbus.address", expected=request.address, found=address)
    if function in REGISTER_FUNCTIONS and len(octets) > 3:
        return RegisterValues(address, function, WORD_STRUCTS[octets[2] >> 1].unpack_from(octets, 3))
    if function & 0x80:
        if octets[2] not in EXCEPTION_CODES:
            raise CodeError("modbus.exception_code", expected="1-8, 10, 11", found=octets[2])
        return ExceptionReply(address, function & 0x7F, octets[2])
    if len(octets) == 3:
        return ExceptionReply(address, function, None)
    if isinstance(request, ReadBits):
        return BitValues(address, function, unpack_bits(octets[3:], request.count))
    return _parse_echo(request, octets)


def _parse_echo(request: ModbusRequest, octets: bytes) -> WriteAck | DiagnosticsReply:
    address, function, register, value = FIXED_PDU.unpack(octets)
    _, _, wanted_register, wanted_value = FIXED_PDU.unpack_from(encode_unchecked(request))
    if register != wanted_register:
        key = "modbus.sub_function" if function == 8 else "modbus.register"
        raise EchoError(key, expected=wanted_register, found=register)
    if value != wanted_value:
        raise EchoError("modbus.value", expected=wanted_value, found=value)
    return DiagnosticsReply(address, value) if function == 8 else WriteAck(address, function, register, value)
