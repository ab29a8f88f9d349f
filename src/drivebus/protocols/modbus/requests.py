"""Modbus requests ↔ octets, for the master that says them and the station that hears them. No check, no framing.

A length is decided by the first seven octets, never by searching. Source: Modbus Application Protocol V1.1b3, 6.
"""

from __future__ import annotations

from drivebus.errors import AddressError, CodeError
from drivebus.protocols.modbus.messages import (
    ADDRESSES,
    BROADCAST,
    FUNCTIONS,
    ILLEGAL_FUNCTION,
    ILLEGAL_REGISTER,
    ILLEGAL_VALUE,
    MAX_READ,
    MAX_READ_BITS,
    MAX_WRITE,
    MAX_WRITE_BITS,
    READ_FUNCTIONS,
    REGISTER_FUNCTIONS,
    Diagnostics,
    ModbusRequest,
    ReadBits,
    ReadRegisters,
    WriteBit,
    WriteBits,
    WriteRegister,
    WriteRegisters,
)
from drivebus.protocols.modbus.pdu import (
    COIL_OFF,
    COIL_ON,
    FIXED_PDU,
    WORD_STRUCTS,
    check_range,
    pack_bits,
    pack_words,
    unpack_bits,
)


class IllegalRequest(CodeError):
    """A whole request with a good check that can't be carried out: a station answers it with exception ``code``."""

    def __init__(self, key: str, octets: bytes, code: int, *, expected: object, found: object) -> None:
        self.address, self.function, self.code = octets[0], octets[1], code
        super().__init__(key, expected=expected, found=found, address=octets[0], function=octets[1], code=code)


def encode_request(request: ModbusRequest, max_read: int) -> bytes:
    """The octets of a request. Raises ValueError for a field out of range."""
    if type(request) is ReadRegisters:
        address, register, count, function = request.address, request.register, request.count, request.function
        if 1 <= address <= 247 and 1 <= count <= max_read and 0 <= register <= 0x10000 - count and 3 <= function <= 4:
            return FIXED_PDU.pack(address, function, register, count)
    _check_request(request, max_read)
    return encode_unchecked(request)


def encode_unchecked(request: ModbusRequest) -> bytes:
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
    """How many octets a request has that begins with ``head`` (two or more), None where nobody can tell.

    For 0FH and 10H it answers 7 until the byte count is there.
    """
    function = head[1]
    if 1 <= function <= 6 or function == 8:
        return 6
    if function in (15, 16):
        return 7 + head[6] if len(head) > 6 else 7
    return None


def parse_request(octets: bytes) -> ModbusRequest:
    """The request that these octets (of ``request_extent``, check good) are.

    Raises IllegalRequest with the exception that a station answers; AddressError for a reserved address.
    """
    address, function = octets[0], octets[1]
    if address >= ADDRESSES.stop:
        raise AddressError("modbus.address_range", expected=ADDRESSES.stop - 1, found=address)
    if function not in FUNCTIONS:
        raise IllegalRequest(
            "modbus.unknown_function", octets, ILLEGAL_FUNCTION, expected="1-6, 8, 15, 16", found=function
        )
    _, _, register, word = FIXED_PDU.unpack_from(octets)
    if function in REGISTER_FUNCTIONS and 1 <= word <= MAX_READ and register + word <= 0x10000:
        return ReadRegisters(address, register, word, function)
    if function == 6:
        return WriteRegister(address, register, word)
    if function == 5:
        if word not in (COIL_ON, COIL_OFF):
            raise IllegalRequest("modbus.coil", octets, ILLEGAL_VALUE, expected="0000H, FF00H", found=word)
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
        raise IllegalRequest("modbus.range", octets, ILLEGAL_REGISTER, expected=0xFFFF, found=register + count - 1)
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
