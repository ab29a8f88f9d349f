"""Codec of the Sunfar protocol: messages to frames and back, for a master and for a station.

The length comes from the class or the response code, because the end mark is an ordinary byte of hex frames. Section
numbers are those of the C320 manual.
"""

from __future__ import annotations

from typing import Literal

from drivebus.errors import AddressError, AlphabetError, ChecksumError, CodeError, EchoError, ProtocolError
from drivebus.protocols.checksum import STRICT_HEX_DIGITS, TOLERANT_HEX_DIGITS
from drivebus.protocols.codec import Complete, DecodeResult, Effect, Incomplete, check_range
from drivebus.protocols.sunfar.frame import (
    ASCII_HEAD,
    CONTROL_LAYOUT,
    IDENTITY_LAYOUT,
    READ_LAYOUT,
    SHORT_LAYOUT,
    WRITE_LAYOUT,
    AsciiFormat,
    FieldFormat,
    FrameFields,
    FrameLayout,
    MixedFormat,
    PackedFormat,
    check_head,
)
from drivebus.protocols.sunfar.messages import (
    BROADCAST,
    CLASS_OFFSET,
    OPERATION_BY_CODE,
    RESPONSE_BY_CODE,
    STATE_BY_CODE,
    ReadIdentity,
    ReadMonitor,
    ReceivedRequest,
    SunfarControl,
    SunfarOperation,
    SunfarReadParameter,
    SunfarReply,
    SunfarRequest,
    SunfarResponse,
    SunfarState,
    SunfarWriteParameter,
    UnknownItemError,
)


class SunfarCodec:
    """Encoding of the Sunfar protocol. Its options affect decoding only: frames are written canonically.

    ``digits`` "tolerant" also reads 3AH-3FH and a-f as A-F; ``nibble`` also reads hex frames with one nibble a byte,
    and ``nibble_data`` then marks replies whose data are ambiguous.
    """

    family = "sunfar"
    broadcast_address = BROADCAST

    def __init__(
        self,
        encoding: Literal["ascii", "hex"] = "ascii",
        digits: Literal["strict", "tolerant"] = "strict",
        *,
        nibble: bool = False,
    ) -> None:
        self.encoding: str = encoding
        self.digits = digits
        self.nibble = nibble
        self._format = _field_format(encoding, digits, nibble=nibble)

    def encode_request(self, request: SunfarRequest) -> bytes:
        """Return the frame of a request.

        Only ``SunfarControl`` has an operation other than 00. Raises ValueError for a field out of range, a broadcast
        read, or data with an operation that has none.
        """
        build = self._format.build
        check_range("address", request.address, 0, BROADCAST)
        if type(request) is SunfarControl:
            return build(CONTROL_LAYOUT, request.address, 4, request.operation, _control_data(request))
        if type(request) is SunfarWriteParameter:
            check_range("group", request.group, 0, 0x0F)
            check_range("item", request.item, 0, 0xFF)
            check_range("data", request.data, 0, 0xFFFF)
            head = (request.address, request.frame_class, SunfarOperation.NONE)
            return build(WRITE_LAYOUT, *head, request.group, request.item, request.data)
        group, item = _group_and_item(request)
        if request.address == BROADCAST:
            raise ValueError(f"address {BROADCAST} is the broadcast address: no station answers a read")
        return build(READ_LAYOUT, request.address, request.frame_class, SunfarOperation.NONE, group, item)

    def decode_reply(self, request: SunfarRequest, data: bytes) -> DecodeResult:
        """Decode the reply to ``request``; a rejection is a ``SunfarReply`` with its response code.

        Raises ProtocolError where head, address, echoed fields, codes, digits, checksum or end mark are wrong;
        AddressError has ``size`` where another station's frame is whole and valid.
        """
        size = expected_reply_size(self._format, data)
        if len(data) < size:
            return Incomplete(size)
        validate = _validate_short_reply if size == SHORT_LAYOUT.size else _validate_reply
        return Complete(validate(request, data[:size], self._format), size)

    def reply_size(self, request: SunfarRequest) -> int:
        """Return 18, or 0 for a broadcast."""
        return 0 if request.address == BROADCAST else WRITE_LAYOUT.size

    def largest_reply(self, request: SunfarRequest) -> int:
        """Return 18, or 0 for a broadcast."""
        return self.reply_size(request)

    def address_of(self, request: SunfarRequest) -> int:
        """Return the station address; 31 is the broadcast."""
        return request.address

    def encode_reply(self, reply: SunfarReply) -> bytes:
        """Return the canonical frame of a reply: short for response 6, 7, 8; class-0 digits where ``info`` is set.

        Raises ValueError for a field out of range or missing.
        """
        build = self._format.build
        check_range("address", reply.address, 0, BROADCAST - 1)
        if reply.response.is_short:
            return build(SHORT_LAYOUT, reply.address, reply.response, 0)
        if reply.state is None or reply.group is None:
            raise ValueError("a full reply has a state and a group")
        check_range("group", reply.group, 0, 0x0F)
        head = (reply.address, reply.response, reply.state, reply.group)
        if reply.info is not None and _UNKNOWN_DIGITS not in reply.info:
            return build(IDENTITY_LAYOUT, *head, *_split_info(reply.info))
        item = reply.fault_code if reply.state is SunfarState.FAULT else reply.item
        data = int(reply.info[2:], 16) if reply.info is not None else reply.data
        if item is None or data is None:
            raise ValueError("a full reply has data and an item, or in a fault its code")
        check_range("item", item, 0, 0xFF)
        check_range("data", data, 0, 0xFFFF)
        return build(WRITE_LAYOUT, *head, item, data)

    def decode_request(self, data: bytes) -> DecodeResult:
        """Decode a request as a station; ``messages.error_reply`` gives the reply to the error raised."""
        return decode_request(self._format, data)


