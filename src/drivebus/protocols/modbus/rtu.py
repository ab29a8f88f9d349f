"""Modbus RTU: octets and a CRC, low byte first. Sans-IO; the gap around a frame belongs to the bus.

Lengths come from the fields, so that chunks of any size give the same answer.
"""

from __future__ import annotations

from typing import Final, Literal

from drivebus.errors import AddressError, ChecksumError, LengthError, ProtocolError
from drivebus.message import Complete, CompleteIfSilent, Incomplete, Verdict
from drivebus.protocols.checksum import crc16
from drivebus.protocols.modbus import replies, requests
from drivebus.protocols.modbus.messages import BROADCAST, ECHO_FUNCTIONS, MAX_READ, ErrorReply, Reply, Request

ErrorForm = Literal["exception", "short"]

CHECK: Final = 2
SMALLEST: Final = 4
"""Address, function, CRC."""
ERROR_SIZE: Final = 5
LARGEST: Final = 256
"""Serial Line V1.02, 2.5.1."""
_FIRST_REPLY: Final = Incomplete(ERROR_SIZE)
_FIRST_REQUEST: Final = Incomplete(SMALLEST)


def with_check(octets: bytes) -> bytes:
    """The frame of these octets."""
    return octets + crc16(octets).to_bytes(CHECK, "little")


def checked(data: bytes, size: int) -> bytes:
    """The octets of the first ``size`` bytes. Raises ChecksumError with both CRCs, as numbers."""
    octets = data[: size - CHECK]
    computed = crc16(octets)
    if data[size - 2] != computed & 0xFF or data[size - 1] != computed >> 8:
        received = int.from_bytes(data[size - CHECK : size], "little")
        raise ChecksumError("modbus.crc", expected=computed, found=received)
    return octets


class RtuCodec:
    """Modbus RTU for masters and stations.

    ``error_form`` "short" takes DF800's errors (function unchanged, one byte 00) besides standard exceptions, and sends
    them for ``ErrorReply.code`` None (T15). ``max_read`` is the most registers that one read may ask for (VC660: 4).
    """

    family: str = "modbus"
    encoding: str = "rtu"
    broadcast_address: int | None = BROADCAST

    def __init__(self, error_form: ErrorForm = "exception", max_read: int = MAX_READ) -> None:
        self.error_form: ErrorForm = error_form
        self.max_read = max_read
        self._short = error_form == "short"

    def encode_request(self, request: Request, /) -> bytes:
        """The bytes of a request. Raises ValueError for a field out of range."""
        return with_check(requests.encode_request(request, self.max_read))

    def encode_reply(self, reply: Reply, /) -> bytes:
        """The bytes of a station's reply. Raises ValueError for a field out of range."""
        return with_check(replies.encode_reply(reply))

    def decode_reply(self, request: Request, data: bytes, /) -> Verdict:
        """Is this the reply to that request? Raises ProtocolError; ``AddressError.size`` for another's whole frame."""
        if len(data) < ERROR_SIZE:
            return _FIRST_REPLY
        if self._short and data[2] == 0 and data[1] in ECHO_FUNCTIONS:
            verdict = self._short_error(request, data)
            if verdict is not None:
                return verdict
        size = replies.reply_extent(request, data, self._short) + CHECK
        if len(data) < size:
            return Incomplete(size)
        octets = checked(data, size)
        try:
            return Complete(replies.read_reply(request, octets), size)
        except AddressError as error:
            error.size = size
            raise

    def _short_error(self, request: Request, data: bytes) -> Verdict | None:
        """Five bytes of error, where they are one and not the beginning of this request's own echo (T15, ruling 11).

        At address 1 only a write of A0xxH to 0023H has an echo that begins like the error; only then is silence asked.
        """
        error = data[:ERROR_SIZE]
        if crc16(error) or request.address == BROADCAST:
            return None
        if data[0] != request.address:
            raise AddressError("modbus.address", expected=request.address, found=data[0], size=ERROR_SIZE)
        if data[1] != request.function:
            return None
        message = ErrorReply(data[0], data[1], None)
        echo = self.encode_request(request)
        echo = echo if len(echo) == 8 else with_check(echo[:6])
        if not echo.startswith(error):
            return Complete(message, ERROR_SIZE)
        if len(data) < len(echo):
            return CompleteIfSilent(message, ERROR_SIZE, len(echo))
        return None

    def decode_request(self, data: bytes, /) -> Verdict:
        """Station side: the request at offset 0. Raises BadRequest where a station answers with an exception.

        The length of an unknown function is told by nothing but its CRC: it ends with the first byte that makes the
        CRC fit. A station answers it (exception 01) after silence only.
        """
        if len(data) < SMALLEST:
            return _FIRST_REQUEST
        extent = requests.request_extent(data)
        size = self._unknown_size(data) if extent is None else extent + CHECK
        if len(data) < size:
            return Incomplete(size)
        octets = checked(data, size)
        try:
            return Complete(requests.read_request(octets), size)
        except ProtocolError as error:
            error.size = size
            raise

    def _unknown_size(self, data: bytes) -> int:
        """Where the CRC fits first, else one byte more than there is. Raises LengthError beyond the largest frame."""
        crc = crc16(data[: SMALLEST - 1])
        for size in range(SMALLEST, min(len(data), LARGEST) + 1):
            crc = crc16(data[size - 1 : size], crc)
            if crc == 0:
                return size
        if len(data) >= LARGEST:
            raise LengthError("modbus.too_long", expected=LARGEST, found=LARGEST)
        return len(data) + 1

    def reply_size(self, request: Request, /) -> int:
        """Bytes of the normal reply; 0 for a broadcast."""
        return 0 if request.address == BROADCAST else replies.reply_octets(request) + CHECK

    def largest_reply(self, request: Request, /) -> int:
        """Bytes of the longest lawful reply: the normal one (an error is never longer)."""
        return self.reply_size(request)

    def address_of(self, request: Request, /) -> int:
        """The station that the request speaks to."""
        return request.address
