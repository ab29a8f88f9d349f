"""C320 frames from messages and back, for a host and for a station. Strict at offset 0, length first (T06).

What the shape of a reply cannot tell, and only position and time on the wire can: whether it answers a read of F0.n
or of monitor d.n, a RAM or an EEPROM write (T04), a command or a poll of the monitor that F6.12 selects; and whether
"response 3, state 00, data 0000" is a refusal or the echo of one's own class-3 write of 0 (T21). Both read as
*refused*, so the echo can never pass for success; an echo with other data is an EchoError.
"""

from __future__ import annotations

from typing import Literal

from drivebus.protocols.checksum import STRICT_HEX_DIGITS, TOLERANT_HEX_DIGITS
from drivebus.protocols.codec import Complete, DecodeResult, Incomplete
from drivebus.protocols.sunfar.frame import (
    SHORT_LAYOUT,
    WRITE_LAYOUT,
    AsciiFormat,
    FieldFormat,
    MixedFormat,
    PackedFormat,
)
from drivebus.protocols.sunfar.messages import SunfarReply, SunfarRequest
from drivebus.protocols.sunfar.replies import build_reply, expected_reply_size, validate_reply, validate_short_reply
from drivebus.protocols.sunfar.requests import build_request, decode_request
from drivebus.protocols.sunfar.tables import BROADCAST


class SunfarCodec:
    """One encoding of the C320 protocol.

    ``digits`` "tolerant" also reads 3AH-3FH and a-f (T02). ``nibble`` also reads hex frames printed one nibble a
    byte (T03): then a reply's ``other_data`` says where its data are ambiguous. Both only read: what is written is
    always canonical.
    """

    family = "c320"
    broadcast_address = BROADCAST

    def __init__(
        self,
        encoding: Literal["ascii", "hex"] = "ascii",
        digits: Literal["strict", "tolerant"] = "strict",
        nibble: bool = False,
    ) -> None:
        self.encoding: str = encoding
        self.digits = digits
        self.nibble = nibble
        self._format = _field_format(encoding, digits, nibble)

    # -- host side ---------------------------------------------------------------------------------------------

    def encode_request(self, request: SunfarRequest) -> bytes:
        """The frame of a request; only ``Control`` puts an operation into it (T01, T07).

        Raises ValueError for a field out of range, a read of everybody, or data with an operation that has none.
        """
        return build_request(self._format, request)

    def decode_reply(self, request: SunfarRequest, data: bytes) -> DecodeResult:
        """Is this the reply to that request? Length, head, address, echoes, enumerated codes, digits, sum, end mark.

        A refusal is a ``Reply`` with its response code. AddressError has ``size`` where another station's frame
        was whole and valid. Bytes after the frame are not looked at.
        """
        size = expected_reply_size(self._format, data)
        if len(data) < size:
            return Incomplete(size)
        judge = validate_short_reply if size == SHORT_LAYOUT.size else validate_reply
        return Complete(judge(request, data[:size], self._format), size)

    def reply_size(self, request: SunfarRequest) -> int:
        """18; 0 for a broadcast."""
        return 0 if request.address == BROADCAST else WRITE_LAYOUT.size

    def largest_reply(self, request: SunfarRequest) -> int:
        """18; 0 for a broadcast."""
        return self.reply_size(request)

    def address_of(self, request: SunfarRequest) -> int:
        """The station spoken to; 31 is everybody."""
        return request.address

    # -- station side ------------------------------------------------------------------------------------------

    def encode_reply(self, reply: SunfarReply) -> bytes:
        """The canonical frame of a reply. Raises ValueError for a field out of range or missing."""
        return build_reply(self._format, reply)

    def decode_request(self, data: bytes) -> DecodeResult:
        """``Complete(Heard, size)``. ``messages.short_reply`` tells what a station answers to the error raised."""
        return decode_request(self._format, data)


def _field_format(encoding: str, digits: str, nibble: bool) -> FieldFormat:
    if encoding == "ascii":
        return AsciiFormat(TOLERANT_HEX_DIGITS if digits == "tolerant" else STRICT_HEX_DIGITS)
    if encoding == "hex":
        return MixedFormat() if nibble else PackedFormat()
    raise ValueError(f"encoding {encoding!r}: expected ascii or hex")
