"""Modbus ASCII: ':' , upper-case hex digits, LRC, CR LF. Sans-IO.

Strict at offset 0; lengths come from the fields, and CR LF is checked where it must stand, not searched. The one
exception is a request of an unknown function, whose length nothing else tells. Source: Serial Line V1.02, 2.5.2;
DF800 manual, ASCII frame table (17, 11+2N and 11 characters).
"""

from __future__ import annotations

from typing import Final

from drivebus.errors import AddressError, ChecksumError, HeaderError, LengthError, ProtocolError, TerminatorError
from drivebus.message import Complete, Incomplete, Verdict
from drivebus.protocols.checksum import hex_bytes, hex_pairs, hex_value, lrc
from drivebus.protocols.modbus import replies, requests
from drivebus.protocols.modbus.messages import BROADCAST, MAX_READ, Reply, Request
from drivebus.protocols.modbus.rtu import ErrorForm

START: Final = 0x3A
END: Final = b"\r\n"
ERROR_SIZE: Final = 11
"""Shortest reply: ':', six digits, two of LRC, CR LF."""
SMALLEST: Final = 9
LARGEST: Final = 513
_FIRST_REPLY: Final = Incomplete(ERROR_SIZE)
_FIRST_REQUEST: Final = Incomplete(SMALLEST)
RESYNC: Final = 4
"""With ``resync``: this many bytes of junk may stand before ':' (RELIABILITY 6.4, leading garbage)."""


def size_of(octets: int) -> int:
    """Characters of a frame with so many octets before its LRC."""
    return 2 * octets + 5


def with_check(octets: bytes) -> bytes:
    """The frame of these octets."""
    return b":" + hex_pairs(octets + bytes((lrc(octets),))) + END


def checked(frame: bytes) -> bytes:
    """The octets of a whole frame. Raises TerminatorError, AlphabetError or ChecksumError."""
    if not frame.endswith(END):
        raise TerminatorError("modbus.terminator", expected="0D 0A", found=frame[-2:].hex(" ").upper())
    octets = hex_bytes(frame[1:-2], start=1)
    computed = lrc(octets[:-1])
    if octets[-1] != computed:
        raise ChecksumError("modbus.lrc", expected=computed, found=octets[-1])
    return octets[:-1]


class AsciiCodec:
    """Modbus ASCII for masters and stations; options as ``RtuCodec``.

    ``resync`` allows up to four bytes of junk before the first ':' (ruling 10, a port's or profile's choice).
    """

    family: str = "modbus"
    encoding: str = "ascii"
    broadcast_address: int | None = BROADCAST

    def __init__(self, error_form: ErrorForm = "exception", max_read: int = MAX_READ, *, resync: bool = False) -> None:
        self.error_form: ErrorForm = error_form
        self.max_read = max_read
        self.resync = resync
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
        junk = self._start(data)
        frame = data[junk:]
        if len(frame) < ERROR_SIZE:
            return Incomplete(junk + ERROR_SIZE)
        size = size_of(self._reply_extent(request, frame))
        if len(frame) < size:
            return Incomplete(junk + size)
        octets = checked(frame[:size])
        try:
            return Complete(replies.read_reply(request, octets), junk + size)
        except AddressError as error:
            error.size = junk + size
            raise

    def _reply_extent(self, request: Request, frame: bytes) -> int:
        """An 11-character short error of a write has its CR LF where its echo has digits: nothing is ambiguous."""
        head = hex_bytes(frame[1:7], start=1)
        extent = replies.reply_extent(request, head, self._short)
        if self._short and head[2] == 0 and frame[9:11] == END:  # other functions' extent is 3 anyhow
            return 3
        return extent

    def decode_request(self, data: bytes, /) -> Verdict:
        """Station side: the request at offset 0. Raises BadRequest where a station answers with an exception."""
        if len(data) < SMALLEST:
            return _FIRST_REQUEST
        junk = self._start(data)
        frame = data[junk:]
        if len(frame) < SMALLEST:
            return Incomplete(junk + SMALLEST)
        size = self._request_size(frame)
        if len(frame) < size:
            return Incomplete(junk + size)
        octets = checked(frame[:size])
        try:
            return Complete(requests.read_request(octets), junk + size)
        except ProtocolError as error:
            error.size = junk + size
            raise

    def _request_size(self, frame: bytes) -> int:
        head = hex_bytes(frame[1:5], start=1)
        extent = requests.request_extent(head)
        if extent is None:
            return self._unknown_size(frame)
        if extent == 7 and len(frame) >= 15:
            extent += hex_value(frame[13:15], start=13)
        return size_of(extent)

    def _unknown_size(self, frame: bytes) -> int:
        end = frame.find(END, 6, LARGEST)
        if end != -1:
            if end % 2 == 0:
                raise LengthError("modbus.odd_digits", expected=end, found=end - 1)
            return end + len(END)
        if len(frame) >= LARGEST:
            raise LengthError("modbus.too_long", expected=LARGEST, found=LARGEST)
        return len(frame) + 1

    def _start(self, data: bytes) -> int:
        """Where ':' stands: at 0, or after a little junk where that is allowed. Raises HeaderError."""
        found = data.find(START, 0, RESYNC + 1 if self.resync else 1)
        if found != -1:
            return found
        raise HeaderError("modbus.start", expected=START, found=data[0])

    def reply_size(self, request: Request, /) -> int:
        """Characters of the normal reply; 0 for a broadcast."""
        return 0 if request.address == BROADCAST else size_of(replies.reply_octets(request))

    def largest_reply(self, request: Request, /) -> int:
        """Characters of the longest lawful reply, with the junk that ``resync`` allows."""
        size = self.reply_size(request)
        return size + RESYNC if size and self.resync else size

    def address_of(self, request: Request, /) -> int:
        """The station that the request speaks to."""
        return request.address