def _field_format(encoding: str, digits: str, *, nibble: bool) -> FieldFormat:
    if encoding == "ascii":
        return AsciiFormat(TOLERANT_HEX_DIGITS if digits == "tolerant" else STRICT_HEX_DIGITS)
    if encoding == "hex":
        return MixedFormat() if nibble else PackedFormat()
    raise ValueError(f"encoding {encoding!r}: expected ascii or hex")


STOP_OPERATIONS = frozenset({SunfarOperation.STOP, SunfarOperation.JOG_STOP, SunfarOperation.EMERGENCY_STOP})
REQUEST_LAYOUTS = {0: READ_LAYOUT, 1: READ_LAYOUT, 2: READ_LAYOUT, 3: WRITE_LAYOUT, 4: CONTROL_LAYOUT, 5: WRITE_LAYOUT}


def _group_and_item(request: SunfarRequest) -> tuple[int, int]:
    group = 0 if type(request) is ReadMonitor else request.group  # type: ignore[union-attr]
    item = 0 if type(request) is ReadIdentity else request.item  # type: ignore[union-attr]
    check_range("group", group, 0, 0x0F)
    check_range("item", item, 0, 0xFF)
    return group, item


def _control_data(request: SunfarControl) -> int:
    """Return the data word: only an operation that sets a frequency has one. A stop sends 0000 whatever it is given."""
    if request.operation in STOP_OPERATIONS:
        return 0
    if request.operation not in OPERATION_BY_CODE:
        raise ValueError(f"operation {request.operation} is not one of the manual's (2.4.4)")
    check_range("data", request.data, 0, 0xFFFF)
    if request.data and not SunfarOperation(request.operation).sets_frequency:
        raise ValueError(f"operation {request.operation:02X}H takes no data, {request.data} given")
    return request.data


def decode_request(fmt: FieldFormat, data: bytes) -> DecodeResult:
    """Decode the request that begins at offset 0. Raises ProtocolError."""
    check_head(fmt, data)
    if len(data) <= CLASS_OFFSET:
        return Incomplete(READ_LAYOUT.size)
    layout = REQUEST_LAYOUTS.get(fmt.digit(data[CLASS_OFFSET], CLASS_OFFSET))
    if layout is None:
        return _reject_unknown_class(fmt, data)
    if len(data) < layout.size:
        return Incomplete(layout.size)
    return Complete(_received_request(_read_fields(fmt, layout, data[: layout.size])), layout.size)


