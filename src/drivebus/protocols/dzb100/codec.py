"""Codec of the DZB100 protocol, for a master and for a station, and the effect of a request frame.

    0 head C P R Q · 1 S = 03H · 2 A (request) or B (reply) · 3-4 address · 5-6 command, parameter or item · 7-10 data

A frame has 11 bytes and no end mark; address and index are decimal ASCII digits, data hexadecimal ones. No check value
detects a flipped bit, so head, S, B, address, index, digits and the echoed data must all match.
"""

from __future__ import annotations

from drivebus.errors import AddressError, ChecksumError, CodeError, EchoError, HeaderError
from drivebus.protocols.checksum import decimal_digits, decimal_value, hex_digits, hex_value
from drivebus.protocols.codec import Complete, DecodeResult, Effect, Incomplete, canonical_request, check_range
from drivebus.protocols.dzb100.messages import (
    BROADCAST,
    COMMAND_BY_CODE,
    LAST_ADDRESS,
    LAST_PARAMETER,
    LAST_QUERY_ITEM,
    Dzb100Command,
    Dzb100Control,
    Dzb100Query,
    Dzb100ReadParameter,
    Dzb100Reply,
    Dzb100Request,
    Dzb100WriteParameter,
)

FRAME_SIZE = 11
CONSTANT_S = 0x03
"""The manual's "checksum" (和校验): the same byte in every printed frame, so it detects nothing."""
MARK_ONE, MARK_ALL = 0x01, 0x02  # byte A of a request: for one station, broadcast
ACK_DONE, ACK_REFUSED = 0x06, 0x07  # byte B of a reply: accepted, not accepted
HEADS = b"CPRQ"
STATE_DIGITS = {byte: byte & 0x0F for byte in (*range(9), *b"012345678")}
"""Byte B of a C reply that is a state digit, binary or ASCII; the manual leaves open which."""


class Dzb100Codec:
    """Frames of the DZB100 protocol; see the module for their layout."""

    family = "dzb100"
    encoding = "ascii"
    broadcast_address = BROADCAST

    def encode_request(self, request: Dzb100Request) -> bytes:
        """Return the 11 bytes of a request. A stop always carries 0000: a flipped bit then gives a run at 0 Hz.

        Raises ValueError for a field out of range, for address 0 without ``broadcast`` or the reverse, and for a
        reset with a frequency.
        """
        is_broadcast = _is_broadcast(request)
        low, high = (BROADCAST, BROADCAST) if is_broadcast else (1, LAST_ADDRESS)
        check_range("address", request.address, low, high)
        return _frame(
            request.head, MARK_ALL if is_broadcast else MARK_ONE, request.address, _index(request), _data(request)
        )

    def encode_reply(self, reply: Dzb100Reply) -> bytes:
        """Return the 11 bytes of a reply, a state digit as ASCII. Raises ValueError for a field out of range."""
        if reply.head not in ("C", "P", "R", "Q"):
            raise ValueError(f"head {reply.head!r}: expected C, P, R or Q")
        return _frame(ord(reply.head), _acknowledge(reply), reply.address, reply.index, reply.data)

    def decode_request(self, data: bytes) -> DecodeResult:
        """Decode a request as a station; an index that no drive has too, which the station rejects with 07.

        Raises ProtocolError for any other frame than a request.
        """
        if incomplete := check_head(data):
            return incomplete
        address, index, word = parse_digits(data)
        if address > LAST_ADDRESS:
            raise AddressError("protocols.dzb100.address_range", expected=LAST_ADDRESS, found=address)
        return Complete(_parse_request(data[0], data[2], address, index, word), FRAME_SIZE)

    def decode_reply(self, request: Dzb100Request, data: bytes) -> DecodeResult:
        """Decode the reply to ``request``; a rejection is a ``Dzb100Reply`` with ``accepted`` False.

        Raises ProtocolError for any other frame; AddressError has ``size`` for a foreign one.
        """
        if incomplete := check_head(data):
            return incomplete
        reply = parse_reply(data)
        if reply.address != request.address:
            raise AddressError("protocols.address", expected=request.address, found=reply.address, size=FRAME_SIZE)
        if data[0] != request.head:
            raise EchoError("protocols.dzb100.head", expected=chr(request.head), found=reply.head)
        if reply.index != request.index:
            raise EchoError("protocols.dzb100.index", expected=request.index, found=reply.index)
        if isinstance(request, Dzb100Control | Dzb100WriteParameter) and reply.accepted is not False:
            _check_data(_data(request), reply.data)
        return Complete(reply, FRAME_SIZE)

    def reply_size(self, request: Dzb100Request) -> int:
        """Return 11, or 0 for a broadcast."""
        return 0 if request.address == BROADCAST else FRAME_SIZE

    def largest_reply(self, request: Dzb100Request) -> int:
        """Return 11, or 0 for a broadcast."""
        return self.reply_size(request)

    def address_of(self, request: Dzb100Request) -> int:
        """Return the station address; 0 is the broadcast."""
        return request.address


_CODEC = Dzb100Codec()


