"""Messages and frames of Mitsubishi's computer link, and the effect of a request frame.

    request      ENQ · station · instruction code · waiting time · data · sum check
    read reply   STX · station · data · ETX · sum check
    write reply  ACK · station                  rejection   NAK · station · error code

Station, code, data and sum check are upper-case hexadecimal digits; the sum is that of the bytes between the control
codes, its lowest byte (FR-E500 manual, pages 102 and 103; FR-F500 manual, page 114). No CR or LF (Pr.124 = 0). A reply
does not name the instruction code of its request: only its form and its number of digits tell two replies apart.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from drivebus.errors import (
    AddressError,
    ChecksumError,
    CodeError,
    EchoError,
    HeaderError,
    TerminatorError,
)
from drivebus.protocols.checksum import canonical_digits, hex_digits, hex_value
from drivebus.protocols.codec import Complete, DecodeResult, Effect, Incomplete, canonical_request

STX, ETX, ENQ, ACK, NAK = 0x02, 0x03, 0x05, 0x06, 0x15
LAST_STATION: Final = 0x1F
OUTPUT_FREQUENCY, OUTPUT_CURRENT, OUTPUT_VOLTAGE, STATUS = 0x6F, 0x70, 0x71, 0x7A
SET_FREQUENCY, RUN_COMMAND = 0xED, 0xFA
STOP, RUN_FORWARD, RUN_REVERSE = 0x00, 0x02, 0x04
READ_DIGITS = {OUTPUT_FREQUENCY: 4, OUTPUT_CURRENT: 4, OUTPUT_VOLTAGE: 4, STATUS: 2}
"""Instruction code of a read to the digits of its reply."""
WRITE_DIGITS = {SET_FREQUENCY: 4, RUN_COMMAND: 2}
"""Instruction code of a write to its digits."""
WAITING_TIME: Final = b"1"
"""10 ms before the drive replies, in frames to a drive with Pr.123 = 9999."""
REQUEST_HEAD_SIZE: Final = 6
"""ENQ, station, instruction code, waiting time."""
SUM_SIZE: Final = 2
ACK_SIZE, NAK_SIZE = 3, 4


@dataclass(frozen=True, slots=True)
class MitsubishiRequest:
    """Read or write, by its instruction code; ``data`` is that of a write."""

    address: int
    code: int
    data: int = 0


@dataclass(frozen=True, slots=True)
class MitsubishiReply:
    """Reply: the data of a read, 0 of a write. ``error``: the error code with which the drive rejects the request."""

    address: int
    data: int = 0
    digits: int = 0
    error: int | None = field(default=None, kw_only=True)


class MitsubishiCodec:
    """Both sides of the protocol."""

    family = "mitsubishi"
    encoding = "ascii"
    broadcast_address: int | None = None

    def encode_request(self, request: MitsubishiRequest, /) -> bytes:
        """Return the frame of a request. Raises ValueError for a field out of range."""
        if not 0 <= request.address <= LAST_STATION:
            raise ValueError(f"station {request.address}: expected 0 to {LAST_STATION}")
        digits = WRITE_DIGITS.get(request.code, 0)
        if request.code not in READ_DIGITS and not digits:
            raise ValueError(f"instruction code {request.code:02X}H is not one of this codec")
        if request.data and not digits:
            raise ValueError("a read carries no data")
        data = hex_digits(request.data, digits) if digits else b""
        body = hex_digits(request.address, 2) + hex_digits(request.code, 2) + WAITING_TIME + data
        return bytes((ENQ,)) + body + _sum_check(body)

    def encode_reply(self, reply: MitsubishiReply, /) -> bytes:
        """Return the frame of a reply. Raises ValueError for a field out of range."""
        station = hex_digits(reply.address, 2)
        if reply.error is not None:
            return bytes((NAK,)) + station + hex_digits(reply.error, 1)
        if not reply.digits:
            return bytes((ACK,)) + station
        body = station + hex_digits(reply.data, reply.digits)
        return bytes((STX,)) + body + bytes((ETX,)) + _sum_check(body)

    def decode_request(self, data: bytes, /) -> DecodeResult:
        """Decode the request at offset 0 (station side). Raises ProtocolError."""
        if data and data[0] != ENQ:
            raise HeaderError("protocols.header", expected=ENQ, found=data[0])
        if len(data) < REQUEST_HEAD_SIZE:
            return Incomplete(REQUEST_HEAD_SIZE)
        code = hex_value(data[3:5], start=3)
        if code not in READ_DIGITS and code not in WRITE_DIGITS:
            raise CodeError("mitsubishi.code", expected=_known_codes(), found=code)
        digits = WRITE_DIGITS.get(code, 0)
        size = REQUEST_HEAD_SIZE + digits + SUM_SIZE
        if len(data) < size:
            return Incomplete(size)
        body = data[1 : size - SUM_SIZE]
        _check_sum(body, data[size - SUM_SIZE : size])
        address = hex_value(data[1:3], start=1)
        if address > LAST_STATION:
            raise AddressError("mitsubishi.station", expected=LAST_STATION, found=address)
        canonical_digits(data[5:6], start=5)
        value = hex_value(data[6 : 6 + digits], start=6) if digits else 0
        return Complete(MitsubishiRequest(address, code, value), size)

    def decode_reply(self, request: MitsubishiRequest, data: bytes, /) -> DecodeResult:
        """Decode the reply to ``request``. Raises ProtocolError; AddressError has ``size`` for a foreign frame."""
        if not data:
            return Incomplete(ACK_SIZE)
        if data[0] not in (STX, ACK, NAK):
            raise HeaderError("mitsubishi.reply_header", expected=("02", "06", "15"), found=data[0])
        digits = READ_DIGITS.get(request.code, 0)
        if (data[0] == ACK and digits) or (data[0] == STX and not digits):
            raise EchoError("mitsubishi.reply_form", expected="02" if digits else "06", found=data[0])
        size = {ACK: ACK_SIZE, NAK: NAK_SIZE}.get(data[0], 1 + 2 + digits + 1 + SUM_SIZE)
        if len(data) < size:
            return Incomplete(size)
        reply = _parse_reply(data, size, digits)
        if reply.address != request.address:
            raise AddressError("protocols.address", expected=request.address, found=reply.address, size=size)
        return Complete(reply, size)

    def reply_size(self, request: MitsubishiRequest, /) -> int:
        """Return the bytes of the normal reply."""
        digits = READ_DIGITS.get(request.code)
        return ACK_SIZE if digits is None else 1 + 2 + digits + 1 + SUM_SIZE

    def largest_reply(self, request: MitsubishiRequest, /) -> int:
        return max(self.reply_size(request), NAK_SIZE)

    def address_of(self, request: MitsubishiRequest, /) -> int:
        return request.address


def frame_effect(frame: bytes) -> Effect:
    """Return the effect of one whole request frame; every frame that is not canonical is MOTION."""
    request: MitsubishiRequest | None = canonical_request(MitsubishiCodec(), frame)
    if request is None:
        return Effect.MOTION
    if request.code in READ_DIGITS:
        return Effect.NONE
    if request.code == SET_FREQUENCY:
        return Effect.SETTING
    return Effect.STOP if request.data == STOP else Effect.MOTION


def _parse_reply(data: bytes, size: int, digits: int) -> MitsubishiReply:
    if data[0] == STX:
        if data[3 + digits] != ETX:
            raise TerminatorError("protocols.terminator", expected=ETX, found=data[3 + digits], position=3 + digits)
        _check_sum(data[1 : 3 + digits], data[size - SUM_SIZE : size])
        return MitsubishiReply(hex_value(data[1:3], start=1), hex_value(data[3 : 3 + digits], start=3), digits)
    address = hex_value(data[1:3], start=1)
    return MitsubishiReply(address, error=hex_value(data[3:4], start=3) if data[0] == NAK else None)


def _sum_check(body: bytes) -> bytes:
    return hex_digits(sum(body) & 0xFF, SUM_SIZE)


def _check_sum(body: bytes, digits: bytes) -> None:
    received, computed = hex_value(digits), sum(body) & 0xFF
    if received != computed:
        raise ChecksumError("protocols.checksum", expected=computed, found=received)


def _known_codes() -> tuple[str, ...]:
    return tuple(f"{code:02X}" for code in sorted({*READ_DIGITS, *WRITE_DIGITS}))