def _read_fields(fmt: FieldFormat, layout: FrameLayout, frame: bytes) -> FrameFields:
    """Read the fields; AlphabetError carries the address of the station that answers it with response 7."""
    try:
        return fmt.read(layout, frame)
    except AlphabetError as error:
        if isinstance(fmt, AsciiFormat):
            error.params["address"] = _parse_address(fmt, frame)
        raise


def _parse_address(fmt: FieldFormat, frame: bytes) -> int | None:
    try:
        return fmt.digit(frame[1], 1) << 4 | fmt.digit(frame[2], 2)
    except AlphabetError:
        return None


def _reject_unknown_class(fmt: FieldFormat, data: bytes) -> DecodeResult:
    """Reject classes 6-F, which have no length: the frame ends where end mark and checksum fit a known length."""
    for layout in (READ_LAYOUT, CONTROL_LAYOUT, WRITE_LAYOUT):
        if len(data) < layout.size:
            return Incomplete(layout.size)
        try:
            address, frame_class = fmt.read(layout, data[: layout.size]).values[:2]
        except ProtocolError:
            continue
        raise CodeError("protocols.sunfar.class", expected="0-5", found=frame_class, address=address)
    raise ChecksumError("protocols.sunfar.no_length", expected="0-5", found=data[CLASS_OFFSET])


def _received_request(fields: FrameFields) -> ReceivedRequest:
    address, frame_class, code, *rest = fields.values
    if address > BROADCAST:
        raise AddressError("protocols.sunfar.address_range", expected=BROADCAST, found=address)
    operation = OPERATION_BY_CODE.get(code)
    if operation is None:
        raise CodeError(
            "protocols.sunfar.operation", expected=("00-06", "10-16", "20", "21"), found=code, address=address
        )
    return ReceivedRequest(_parse_request(address, frame_class, operation, rest), operation, fields.nibble_data)


def _parse_request(address: int, frame_class: int, operation: SunfarOperation, rest: list[int]) -> SunfarRequest:
    if frame_class == 4:
        return SunfarControl(address, operation, rest[0])
    group, item = rest[:2]
    if frame_class == 1:
        _check_unused_field("group", group, address)
        return ReadMonitor(address, item)
    if frame_class == 0:
        _check_unused_field("item", item, address)
        return ReadIdentity(address, group)
    if frame_class == 2:
        return SunfarReadParameter(address, group, item)
    return SunfarWriteParameter(address, group, item, rest[2], save=frame_class == 5)


def _check_unused_field(name: str, value: int, address: int) -> None:
    if value:
        raise UnknownItemError(f"protocols.sunfar.unused.{name}", expected=0, found=value, address=address)


_UNKNOWN_DIGITS = "--"
"""Digits 7-8 of a class-0 reply in a fault, whose meaning the manual leaves open."""


def _split_info(info: str) -> tuple[int, int, int]:
    if len(info) != 6 or not set(info) <= set("0123456789ABCDEF"):
        raise ValueError(f"info {info!r}: expected six digits")
    return int(info[0], 16), int(info[1], 16), int(info[2:], 16)


def expected_reply_size(fmt: FieldFormat, data: bytes) -> int:
    """Return the size of the reply at offset 0: at least 11 bytes, exact once its response code is there.

    Raises HeaderError, AlphabetError or CodeError where none begins there.
    """
    check_head(fmt, data)
    if len(data) <= CLASS_OFFSET:
        return SHORT_LAYOUT.size
    code = fmt.digit(data[CLASS_OFFSET], CLASS_OFFSET)
    response = RESPONSE_BY_CODE.get(code)
    if response is None:
        raise CodeError("protocols.sunfar.response", expected=("0-4", "6-8"), found=code)
    return SHORT_LAYOUT.size if response.is_short else WRITE_LAYOUT.size


