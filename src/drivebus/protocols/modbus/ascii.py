"""Codec of Modbus ASCII: ':' , upper-case hex digits, LRC, CR LF.

Lengths come from the fields, and CR LF is checked where it must stand; only a request of an unknown function, which has
no length, ends at the first CR LF. Source: Serial Line V1.02, 2.5.2; DF800 manual,
ASCII frame table (17, 11+2N and 11 characters).
"""

from __future__ import annotations

from typing import Final

from drivebus.errors import AddressError, ChecksumError, HeaderError, LengthError, ProtocolError, TerminatorError
from drivebus.protocols.checksum import hex_bytes, hex_pairs, hex_value, lrc
from drivebus.protocols.codec import Complete, DecodeResult, Incomplete
from drivebus.protocols.modbus import pdu
from drivebus.protocols.modbus.messages import BROADCAST, MAX_READ, ModbusReply, ModbusRequest
from drivebus.protocols.modbus.rtu import ErrorForm

START_MARK: Final = 0x3A
END_MARK: Final = b"\r\n"
EXCEPTION_FRAME_SIZE: Final = 11
"""Shortest reply: ':', six digits, two of LRC, CR LF."""
MIN_FRAME_SIZE: Final = 9
MAX_FRAME_SIZE: Final = 513
_INCOMPLETE_REPLY: Final = Incomplete(EXCEPTION_FRAME_SIZE)
_INCOMPLETE_REQUEST: Final = Incomplete(MIN_FRAME_SIZE)
MAX_LEADING_NOISE: Final = 4
"""Bytes that may stand before ':' with ``tolerate_leading_noise``."""


def frame_size(octets: int) -> int:
    """Return the characters of a frame with this many octets before its LRC."""
    return 2 * octets + 5


def build_frame(octets: bytes) -> bytes:
    """Return the frame of these octets."""
    return b":" + hex_pairs(octets + bytes((lrc(octets),))) + END_MARK


def check_frame(frame: bytes) -> bytes:
    """Return the octets of a whole frame, without its LRC. Raises TerminatorError, AlphabetError or ChecksumError."""
    if not frame.endswith(END_MARK):
        raise TerminatorError("modbus.terminator", expected="0D 0A", found=frame[-2:].hex(" ").upper())
    octets = hex_bytes(frame[1:-2], start=1)
    computed = lrc(octets[:-1])
    if octets[-1] != computed:
        raise ChecksumError("modbus.lrc", expected=computed, found=octets[-1])
    return octets[:-1]


class ModbusAsciiCodec:
    """Modbus ASCII for masters and stations; options as ``ModbusRtuCodec``.

    ``tolerate_leading_noise`` accepts up to four stray bytes before the first ':', which a profile may allow.
    """

    family: str = "modbus"
    encoding: str = "ascii"
    broadcast_address: int | None = BROADCAST

    def __init__(
        self, error_form: ErrorForm = "exception", max_read: int = MAX_READ, *, tolerate_leading_noise: bool = False
    ) -> None:
        self.error_form: ErrorForm = error_form
        self.max_read = max_read
        self.tolerate_leading_noise = tolerate_leading_noise
        self._short_errors = error_form == "short"

    def encode_request(self, request: ModbusRequest, /) -> bytes:
        """Return the frame of a request. Raises ValueError for a field out of range."""
        return build_frame(pdu.encode_request(request, self.max_read))

    def encode_reply(self, reply: ModbusReply, /) -> bytes:
        """Return the frame of a reply. Raises ValueError for a field out of range."""
        return build_frame(pdu.encode_reply(reply))

    def decode_reply(self, request: ModbusRequest, data: bytes, /) -> DecodeResult:
        """Decode the reply to ``request``. Raises ProtocolError; AddressError has ``size`` for a foreign frame."""
        if len(data) < EXCEPTION_FRAME_SIZE:
            return _INCOMPLETE_REPLY
        noise = self._find_start(data)
        frame = data[noise:]
        if len(frame) < EXCEPTION_FRAME_SIZE:
            return Incomplete(noise + EXCEPTION_FRAME_SIZE)
        size = frame_size(self._reply_length(request, frame))
        if len(frame) < size:
            return Incomplete(noise + size)
        octets = check_frame(frame[:size])
        try:
            return Complete(pdu.parse_reply(request, octets), noise + size)
        except AddressError as error:
            error.size = noise + size
            raise

    def _reply_length(self, request: ModbusRequest, frame: bytes) -> int:
        """Return the octets of a reply; a short error has CR LF where a write acknowledgement has digits."""
        head = hex_bytes(frame[1:7], start=1)
        length = pdu.reply_length(request, head, short=self._short_errors)
        is_short_error = self._short_errors and head[2] == 0 and frame[9:11] == END_MARK
        return 3 if is_short_error else length

    def decode_request(self, data: bytes, /) -> DecodeResult:
        """Decode the request at offset 0. Raises IllegalRequest where a station answers with an exception."""
        if len(data) < MIN_FRAME_SIZE:
            return _INCOMPLETE_REQUEST
        noise = self._find_start(data)
        frame = data[noise:]
        if len(frame) < MIN_FRAME_SIZE:
            return Incomplete(noise + MIN_FRAME_SIZE)
        size = self._request_size(frame)
        if len(frame) < size:
            return Incomplete(noise + size)
        octets = check_frame(frame[:size])
        try:
            return Complete(pdu.parse_request(octets), noise + size)
        except ProtocolError as error:
            error.size = noise + size
            raise

    def _request_size(self, frame: bytes) -> int:
        head = hex_bytes(frame[1:5], start=1)
        length = pdu.request_length(head)
        if length is None:
            return self._size_of_unknown_function(frame)
        if length == 7 and len(frame) >= 15:
            length += hex_value(frame[13:15], start=13)
        return frame_size(length)

    def _size_of_unknown_function(self, frame: bytes) -> int:
        end = frame.find(END_MARK, 6, MAX_FRAME_SIZE)
        if end != -1:
            if end % 2 == 0:
                raise LengthError("modbus.odd_digits", expected=end, found=end - 1)
            return end + len(END_MARK)
        if len(frame) >= MAX_FRAME_SIZE:
            raise LengthError("modbus.too_long", expected=MAX_FRAME_SIZE, found=MAX_FRAME_SIZE)
        return len(frame) + 1

    def _find_start(self, data: bytes) -> int:
        """Return the offset of ':': 0, or more where leading noise is allowed. Raises HeaderError."""
        start = data.find(START_MARK, 0, MAX_LEADING_NOISE + 1 if self.tolerate_leading_noise else 1)
        if start != -1:
            return start
        raise HeaderError("modbus.start", expected=START_MARK, found=data[0])

    def reply_size(self, request: ModbusRequest, /) -> int:
        """Return the characters of the normal reply; 0 for a broadcast."""
        return 0 if request.address == BROADCAST else frame_size(pdu.normal_reply_length(request))

    def largest_reply(self, request: ModbusRequest, /) -> int:
        """Return the characters of the longest valid reply, with the leading noise that is allowed."""
        size = self.reply_size(request)
        return size + MAX_LEADING_NOISE if size and self.tolerate_leading_noise else size

    def address_of(self, request: ModbusRequest, /) -> int:
        """Return the station address of a request."""
        return request.address
