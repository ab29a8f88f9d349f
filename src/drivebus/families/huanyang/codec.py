"""Messages and frames of the Huanyang protocol, and the effect of a request frame.

    address · function · length of the data · data · CRC-16 of Modbus, low byte first

    function             data of a request          data of a reply
    01 read parameter    PD 00 00                   PD value of one or two bytes
    02 write parameter   PD value                   PD value
    03 control           bits of a command          bits of the state (CNST)
    04 read status       item, also item 00 00      item, two bytes
    05 set frequency     two bytes, 0.01 Hz         the same two bytes

A drive that rejects a request replies with the function + 80H and one byte (Holip HLP-C+ manual, page 74). The reply
to a read with two zero bytes equals its request where the value is 0; so a status is read by its number alone, as the
manual and LinuxCNC have it (FluidNC and grblHAL send the zeros).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntFlag
from typing import Final

from drivebus.errors import AddressError, ChecksumError, CodeError, EchoError, LengthError
from drivebus.protocols.checksum import crc16
from drivebus.protocols.codec import Complete, DecodeResult, Effect, Incomplete, canonical_request

BROADCAST: Final = 0
LAST_ADDRESS: Final = 250
LAST_PARAMETER: Final = 255
LAST_ITEM: Final = 7
READ, WRITE, CONTROL, STATUS, FREQUENCY = range(1, 6)
REJECTED: Final = 0x80
RUN_FORWARD: Final = 0x01
RUN_REVERSE: Final = 0x11
STOP: Final = 0x08
HEAD_SIZE: Final = 3
"""Address, function, length."""
CRC_SIZE: Final = 2
SMALLEST_FRAME: Final = HEAD_SIZE + 1 + CRC_SIZE
REQUEST_LENGTHS = {READ: (3,), WRITE: (2, 3), CONTROL: (1,), STATUS: (1, 3), FREQUENCY: (2,)}
"""Function to the length bytes that its requests have."""
REPLY_LENGTHS = REQUEST_LENGTHS | {READ: (2, 3), STATUS: (3,)}


class ControlState(IntFlag):
    """State that a drive reports in the reply to a control request (CNST, Holip HLP-C+ manual, page 74)."""

    RUN_COMMAND = 0x01
    JOG_COMMAND = 0x02
    REVERSE_COMMAND = 0x04
    RUNNING = 0x08
    JOGGING = 0x10
    RUNNING_REVERSE = 0x20
    BRAKING = 0x40
    SPEED_SEARCH = 0x80


@dataclass(frozen=True, slots=True)
class HuanyangRequest:
    """Request. ``index`` is a parameter, a status item or 0; ``width`` is the number of bytes of ``value``."""

    address: int
    function: int
    index: int = 0
    value: int = 0
    width: int = 2


@dataclass(frozen=True, slots=True)
class HuanyangReply:
    """Reply. ``accepted`` False: the drive rejects the request, and ``index`` is the byte of its rejection."""

    address: int
    function: int
    index: int = 0
    value: int = 0
    width: int = 2
    accepted: bool = field(default=True, kw_only=True)


def read_parameter(address: int, parameter: int) -> HuanyangRequest:
    """Return the read of a parameter."""
    return HuanyangRequest(address, READ, parameter)


def write_parameter(address: int, parameter: int, value: int, width: int) -> HuanyangRequest:
    """Return the write of a parameter of one or two bytes."""
    return HuanyangRequest(address, WRITE, parameter, value, width)


def control(address: int, command: int) -> HuanyangRequest:
    """Return the write of the control byte."""
    return HuanyangRequest(address, CONTROL, 0, command, 1)


def read_status(address: int, item: int) -> HuanyangRequest:
    """Return the read of a monitored value."""
    return HuanyangRequest(address, STATUS, item, width=0)


def set_frequency(address: int, word: int) -> HuanyangRequest:
    """Return the write of a frequency in steps of 0.01 Hz."""
    return HuanyangRequest(address, FREQUENCY, 0, word)


class HuanyangCodec:
    """Both sides of the protocol in RTU form; the ASCII form of PD165 = 0 to 2 is not supported."""

    family = "huanyang"
    encoding = "rtu"
    broadcast_address: int | None = BROADCAST

    def encode_request(self, request: HuanyangRequest, /) -> bytes:
        """Return the frame of a request. Raises ValueError for a field out of range or a read of all stations."""
        if not 0 <= request.address <= LAST_ADDRESS:
            raise ValueError(f"address {request.address}: expected 0 to {LAST_ADDRESS}")
        if request.function not in REQUEST_LENGTHS:
            raise ValueError(f"function {request.function}: expected 1 to 5")
        if request.address == BROADCAST and request.function in (READ, STATUS):
            raise ValueError("a read can't be a broadcast")
        if request.function == STATUS and request.index > LAST_ITEM:
            raise ValueError(f"status item {request.index}: expected 0 to {LAST_ITEM}")
        if request.function in (READ, STATUS) and request.value:
            raise ValueError("a read carries no value")
        return _frame(request.address, request.function, _data(request))

    def encode_reply(self, reply: HuanyangReply, /) -> bytes:
        """Return the frame of a reply. Raises ValueError for a field out of range."""
        if not reply.accepted:
            return _frame(reply.address, reply.function | REJECTED, bytes((reply.index,)))
        return _frame(reply.address, reply.function, _data(reply))

    def decode_request(self, data: bytes, /) -> DecodeResult:
        """Decode the request at offset 0 (station side). Raises ProtocolError."""
        size = _frame_size(data, REQUEST_LENGTHS)
        if len(data) < size:
            return Incomplete(size)
        _check_crc(data, size)
        if data[0] > LAST_ADDRESS:
            raise AddressError("huanyang.address", expected=LAST_ADDRESS, found=data[0])
        return Complete(HuanyangRequest(data[0], data[1], *_fields(data, size)), size)

    def decode_reply(self, request: HuanyangRequest, data: bytes, /) -> DecodeResult:
        """Decode the reply to ``request``. Raises ProtocolError; AddressError has ``size`` for a foreign frame."""
        size = _frame_size(data, REPLY_LENGTHS)
        if len(data) < size:
            return Incomplete(size)
        _check_crc(data, size)
        if request.address == BROADCAST:
            raise AddressError("huanyang.broadcast_answered", expected=BROADCAST, found=data[0])
        if data[0] != request.address:
            raise AddressError("protocols.address", expected=request.address, found=data[0], size=size)
        return Complete(_check_reply(request, parse_reply(data[:size])), size)

    def reply_size(self, request: HuanyangRequest, /) -> int:
        """Return the bytes of the longest normal reply; 0 for a broadcast."""
        if request.address == BROADCAST:
            return 0
        return HEAD_SIZE + REPLY_LENGTHS[request.function][-1] + CRC_SIZE

    def largest_reply(self, request: HuanyangRequest, /) -> int:
        return self.reply_size(request)

    def address_of(self, request: HuanyangRequest, /) -> int:
        return request.address


def parse_reply(data: bytes) -> HuanyangReply:
    """Return the reply in one whole frame whose CRC fits, without its request."""
    function = data[1]
    if function & REJECTED:
        return HuanyangReply(data[0], function & ~REJECTED, data[HEAD_SIZE], accepted=False)
    return HuanyangReply(data[0], function, *_fields(data, len(data)))


def frame_effect(frame: bytes) -> Effect:
    """Return the effect of one whole request frame; every frame that is not canonical is MOTION."""
    request: HuanyangRequest | None = canonical_request(HuanyangCodec(), frame)
    if request is None:
        return Effect.MOTION
    if request.function in (READ, STATUS):
        return Effect.NONE
    if request.function in (WRITE, FREQUENCY):
        return Effect.SETTING
    return Effect.STOP if request.value == STOP else Effect.MOTION


def _data(message: HuanyangRequest | HuanyangReply) -> bytes:
    """Return the data bytes. Raises ValueError where the value has more bytes than ``width`` or an index is too big."""
    lengths = REPLY_LENGTHS if isinstance(message, HuanyangReply) else REQUEST_LENGTHS
    has_index = message.function in (READ, WRITE, STATUS)
    if has_index + message.width not in lengths[message.function]:
        raise ValueError(f"{message.width} bytes of value for function {message.function}")
    if not 0 <= message.value < 1 << 8 * message.width or not 0 <= message.index <= LAST_PARAMETER:
        raise ValueError(f"index {message.index}, value {message.value}: out of range")
    return bytes((message.index,) * has_index) + message.value.to_bytes(message.width, "big")


def _frame(address: int, function: int, data: bytes) -> bytes:
    body = bytes((address, function, len(data))) + data
    return body + crc16(body).to_bytes(CRC_SIZE, "little")


def _frame_size(data: bytes, lengths: dict[int, tuple[int, ...]]) -> int:
    """Return the size of the frame, as far as its first three bytes tell. Raises ProtocolError."""
    if len(data) > 1 and data[1] & ~REJECTED not in lengths:
        raise CodeError("huanyang.function", expected="01-05", found=data[1])
    if len(data) < HEAD_SIZE:
        return SMALLEST_FRAME
    allowed = (1,) if data[1] & REJECTED else lengths[data[1]]
    if data[1] & REJECTED and lengths is REQUEST_LENGTHS:
        raise CodeError("huanyang.function", expected="01-05", found=data[1])
    if data[2] not in allowed:
        raise LengthError("huanyang.length", expected=tuple(map(str, allowed)), found=data[2])
    return HEAD_SIZE + data[2] + CRC_SIZE


def _check_crc(data: bytes, size: int) -> None:
    computed = crc16(data[: size - CRC_SIZE])
    received = int.from_bytes(data[size - CRC_SIZE : size], "little")
    if received != computed:
        raise ChecksumError("protocols.checksum", expected=computed, found=received)


def _fields(data: bytes, size: int) -> tuple[int, int, int]:
    """Return index, value and width of the value. Raises CodeError for a status item that no source names."""
    content = data[HEAD_SIZE : size - CRC_SIZE]
    index = content[0] if data[1] in (READ, WRITE, STATUS) else 0
    if data[1] == STATUS and index > LAST_ITEM:
        raise CodeError("huanyang.item", expected=LAST_ITEM, found=index)
    value = content[1:] if data[1] in (READ, WRITE, STATUS) else content
    return index, int.from_bytes(value, "big"), len(value)


def _check_reply(request: HuanyangRequest, reply: HuanyangReply) -> HuanyangReply:
    """Return the reply if it can belong to the request. Raises EchoError or CodeError."""
    if reply.function != request.function:
        raise CodeError("huanyang.reply_function", expected=request.function, found=reply.function)
    names_index = request.function in (READ, WRITE) or (request.function == STATUS and reply.accepted)
    if names_index and reply.index != request.index:
        raise EchoError("huanyang.index", expected=request.index, found=reply.index)
    if request.function == FREQUENCY and reply.accepted and reply.value != request.value:
        raise EchoError("huanyang.frequency", expected=request.value, found=reply.value)
    return reply
