"""Modbus messages ↔ octets: station address and PDU, without a check and without framing. Both sides of the wire.

``octets`` here are what RTU sends as they are and ASCII as digits. Lengths are decided by their first three (a reply)
or seven (a request), never by searching. Source: Modbus Application Protocol V1.1b3; VC660 §5; DF800 frame tables.
"""

from __future__ import annotations

from struct import Struct
from struct import error as StructError
from typing import Final

from drivebus.errors import AddressError, CodeError, EchoError, HeaderError, LengthError
from drivebus.protocols.modbus.messages import (
    ADDRESSES,
    BROADCAST,
    ECHO_FUNCTIONS,
    EXCEPTION_CODES,
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

SIX: Final = Struct(">BBHH")
"""Address, function and two words: most requests and every echo."""
_WORDS: Final = tuple(Struct(f">{count}H") for count in range(126))
_ON, _OFF = 0xFF00, 0x0000


class BadRequest(CodeError):
    """A whole request with a good check that can't be carried out: a station answers it with exception ``code``."""

    def __init__(self, key: str, octets: bytes, code: int, *, expected: object, found: object) -> None:
        self.address, self.function, self.code = octets[0], octets[1], code
        super().__init__(key, expected=expected, found=found, address=octets[0], function=octets[1], code=code)


def encode_request(request: Request, max_read: int) -> bytes:
    """The octets of a request. Raises ValueError for a field out of range."""
    if type(request) is ReadRegisters:
        address, register, count, function = request.address, request.register, request.count, request.function
        if 1 <= address <= 247 and 1 <= count <= max_read and 0 <= register <= 0x10000 - count and 3 <= function <= 4:
            return SIX.pack(address, function, register, count)
    _check_request(request, max_read)
    return _request_octets(request)


def _request_octets(request: Request) -> bytes:
    match request:
        case ReadRegisters() | ReadBits():
            return SIX.pack(request.address, request.function, request.register, request.count)
        case WriteRegister():
            return SIX.pack(request.address, 6, request.register, request.value)
        case WriteBit():
            return SIX.pack(request.address, 5, request.register, _ON if request.value else _OFF)
        case Loopback():
            return SIX.pack(request.address, 8, 0, request.data)
        case WriteRegisters():
            content = _words(request.values)
        case WriteBits():
            content = _packed(request.values)
    head = SIX.pack(request.address, request.function, request.register, len(request.values))
    return head + bytes((len(content),)) + content


def _check_request(request: Request, max_read: int) -> None:
    reads = isinstance(request, ReadRegisters | ReadBits | Loopback)
    _within("address", request.address, ADDRESSES.start if reads else BROADCAST, ADDRESSES.stop - 1)
    match request:
        case ReadRegisters(function=function, count=count):
            _within("function", function, 3, 4)
            _within("count", count, 1, max_read)
        case ReadBits(function=function, count=count):
            _within("function", function, 1, 2)
            _within("count", count, 1, MAX_READ_BITS)
        case WriteRegister(value=value):
            count = 1
            _within("value", value, 0, 0xFFFF)
        case Loopback(data=data):
            _within("data", data, 0, 0xFFFF)
            return
        case WriteRegisters(values=values):
            count = _within("count", len(values), 1, MAX_WRITE)
        case WriteBits(values=bits):
            count = _within("count", len(bits), 1, MAX_WRITE_BITS)
        case WriteBit():
            count = 1
        case _:
            raise ValueError(f"{request!r} is no Modbus request")
    _within("register", request.register, 0, 0x10000 - count)


def _within(name: str, value: int, low: int, high: int) -> int:
    if not low <= value <= high:
        raise ValueError(f"{name} {value}: expected {low} to {high}")
    return value


def encode_reply(reply: Reply) -> bytes:
    """The octets of a station's reply. Raises ValueError for a field out of range."""
    if not 1 <= reply.address <= 247:
        _within("address", reply.address, ADDRESSES.start, ADDRESSES.stop - 1)
    match reply:
        case Registers(address=address, function=function, values=words):
            _within("function", function, 3, 4)
            _within("count", len(words), 1, MAX_READ)
            content = _words(words)
        case Bits(address=address, function=function, values=bits):
            _within("function", function, 1, 2)
            _within("count", len(bits), 1, MAX_READ_BITS)
            content = _packed(bits)
        case Written(address=address, function=function, register=register, value=value):
            if function not in ECHO_FUNCTIONS or function == 8:
                raise ValueError(f"function {function}: expected 5, 6, 15 or 16")
            _within("register", register, 0, 0xFFFF)
            return SIX.pack(address, function, register, _within("value", value, 0, 0xFFFF))
        case Looped(address=address, data=data):
            return SIX.pack(address, 8, 0, _within("data", data, 0, 0xFFFF))
        case ErrorReply(address=address, function=function, code=code):
            _within("function", function, 1, 0x7F)
            if code is None:
                return bytes((address, function, 0))
            return bytes((address, function | 0x80, _within("code", code, 1, 0xFF)))
        case _:
            raise ValueError(f"{reply!r} is no Modbus reply")
    return bytes((address, function, len(content))) + content


def _words(values: tuple[int, ...]) -> bytes:
    try:
        return _WORDS[len(values)].pack(*values)
    except StructError:
        for value in values:
            _within("value", value, 0, 0xFFFF)
        raise


def _packed(bits: tuple[bool, ...]) -> bytes:
    """Bits to octets, the first in the lowest place (V1.1b3, 6.1)."""
    number = sum(1 << place for place, bit in enumerate(bits) if bit)
    return number.to_bytes(-(-len(bits) // 8), "little")


def _unpacked(octets: bytes, count: int) -> tuple[bool, ...]:
    """The first ``count`` bits. Raises CodeError where the padding is not zero (V1.1b3, 6.1)."""
    number = int.from_bytes(octets, "little")
    if number >> count:
        raise CodeError("modbus.padding", expected=0, found=number >> count)
    return tuple(bool(number >> place & 1) for place in range(count))


def reply_octets(request: Request) -> int:
    """Octets of the normal reply, without its check."""
    if isinstance(request, ReadRegisters):
        return 3 + 2 * request.count
    if isinstance(request, ReadBits):
        return 3 + (request.count + 7) // 8
    return 6


def reply_extent(request: Request, head: bytes, short: bool) -> int:
    """How many octets a reply has that begins with ``head`` (three or more); ``short``: DF800's error form counts.

    A write's short error is not told from its echo here: the encodings do that (T15). Raises a ProtocolError for what
    can't be the reply of the station, nor of another one.
    """
    function, found = request.function, head[1]
    if head[0] != request.address or head[0] == BROADCAST:
        return _foreign_extent(request, head, short)
    if found == function:
        if function not in READ_FUNCTIONS:
            return 6
        expected = reply_octets(request)
        if head[2] + 3 == expected:
            return expected
        if short and head[2] == 0:
            return 3
        raise LengthError("modbus.byte_count", expected=expected - 3, found=head[2])
    if found == function | 0x80:
        return 3
    raise EchoError("modbus.function", expected=function, found=found)


def _foreign_extent(request: Request, head: bytes, short: bool) -> int:
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


def read_reply(request: Request, octets: bytes) -> Reply:
    """The reply that these octets (of ``reply_extent``, check good) are. Raises a ProtocolError with both numbers."""
    address, function = octets[0], octets[1]
    if address != request.address:
        raise AddressError("modbus.address", expected=request.address, found=address)
    if function in REGISTER_FUNCTIONS and len(octets) > 3:
        return Registers(address, function, _WORDS[octets[2] >> 1].unpack_from(octets, 3))
    if function & 0x80:
        if octets[2] not in EXCEPTION_CODES:
            raise CodeError("modbus.exception_code", expected="1-8, 10, 11", found=octets[2])
        return ErrorReply(address, function & 0x7F, octets[2])
    if len(octets) == 3:
        return ErrorReply(address, function, None)
    if isinstance(request, ReadBits):
        return Bits(address, function, _unpacked(octets[3:], request.count))
    return _read_echo(request, octets)


def _read_echo(request: Request, octets: bytes) -> Written | Looped:
    address, function, register, value = SIX.unpack(octets)
    _, _, wanted_register, wanted_value = SIX.unpack_from(_request_octets(request))
    if register != wanted_register:
        key = "modbus.sub_function" if function == 8 else "modbus.register"
        raise EchoError(key, expected=wanted_register, found=register)
    if value != wanted_value:
        raise EchoError("modbus.value", expected=wanted_value, found=value)
    return Looped(address, value) if function == 8 else Written(address, function, register, value)


def request_extent(head: bytes) -> int | None:
    """How many octets a request has that begins with ``head`` (two or more), None where nobody can tell.

    For 0FH and 10H it answers 7 until the byte count is there.
    """
    function = head[1]
    if 1 <= function <= 6 or function == 8:
        return 6
    if function in (15, 16):
        return 7 + head[6] if len(head) > 6 else 7
    return None


def read_request(octets: bytes) -> Request:
    """The request that these octets (of ``request_extent``, check good) are.

    Raises BadRequest with the exception that a station answers; AddressError for a reserved address.
    """
    address, function = octets[0], octets[1]
    if address >= ADDRESSES.stop:
        raise AddressError("modbus.address_range", expected=ADDRESSES.stop - 1, found=address)
    if function not in FUNCTIONS:
        raise BadRequest("modbus.unknown_function", octets, ILLEGAL_FUNCTION, expected="1-6, 8, 15, 16", found=function)
    _, _, register, word = SIX.unpack_from(octets)
    if function in REGISTER_FUNCTIONS and 1 <= word <= MAX_READ and register + word <= 0x10000:
        return ReadRegisters(address, register, word, function)
    if function == 6:
        return WriteRegister(address, register, word)
    if function == 5:
        if word not in (_ON, _OFF):
            raise BadRequest("modbus.coil", octets, ILLEGAL_VALUE, expected="0000H, FF00H", found=word)
        return WriteBit(address, register, word == _ON)
    if function == 8:
        if register:
            raise BadRequest("modbus.sub_function", octets, ILLEGAL_FUNCTION, expected=0, found=register)
        return Loopback(address, word)
    return _read_counted(octets, address, function, register, word)


_MOST = {1: MAX_READ_BITS, 2: MAX_READ_BITS, 3: MAX_READ, 4: MAX_READ, 15: MAX_WRITE_BITS, 16: MAX_WRITE}


def _read_counted(octets: bytes, address: int, function: int, register: int, count: int) -> Request:
    if not 1 <= count <= _MOST[function]:
        raise BadRequest("modbus.count", octets, ILLEGAL_VALUE, expected=_MOST[function], found=count)
    if register + count > 0x10000:
        raise BadRequest("modbus.range", octets, ILLEGAL_REGISTER, expected=0xFFFF, found=register + count - 1)
    if function in REGISTER_FUNCTIONS:
        return ReadRegisters(address, register, count, function)
    if function in READ_FUNCTIONS:
        return ReadBits(address, register, count, function)
    expected = 2 * count if function == 16 else (count + 7) // 8
    if octets[6] != expected:
        raise BadRequest("modbus.byte_count", octets, ILLEGAL_VALUE, expected=expected, found=octets[6])
    if function == 16:
        return WriteRegisters(address, register, _WORDS[count].unpack_from(octets, 7))
    try:
        return WriteBits(address, register, _unpacked(octets[7:], count))
    except CodeError as error:
        raise BadRequest("modbus.padding", octets, ILLEGAL_VALUE, expected=0, found=error.found) from error
