"""C320 frames from messages and back, for a host and for a station. Strict at offset 0, length first (T06).

What the shape of a reply cannot tell, and only position and time on the wire can: whether it answers a read of F0.n
or of monitor d.n, a RAM or an EEPROM write (T04), a command or a poll of the monitor that F6.12 selects; and whether
"response 3, state 00, data 0000" is a refusal or the echo of one's own class-3 write of 0 (T21). Both read as
*refused*, so the echo can never pass for success; an echo with other data is an EchoError.
"""

from __future__ import annotations

from typing import Literal

from drivebus.message import Complete, Incomplete, Verdict
from drivebus.protocols.checksum import STRICT, TOLERANT
from drivebus.protocols.sifang.frame import SHORT, WRITE, AsciiForm, Form, MixedForm, PackedForm
from drivebus.protocols.sifang.messages import Reply, Request
from drivebus.protocols.sifang.replies import build_reply, framed_size, judged, judged_short
from drivebus.protocols.sifang.requests import build_request, hear
from drivebus.protocols.sifang.tables import BROADCAST


class SifangCodec:
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
        self._form = _form(encoding, digits, nibble)

    # -- host side ---------------------------------------------------------------------------------------------

    def encode_request(self, request: Request) -> bytes:
        """The frame of a request; only ``Control`` puts an operation into it (T01, T07).

        Raises ValueError for a field out of range, a read of everybody, or data with an operation that has none.
        """
        return build_request(self._form, request)

    def decode_reply(self, request: Request, data: bytes) -> Verdict:
        """Is this the reply to that request? Length, head, address, echoes, enumerated codes, digits, sum, end mark.

        A refusal is a ``Reply`` with its response code. AddressError has ``size`` where another station's frame
        was whole and valid. Bytes after the frame are not looked at.
        """
        size = framed_size(self._form, data)
        if len(data) < size:
            return Incomplete(size)
        judge = judged_short if size == SHORT.size else judged
        return Complete(judge(request, data[:size], self._form), size)

    def reply_size(self, request: Request) -> int:
        """18; 0 for a broadcast."""
        return 0 if request.address == BROADCAST else WRITE.size

    def largest_reply(self, request: Request) -> int:
        """18; 0 for a broadcast."""
        return self.reply_size(request)

    def address_of(self, request: Request) -> int:
        """The station spoken to; 31 is everybody."""
        return request.address

    # -- station side ------------------------------------------------------------------------------------------

    def encode_reply(self, reply: Reply) -> bytes:
        """The canonical frame of a reply. Raises ValueError for a field out of range or missing."""
        return build_reply(self._form, reply)

    def decode_request(self, data: bytes) -> Verdict:
        """``Complete(Heard, size)``. ``messages.short_reply`` tells what a station answers to the error raised."""
        return hear(self._form, data)


def _form(encoding: str, digits: str, nibble: bool) -> Form:
    if encoding == "ascii":
        return AsciiForm(TOLERANT if digits == "tolerant" else STRICT)
    if encoding == "hex":
        return MixedForm() if nibble else PackedForm()
    raise ValueError(f"encoding {encoding!r}: expected ascii or hex")