def parse_short_reply(fmt: FieldFormat, frame: bytes) -> SunfarReply:
    """Parse response 6, 7 or 8; the state digits must read 00. Raises ProtocolError."""
    address, response, zero = fmt.read(SHORT_LAYOUT, frame).values
    if zero:
        raise CodeError("protocols.sunfar.short_state", expected=0, found=zero)
    return SunfarReply(address=address, response=RESPONSE_BY_CODE[response])


def parse_full_reply(fmt: FieldFormat, frame: bytes) -> SunfarReply:
    """Parse a reply with item and data, without its request. Raises ProtocolError."""
    fields = fmt.read(WRITE_LAYOUT, frame)
    address, response, state, group, item, data = fields.values
    known = _parse_state(state)
    in_fault = known is SunfarState.FAULT  # a drive in fault sends its fault code in the place of the item
    return SunfarReply(
        address=address,
        response=RESPONSE_BY_CODE[response],
        state=known,
        group=group,
        item=None if in_fault else item,
        data=data,
        fault_code=item if in_fault else None,
        info=None,
        nibble_data=fields.nibble_data,
    )


def _parse_identity_reply(fmt: FieldFormat, frame: bytes) -> SunfarReply:
    """Parse a reply to class 0. In a fault digits 7-8 may be the fault code, which the manual leaves open."""
    try:
        fields = fmt.read(IDENTITY_LAYOUT, frame)
    except AlphabetError:
        return _parse_identity_in_fault(fmt, frame)
    address, response, state, group, seven, eight, rest = fields.values
    known = _parse_state(state)
    digits = _UNKNOWN_DIGITS if known is SunfarState.FAULT else f"{seven:X}{eight:X}"
    return SunfarReply(
        address=address,
        response=RESPONSE_BY_CODE[response],
        state=known,
        group=group,
        info=f"{digits}{rest:04X}",
        nibble_data=fields.nibble_data,
    )


def _parse_identity_in_fault(fmt: FieldFormat, frame: bytes) -> SunfarReply:
    """Parse a hex frame whose byte 8 is no digit: only a fault code of 10H or more is one."""
    fields = fmt.read(WRITE_LAYOUT, frame)
    address, response, state, group, item, rest = fields.values
    if _parse_state(state) is not SunfarState.FAULT:
        raise AlphabetError("protocols.sunfar.digit", expected=0x0F, found=item, position=8)
    return SunfarReply(
        address=address,
        response=RESPONSE_BY_CODE[response],
        state=SunfarState.FAULT,
        group=group,
        info=f"{_UNKNOWN_DIGITS}{rest:04X}",
    )


def _parse_state(code: int) -> SunfarState:
    state = STATE_BY_CODE.get(code)
    if state is None:
        raise CodeError("protocols.sunfar.state", expected=("00-05", "11-16", "20", "21"), found=code)
    return state


def _validate_reply(request: SunfarRequest, frame: bytes, fmt: FieldFormat) -> SunfarReply:
    """Return the reply in ``frame`` after checking every field that the request determines."""
    if type(request) is ReadIdentity:
        reply = _parse_identity_reply(fmt, frame)
        _check_address(request, reply)
        _check_echo("group", request.group, reply.group)
        return reply
    reply = parse_full_reply(fmt, frame)
    _check_address(request, reply)
    if type(request) is SunfarControl:
        return _validate_control_reply(request, reply)
    group, item = _group_and_item(request)
    _check_echo("group", group, reply.group)
    _check_echo("item", item, reply.item)  # None in a fault
    if type(request) is SunfarWriteParameter:
        _check_write_echo(request, reply)
    return reply


def _validate_short_reply(request: SunfarRequest, frame: bytes, fmt: FieldFormat) -> SunfarReply:
    """Return a short reply; it echoes only the address."""
    reply = parse_short_reply(fmt, frame)
    _check_address(request, reply)
    return reply


