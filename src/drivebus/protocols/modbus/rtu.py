"""Codec of Modbus RTU: octets and a CRC, low byte first. The silence around a frame is the bus's task.

Lengths come from the fields, so that chunks of any size give the same result.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final, Literal

from drivebus.errors import AddressError, ChecksumError, CodeError, LengthError, ProtocolError
from drivebus.protocols.checksum import crc16
from drivebus.protocols.codec import Complete, CompleteIfSilent, DecodeResult, Incomplete
from drivebus.protocols.modbus import pdu
from drivebus.protocols.modbus.messages import (
    BROADCAST,
    ECHO_FUNCTIONS,
    ILLEGAL_VALUE,
    MAX_READ,
    ExceptionReply,
    ModbusReply,
    ModbusRequest,
    ReadRegisters,
)

ErrorForm = Literal["exception", "short"]

CRC_SIZE: Final = 2
MIN_FRAME_SIZE: Final = 4
"""Address, function, CRC."""
EXCEPTION_FRAME_SIZE: Final = 5
MAX_FRAME_SIZE: Final = 256
"""Serial Line V1.02, 2.5.1."""
_CACHED_CRCS: Final = 4096
"""Distinct frames: a bus repeats its requests, and a drive at rest its replies; a CRC takes six times as long."""
_INCOMPLETE_REPLY: Final = Incomplete(EXCEPTION_FRAME_SIZE)
_INCOMPLETE_REQUEST: Final = Incomplete(MIN_FRAME_SIZE)


_frame_crc = lru_cache(_CACHED_CRCS)(crc16)


def build_frame(octets: bytes) -> bytes:
    """Return the frame of these octets."""
    return octets + _frame_crc(octets).to_bytes(CRC_SIZE, "little")


def check_frame(data: bytes, size: int) -> bytes:
    """Return the octets of the first ``size`` bytes. Raises ChecksumError with both CRCs."""
    octets = data[: size - CRC_SIZE]
    computed = _frame_crc(octets)
    if data[size - 2] != computed & 0xFF or data[size - 1] != computed >> 8:
        received = int.from_bytes(data[size - CRC_SIZE : size], "little")
        raise ChecksumError("modbus.crc", expected=computed, found=received)
    return octets


class ModbusRtuCodec:
    """Modbus RTU for masters and stations."""

    family: str = "modbus"
    encoding: str = "rtu"
    broadcast_address: int | None = BROADCAST

    def __init__(
        self,
        error_form: ErrorForm = "exception",
        max_read: int = MAX_READ,
        *,
        count_bytes: int = 1,
        rejected_read: int = 0,
    ) -> None:
        self.error_form: ErrorForm = error_form
        """With "short" the errors of DF800 (function unchanged, one byte 00) are accepted besides standard exceptions,
        and sent for ``ExceptionReply.code`` None."""
        self.max_read = max_read
        """Most registers of one read (VC660: 4)."""
        self.count_bytes = count_bytes
        """Bytes of the byte count in the reply to a read (Huanyang H2A: 2)."""
        self.rejected_read = rejected_read
        """Registers of a read that exception 03 alone answers, and no other read (Toshiba VF-S11: 2); 0 for none."""
        self._short_errors = error_form == "short"

    def encode_request(self, request: ModbusRequest, /) -> bytes:
        """Return the frame of a request. Raises ValueError for a field out of range."""
        max_count = self.rejected_read if self._is_rejected_read(request) else self.max_read
        return build_frame(pdu.encode_request(request, max_count))

    def encode_reply(self, reply: ModbusReply, /) -> bytes:
        """Return the frame of a reply. Raises ValueError for a field out of range."""
        return build_frame(pdu.encode_reply(reply, self.count_bytes))

    def decode_reply(self, request: ModbusRequest, data: bytes, /) -> DecodeResult:
        """Decode the reply to ``request``. Raises ProtocolError; AddressError has ``size`` for a foreign frame."""
        if len(data) < EXCEPTION_FRAME_SIZE:
            return _INCOMPLETE_REPLY
        if self._short_errors and data[2] == 0 and data[1] in ECHO_FUNCTIONS:
            result = self._short_error(request, data)
            if result is not None:
                return result
        size = pdu.reply_length(request, data, short=self._short_errors, count_bytes=self.count_bytes) + CRC_SIZE
        if len(data) < size:
            return Incomplete(size)
        octets = check_frame(data, size)
        try:
            message = pdu.parse_reply(request, octets, self.count_bytes)
        except AddressError as error:
            error.size = size
            raise
        if self.rejected_read:
            self._check_rejection(request, message)
        return Complete(message, size)

    def _is_rejected_read(self, request: ModbusRequest) -> bool:
        return self.rejected_read > 0 and isinstance(request, ReadRegisters) and request.count == self.rejected_read

    def _check_rejection(self, request: ModbusRequest, reply: ModbusReply) -> None:
        """Raise CodeError where a rejected read got another reply than exception 03, or another read got this one."""
        code = reply.code if isinstance(reply, ExceptionReply) else 0
        if self._is_rejected_read(request) and code != ILLEGAL_VALUE:
            raise CodeError("modbus.exception_code", expected=ILLEGAL_VALUE, found=code)
        if isinstance(request, ReadRegisters) and request.count != self.rejected_read and code == ILLEGAL_VALUE:
            raise CodeError("modbus.exception_code", expected=("1-2", "4-8", "10", "11"), found=code)

    def _short_error(self, request: ModbusRequest, data: bytes) -> DecodeResult | None:
        """Return the short error in five bytes; None where they begin the acknowledgement of this request.

        At address 1 only the acknowledgement of a write of A0xxH to 0023H begins like the error; silence then decides.
        """
        error = data[:EXCEPTION_FRAME_SIZE]
        if crc16(error) or request.address == BROADCAST:
            return None
        if data[0] != request.address:
            raise AddressError("modbus.address", expected=request.address, found=data[0], size=EXCEPTION_FRAME_SIZE)
        if data[1] != request.function:
            return None
        message = ExceptionReply(data[0], data[1], None)
        echo = self.encode_request(request)
        echo = echo if len(echo) == 8 else build_frame(echo[:6])
        if not echo.startswith(error):
            return Complete(message, EXCEPTION_FRAME_SIZE)
        if len(data) < len(echo):
            return CompleteIfSilent(message, EXCEPTION_FRAME_SIZE, len(echo))
        return None

    def decode_request(self, data: bytes, /) -> DecodeResult:
        """Decode the request at offset 0. Raises IllegalRequest where a station answers with an exception.

        A request of an unknown function ends with the first byte that makes the CRC fit; a station answers it
        (exception 01) only after silence.
        """
        if len(data) < MIN_FRAME_SIZE:
            return _INCOMPLETE_REQUEST
        extent = pdu.request_length(data)
        size = self._size_of_unknown_function(data) if extent is None else extent + CRC_SIZE
        if len(data) < size:
            return Incomplete(size)
        octets = check_frame(data, size)
        try:
            return Complete(pdu.parse_request(octets), size)
        except ProtocolError as error:
            error.size = size
            raise

    def _size_of_unknown_function(self, data: bytes) -> int:
        """Return the size at which the CRC first fits, else one byte more than given. Raises LengthError above 256."""
        crc = crc16(data[: MIN_FRAME_SIZE - 1])
        for size in range(MIN_FRAME_SIZE, min(len(data), MAX_FRAME_SIZE) + 1):
            crc = crc16(data[size - 1 : size], crc)
            if crc == 0:
                return size
        if len(data) >= MAX_FRAME_SIZE:
            raise LengthError("modbus.too_long", expected=MAX_FRAME_SIZE, found=MAX_FRAME_SIZE)
        return len(data) + 1

    def reply_size(self, request: ModbusRequest, /) -> int:
        """Return the bytes of the normal reply; 0 for a broadcast."""
        if request.address == BROADCAST:
            return 0
        if self._is_rejected_read(request):
            return EXCEPTION_FRAME_SIZE
        return pdu.normal_reply_length(request, self.count_bytes) + CRC_SIZE

    def largest_reply(self, request: ModbusRequest, /) -> int:
        """Return the bytes of the longest valid reply: the normal one, as an error is never longer."""
        return self.reply_size(request)

    def address_of(self, request: ModbusRequest, /) -> int:
        """Return the station address of a request."""
        return request.address
