"""Modbus requests and replies to octets and back, for a master and for a station, without check and framing.

``octets`` are the station address and the PDU: RTU sends them as they are, ASCII as digits. Source: Modbus Application
Protocol V1.1b3, sections 6 and 7; VC660 manual section 5; DF800 frame tables.
"""

from __future__ import annotations

from struct import Struct
from struct import error as StructError
from typing import Final

from drivebus.errors import AddressError, CodeError, EchoError, HeaderError, LengthError
from drivebus.protocols.codec import check_range
from drivebus.protocols.modbus.messages import (
    ADDRESSES,
    BROADCAST,
    ECHO_FUNCTIONS,
    EXCEPTION_CODES,
    FUNCTIONS,
    ILLEGAL_ADDRESS,
    ILLEGAL_FUNCTION,
    ILLEGAL_VALUE,
    MAX_READ,
    MAX_READ_BITS,
    MAX_WRITE,
    MAX_WRITE_BITS,
    READ_FUNCTIONS,
    REGISTER_FUNCTIONS,
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

FIXED_PDU: Final = Struct(">BBHH")
"""Address, function and two words: most requests and every write acknowledgement."""
WORD_STRUCTS: Final = tuple(Struct(f">{count}H") for count in range(126))
COIL_ON: Final = 0xFF00
COIL_OFF: Final = 0x0000
"""Values of a coil (05): on FF00H, off 0000H."""


def pack_words(values: tuple[int, ...]) -> bytes:
    """Return registers as octets, high byte first. Raises ValueError for a value beyond 16 bits."""
    try:
        return WORD_STRUCTS[len(values)].pack(*values)
    except StructError:
        for value in values:
            check_range("value", value, 0, 0xFFFF)
        raise


def pack_bits(bits: tuple[bool, ...]) -> bytes:
    """Return bits as octets, the first bit in the lowest place (V1.1b3, 6.1)."""
    number = sum(1 << place for place, bit in enumerate(bits) if bit)
    return number.to_bytes(-(-len(bits) // 8), "little")


def unpack_bits(octets: bytes, count: int) -> tuple[bool, ...]:
    """Return the first ``count`` bits. Raises CodeError where the padding is not zero (V1.1b3, 6.1)."""
    number = int.from_bytes(octets, "little")
    if number >> count:
        raise CodeError("modbus.padding", expected=0, found=number >> count)
    return tuple(bool(number >> place & 1) for place in range(count))


class IllegalRequest(CodeError):
    """Whole request with a good check that a station rejects with exception ``code``."""

    def __init__(self, key: str, octets: bytes, code: int, *, expected: object, found: object) -> None:
        self.address, self.function, self.code = octets[0], octets[1], code
        super().__init__(key, expected=expected, found=found, address=octets[0], function=octets[1], code=code)


def encode_request(request: ModbusRequest, max_read: int) -> bytes:
    """Return the octets of a request. Raises ValueError for a field out of range."""
    if type(request) is ReadRegisters:
        address, register, count, function = request.address, request.register, request.count, request.function
        if 1 <= address <= 247 and 1 <= count <= max_read and 0 <= register <= 0x10000 - count and 3 <= function <= 4:
            return FIXED_PDU.pack(address, function, register, count)
    _check_request(request, max_read)
    return encode_unchecked(request)


def encode_unchecked(request: ModbusRequest) -> bytes:
    """Return the octets of a request whose fields are known to be in range."""
    match request:
        case ReadRegisters() | ReadBits():
            return FIXED_PDU.pack(request.address, request.function, request.register, request.count)
        case WriteRegister():
            return FIXED_PDU.pack(request.address, 6, request.register, request.value)
        case WriteBit():
            return FIXED_PDU.pack(request.address, 5, request.register, COIL_ON if request.value else COIL_OFF)
        case Diagnostics():
            return FIXED_PDU.pack(request.address, 8, 0, request.data)
    content = pack_words(request.values) if isinstance(request, WriteRegisters) else pack_bits(request.values)
    head = FIXED_PDU.pack(request.address, request.function, request.register, len(request.values))
    return head + bytes((len(content),)) + content


def _check_request(request: ModbusRequest, max_read: int) -> None:
    reads = isinstance(request, ReadRegisters | ReadBits | Diagnostics)
    check_range("address", request.address, ADDRESSES.start if reads else BROADCAST, ADDRESSES.stop - 1)
    match request:
        case ReadRegisters(function=function, count=count):
            check_range("function", function, 3, 4)
            check_range("count", count, 1, max_read)
        case ReadBits(function=function, count=count):
            check_range("function", function, 1, 2)
            check_range("count", count, 1, MAX_READ_BITS)
        case WriteRegister(value=value):
            count = 1
            check_range("value", value, 0, 0xFFFF)
        case Diagnostics(data=data):
            check_range("data", data, 0, 0xFFFF)
            return
        case WriteRegisters(values=values):
            count = check_range("count", len(values), 1, MAX_WRITE)
        case WriteBits(values=bits):
            count = check_range("count", len(bits), 1, MAX_WRITE_BITS)
        case WriteBit():
            count = 1
        case _:
            raise ValueError(f"{request!r} is no Modbus request")
    check_range("register", request.register, 0, 0x10000 - count)


def request_length(head: bytes) -> int | None:
    """Return the octets of a request that begins with ``head`` (two or more); None for an unknown function.

    For 0FH and 10H the result is 7 until the byte count is there.
    """
    function = head[1]
    if 1 <= function <= 6 or function == 8:
        return 6
    if function in (15, 16):
        return 7 + head[6] if len(head) > 6 else 7
    return None


def parse_request(octets: bytes) -> ModbusRequest:
    """Parse the octets of a request (as many as ``request_length``, check good).

    Raises IllegalRequest with the exception that a station answers; AddressError for a reserved address.
    """
    address, function = octets[0], octets[1]
    if address >= ADDRESSES.stop:
        raise AddressError("modbus.address_range", expected=ADDRESSES.stop - 1, found=address)
    if function not in FUNCTIONS:
        raise IllegalRequest(
            "modbus.unknown_function", octets, ILLEGAL_FUNCTION, expected=("1-6", "8", "15", "16"), found=function
        )
    _, _, register, word = FIXED_PDU.unpack_from(octets)
    if function in REGISTER_FUNCTIONS and 1 <= word <= MAX_READ and register + word <= 0x10000:
        return ReadRegisters(address, register, word, function)
    if function == 6:
        return WriteRegister(address, register, word)
    if function == 5:
        if word not in (COIL_ON, COIL_OFF):
            raise IllegalRequest("modbus.coil", octets, ILLEGAL_VALUE, expected=("0000H", "FF00H"), found=word)
        return WriteBit(address, register, word == COIL_ON)
    if function == 8:
        if register:
            raise IllegalRequest("modbus.sub_function", octets, ILLEGAL_FUNCTION, expected=0, found=register)
        return Diagnostics(address, word)
    return _parse_counted_request(octets, address, function, register, word)


_MAX_COUNTS = {1: MAX_READ_BITS, 2: MAX_READ_BITS, 3: MAX_READ, 4: MAX_READ, 15: MAX_WRITE_BITS, 16: MAX_WRITE}


def _parse_counted_request(octets: bytes, address: int, function: int, register: int, count: int) -> ModbusRequest:
    if not 1 <= count <= _MAX_COUNTS[function]:
        raise IllegalRequest("modbus.count", octets, ILLEGAL_VALUE, expected=_MAX_COUNTS[function], found=count)
    if register + count > 0x10000:
        raise IllegalRequest("modbus.range", octets, ILLEGAL_ADDRESS, expected=0xFFFF, found=register + count - 1)
    if function in READ_FUNCTIONS:  # registers were read above
        return ReadBits(address, register, count, function)
    expected = 2 * count if function == 16 else (count + 7) // 8
    if octets[6] != expected:
        raise IllegalRequest("modbus.byte_count", octets, ILLEGAL_VALUE, expected=expected, found=octets[6])
    if function == 16:
        return WriteRegisters(address, register, WORD_STRUCTS[count].unpack_from(octets, 7))
    try:
        return WriteBits(address, register, unpack_bits(octets[7:], count))
    except CodeError as error:
        raise IllegalRequest("modbus.padding", octets, ILLEGAL_VALUE, expected=0, found=error.found) from error


def encode_reply(reply: ModbusReply, count_bytes: int = 1) -> bytes:
    """Return the octets of a reply; a read's begins with a byte count of ``count_bytes`` octets.

    Raises ValueError for a field out of range.
    """
    if type(reply) is RegisterValues and count_bytes == 1:
        address, function, values = reply.address, reply.function, reply.values
        if 1 <= address <= 247 and 3 <= function <= 4 and 1 <= len(values) <= MAX_READ:
            return bytes((address, function, 2 * len(values))) + pack_words(values)
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
    return bytes((address, function)) + len(content).to_bytes(count_bytes, "big") + content


def normal_reply_length(request: ModbusRequest, count_bytes: int = 1) -> int:
    """Return the number of octets of the normal reply, without its check."""
    if isinstance(request, ReadRegisters):
        return 2 + count_bytes + 2 * request.count
    if isinstance(request, ReadBits):
        return 2 + count_bytes + (request.count + 7) // 8
    return 6


def reply_length(request: ModbusRequest, head: bytes, *, short: bool, count_bytes: int = 1) -> int:
    """Return the octets of a reply that begins with ``head`` (three or more, four where ``count_bytes`` is 2).

    ``short`` allows DF800's error form, which for a write begins like its acknowledgement; the encodings tell them
    apart. Raises ProtocolError for a head that no station's reply can have.
    """
    function, found = request.function, head[1]
    if head[0] != request.address or head[0] == BROADCAST:
        return _foreign_reply_length(request, head, short=short, count_bytes=count_bytes)
    if found == function:
        if function not in READ_FUNCTIONS:
            return 6
        expected, count = normal_reply_length(request, count_bytes), head[2]
        if count_bytes == 2:
            count = count << 8 | head[3]
        if count + 2 + count_bytes == expected:
            return expected
        if short and count == 0:
            return 3
        raise LengthError("modbus.byte_count", expected=expected - 2 - count_bytes, found=count)
    if found == function | 0x80:
        return 3
    raise EchoError("modbus.function", expected=function, found=found)


def _foreign_reply_length(request: ModbusRequest, head: bytes, *, short: bool, count_bytes: int) -> int:
    """Return the length of another station's frame where its function decides it; else raise AddressError."""
    address, function, count = head[0], head[1], head[2]
    if request.address == BROADCAST:
        raise HeaderError("modbus.broadcast_answered", expected=0, found=address)
    if function & 0x80:
        return 3
    if function in ECHO_FUNCTIONS:
        return 6
    if function in READ_FUNCTIONS and count_bytes == 2 and count == 0:
        return 4 + head[3]
    if function in READ_FUNCTIONS and (count or short) and (function < 3 or count % 2 == 0):
        return 3 + count
    raise AddressError("modbus.first_byte", expected=request.address, found=address)


def parse_reply(request: ModbusRequest, octets: bytes, count_bytes: int = 1) -> ModbusReply:
    """Parse the octets of a reply (as many as ``reply_length``, check good). Raises ProtocolError."""
    address, function = octets[0], octets[1]
    if address != request.address:
        raise AddressError("modbus.address", expected=request.address, found=address)
    if function in REGISTER_FUNCTIONS and len(octets) > 3:
        at = 2 + count_bytes
        return RegisterValues(address, function, WORD_STRUCTS[octets[at - 1] >> 1].unpack_from(octets, at))
    if function & 0x80:
        if octets[2] not in EXCEPTION_CODES:
            raise CodeError("modbus.exception_code", expected=("1-8", "10", "11"), found=octets[2])
        return ExceptionReply(address, function & 0x7F, octets[2])
    if len(octets) == 3:
        return ExceptionReply(address, function, None)
    if isinstance(request, ReadBits):
        return BitValues(address, function, unpack_bits(octets[2 + count_bytes :], request.count))
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