def _check_address(request: SunfarRequest, reply: SunfarReply) -> None:
    """Raise AddressError for another station; with the frame's size, so that the bus skips it and waits on."""
    if request.address == BROADCAST:  # no reply is due (2.2)
        raise AddressError("protocols.sunfar.broadcast_answered", expected=BROADCAST - 1, found=reply.address)
    if reply.address != request.address:
        size = SHORT_LAYOUT.size if reply.response.is_short else WRITE_LAYOUT.size
        raise AddressError("protocols.address", expected=request.address, found=reply.address, size=size)


def _check_echo(name: str, expected: int, found: int | None) -> None:
    if found is not None and found != expected:
        raise EchoError(f"protocols.sunfar.echo.{name}", expected=expected, found=found)


def _validate_control_reply(request: SunfarControl, reply: SunfarReply) -> SunfarReply:
    """Keep item and data only where they name the monitor that F6.12 is known to select."""
    _check_echo("group", 0, reply.group)
    if request.expected_item is not None and reply.item == request.expected_item:
        return reply
    return SunfarReply(
        address=reply.address,
        response=reply.response,
        state=reply.state,
        group=reply.group,
        fault_code=reply.fault_code,
    )


def _check_write_echo(request: SunfarWriteParameter, reply: SunfarReply) -> None:
    """Check the data: a drive echoes them when done and sends 0000 when it rejects (section 3 (4), note).

    A rejection with response 3, state 00 and data 0000 has the bytes of the echo of a class-3 write of 0: it counts as
    rejected, so that an echo never passes for success.
    """
    if reply.response is SunfarResponse.OK:
        if request.data not in (reply.data, reply.nibble_data):
            raise EchoError("protocols.sunfar.echo.data", expected=request.data, found=reply.data)
    elif reply.data:
        echoed = reply.data == request.data and _is_own_echo(request, reply)
        key = "protocols.sunfar.own_echo" if echoed else "protocols.sunfar.refused_data"
        raise EchoError(key, expected=0, found=reply.data)


def _is_own_echo(request: SunfarWriteParameter, reply: SunfarReply) -> bool:
    """Return whether the bytes are the request itself: class 3 reads as response 3, operation 00 as "not ready"."""
    return not request.save and reply.response is SunfarResponse.PASSWORD and reply.state is SunfarState.NOT_READY


OPERATIONS_WITHOUT_MOTION = frozenset(
    {
        SunfarOperation.NONE,
        SunfarOperation.STOP,
        SunfarOperation.JOG_STOP,
        SunfarOperation.STOP_AT,
        SunfarOperation.JOG_STOP_AT,
        SunfarOperation.EMERGENCY_STOP,
        SunfarOperation.SET_FREQUENCY,
        SunfarOperation.RESET_FAULT,
    }
)
"""Every other operation moves the motor."""
_ASCII_FORMAT = AsciiFormat(STRICT_HEX_DIGITS)
_PACKED_FORMAT = PackedFormat()


def frame_effect(frame: bytes) -> Effect:
    """Return the effect of one whole request frame; the operation acts in every class.

    STOP only where the frame can do nothing but stop: a stop that also sets a frequency or writes a parameter is a
    SETTING. A frame that is not canonical, not whole, or followed by other bytes is MOTION.
    """
    try:
        result = decode_request(_ASCII_FORMAT if frame[:1] == bytes((ASCII_HEAD,)) else _PACKED_FORMAT, frame)
    except ProtocolError:
        return Effect.MOTION
    if not isinstance(result, Complete) or result.size != len(frame):
        return Effect.MOTION
    received: ReceivedRequest = result.message
    request, operation = received.request, received.operation
    if operation not in OPERATIONS_WITHOUT_MOTION:
        return Effect.MOTION
    if operation is SunfarOperation.NONE and not isinstance(request, SunfarWriteParameter | SunfarControl):
        return Effect.NONE
    only_stops = isinstance(request, SunfarControl) and operation in STOP_OPERATIONS and request.data == 0
    return Effect.STOP if only_stops else Effect.SETTING