def frame_effect(frame: bytes) -> Effect:
    """Return the effect of one whole request frame; every frame that is not canonical is MOTION.

    A stop is STOP only with data 0000: one flipped bit makes it a run command, which then has 0 Hz.
    """
    request: Dzb100Request | None = canonical_request(_CODEC, frame)
    if request is None:
        return Effect.MOTION
    if isinstance(request, Dzb100ReadParameter | Dzb100Query):
        return Effect.NONE
    if isinstance(request, Dzb100WriteParameter) or request.command is Dzb100Command.RESET:
        return Effect.SETTING
    return Effect.STOP if request.command.is_stop else Effect.MOTION


# -- bytes ---------------------------------------------------------------------------------------------------------


def _frame(head: int, mark: int, address: int, index: int, data: int) -> bytes:
    fields = decimal_digits(address, 2) + decimal_digits(index, 2) + hex_digits(data, 4)
    return bytes((head, CONSTANT_S, mark)) + fields


def check_head(data: bytes) -> Incomplete | None:
    """Return None for 11 or more bytes, Incomplete for fewer. Raises HeaderError or ChecksumError for head and S."""
    if data and data[0] not in HEADS:
        raise HeaderError("protocols.dzb100.header", expected=("C", "P", "R", "Q"), found=data[0])
    if len(data) > 1 and data[1] != CONSTANT_S:
        raise ChecksumError("protocols.dzb100.checksum", expected=CONSTANT_S, found=data[1])
    return Incomplete(FRAME_SIZE) if len(data) < FRAME_SIZE else None


def parse_digits(data: bytes) -> tuple[int, int, int]:
    """Return address, index and data word. Raises AlphabetError."""
    return decimal_value(data[3:5], 3), decimal_value(data[5:7], 5), hex_value(data[7:11], start=7)


# -- requests ------------------------------------------------------------------------------------------------------


def _is_broadcast(request: Dzb100Request) -> bool:
    return isinstance(request, Dzb100Control) and request.broadcast


def _index(request: Dzb100Request) -> int:
    if isinstance(request, Dzb100Control):
        if request.command not in COMMAND_BY_CODE:
            raise ValueError(f"command {request.command}: expected 0 to {int(Dzb100Command.RESET)}")
        if request.command == Dzb100Command.RESET and request.data:
            raise ValueError(f"a reset takes no frequency, {request.data} given")
        return request.index
    limit = LAST_QUERY_ITEM if isinstance(request, Dzb100Query) else LAST_PARAMETER
    check_range("item" if isinstance(request, Dzb100Query) else "parameter", request.index, 0, limit)
    return request.index


def _data(request: Dzb100Request) -> int:
    stop = isinstance(request, Dzb100Control) and request.command in (Dzb100Command.STOP, Dzb100Command.STOP_2)
    return 0 if stop else request.data


def _parse_request(head: int, mark: int, address: int, index: int, word: int) -> Dzb100Request:
    if mark != MARK_ONE and not (mark == MARK_ALL and head == Dzb100Control.head):
        raise CodeError("protocols.dzb100.mark", expected=("01", "02"), found=mark)
    if head == Dzb100Control.head:
        command = COMMAND_BY_CODE.get(index % 10)  # the high digit is not defined
        if command is None:
            raise CodeError("protocols.dzb100.command", expected="0-8", found=index % 10)
        return Dzb100Control(address, command, word, broadcast=mark == MARK_ALL)
    if head == Dzb100WriteParameter.head:
        return Dzb100WriteParameter(address, index, word)
    return Dzb100ReadParameter(address, index) if head == Dzb100ReadParameter.head else Dzb100Query(address, index)


# -- replies -------------------------------------------------------------------------------------------------------


def parse_reply(data: bytes) -> Dzb100Reply:
    """Parse a whole reply without its request. Raises AlphabetError, AddressError or CodeError."""
    address, index, word = parse_digits(data)
    if not 1 <= address <= LAST_ADDRESS:
        raise AddressError("protocols.dzb100.address_range", expected=LAST_ADDRESS, found=address)
    mark = data[2]
    if mark in (ACK_DONE, ACK_REFUSED):
        return Dzb100Reply(head=chr(data[0]), address=address, index=index, data=word, accepted=mark == ACK_DONE)
    digit = STATE_DIGITS.get(mark)
    if digit is None or data[0] != Dzb100Control.head:
        raise CodeError("protocols.dzb100.acknowledge", expected=("06", "07"), found=mark)
    return Dzb100Reply(head="C", address=address, index=index, data=word, accepted=None, digit=digit)


def _acknowledge(reply: Dzb100Reply) -> int:
    if reply.accepted is not None:
        return ACK_DONE if reply.accepted else ACK_REFUSED
    if reply.head != "C" or reply.digit is None or not 0 <= reply.digit <= Dzb100Command.RESET:
        raise ValueError(f"digit {reply.digit} of head {reply.head}: only a C reply has one, 0 to 8")
    return ord("0") + reply.digit


def _check_data(expected: int, found: int) -> None:
    if found != expected:
        raise EchoError("protocols.dzb100.data", expected=expected, found=found)
