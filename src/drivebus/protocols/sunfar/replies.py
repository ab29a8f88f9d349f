"""C320 replies to frames and back: what a station writes, and what a host believes of it against its request."""

from __future__ import annotations

from drivebus.errors import AddressError, AlphabetError, CodeError, EchoError
from drivebus.protocols.sunfar.frame import IDENTITY_LAYOUT, SHORT_LAYOUT, WRITE_LAYOUT, FieldFormat, check_head
from drivebus.protocols.sunfar.messages import (
    ReadIdentity,
    SunfarControl,
    SunfarReply,
    SunfarRequest,
    SunfarWriteParameter,
)
from drivebus.protocols.sunfar.requests import check_range, group_and_item
from drivebus.protocols.sunfar.tables import (
    BROADCAST,
    CLASS_OFFSET,
    RESPONSE_BY_CODE,
    STATE_BY_CODE,
    SunfarResponse,
    SunfarState,
)

_UNKNOWN_DIGITS = "--"
"""Digits 7-8 of a class-0 reply in a fault [OPEN]: not believed."""


def build_reply(form: FieldFormat, reply: SunfarReply) -> bytes:
    """The frame of a reply: short for response 6, 7, 8; class-0 digits where ``info`` is set; else item and data."""
    check_range("address", reply.address, BROADCAST - 1)
    if reply.response.is_short:
        return form.build(SHORT_LAYOUT, reply.address, reply.response, 0)
    if reply.state is None or reply.group is None:
        raise ValueError("a full reply has a state and a group")
    check_range("group", reply.group, 0x0F)
    head = (reply.address, reply.response, reply.state, reply.group)
    if reply.info is not None and _UNKNOWN_DIGITS not in reply.info:
        return form.build(IDENTITY_LAYOUT, *head, *_split_info(reply.info))
    item = reply.fault_code if reply.state is SunfarState.FAULT else reply.item
    data = int(reply.info[2:], 16) if reply.info is not None else reply.data
    if item is None or data is None:
        raise ValueError("a full reply has data and an item, or in a fault its code")
    check_range("item", item, 0xFF)
    check_range("data", data, 0xFFFF)
    return form.build(WRITE_LAYOUT, *head, item, data)


def _split_info(info: str) -> tuple[int, int, int]:
    if len(info) != 6 or not set(info) <= set("0123456789ABCDEF"):
        raise ValueError(f"info {info!r}: expected six digits")
    return int(info[0], 16), int(info[1], 16), int(info[2:], 16)


def expected_reply_size(form: FieldFormat, data: bytes) -> int:
    """Bytes of the reply that begins at offset 0: at least 11, and exact once its response code is there (T06)."""
    check_head(form, data)
    if len(data) <= CLASS_OFFSET:
        return SHORT_LAYOUT.size
    code = form.digit(data[CLASS_OFFSET], CLASS_OFFSET)
    response = RESPONSE_BY_CODE.get(code)
    if response is None:
        raise CodeError("protocols.sifang.response", expected="0-4, 6-8", found=code)
    return SHORT_LAYOUT.size if response.is_short else WRITE_LAYOUT.size


def parse_short_reply(form: FieldFormat, frame: bytes) -> SunfarReply:
    """Response 6, 7 or 8: no state, its digits read 00."""
    address, response, zero = form.read(SHORT_LAYOUT, frame).values
    if zero:
        raise CodeError("protocols.sifang.short_state", expected=0, found=zero)
    return SunfarReply(address, RESPONSE_BY_CODE[response])


def parse_full_reply(form: FieldFormat, frame: bytes) -> SunfarReply:
    """A reply with item and data, not yet judged against a request."""
    fields = form.read(WRITE_LAYOUT, frame)
    address, response, state, group, item, data = fields.values
    known = _parse_state(state)
    if known is SunfarState.FAULT:  # T05
        return SunfarReply(
            address, RESPONSE_BY_CODE[response], known, group, None, data, item, None, fields.nibble_data
        )
    return SunfarReply(address, RESPONSE_BY_CODE[response], known, group, item, data, None, None, fields.nibble_data)


def parse_identity_reply(form: FieldFormat, frame: bytes) -> SunfarReply:
    """A reply to class 0. In a fault its digits 7-8 may be the fault code or the information: absent [OPEN]."""
    try:
        fields = form.read(IDENTITY_LAYOUT, frame)
    except AlphabetError:
        return _parse_identity_in_fault(form, frame)
    address, response, state, group, seven, eight, rest = fields.values
    known = _parse_state(state)
    digits = _UNKNOWN_DIGITS if known is SunfarState.FAULT else f"{seven:X}{eight:X}"
    return SunfarReply(
        address, RESPONSE_BY_CODE[response], known, group, info=f"{digits}{rest:04X}", nibble_data=fields.nibble_data
    )


def _parse_identity_in_fault(form: FieldFormat, frame: bytes) -> SunfarReply:
    """A hex frame whose byte 8 is no digit: a fault code of 10H or more, or no frame."""
    fields = form.read(WRITE_LAYOUT, frame)
    address, response, state, group, item, rest = fields.values
    if _parse_state(state) is not SunfarState.FAULT:
        raise AlphabetError("protocols.sifang.digit", expected=0x0F, found=item, position=8)
    return SunfarReply(
        address, RESPONSE_BY_CODE[response], SunfarState.FAULT, group, info=f"{_UNKNOWN_DIGITS}{rest:04X}"
    )


def _parse_state(code: int) -> SunfarState:
    state = STATE_BY_CODE.get(code)
    if state is None:
        raise CodeError("protocols.sifang.state", expected="00-05, 11-16, 20, 21", found=code)
    return state


def validate_reply(request: SunfarRequest, frame: bytes, form: FieldFormat) -> SunfarReply:
    """The whole reply ``frame`` as far as it can be believed against its request."""
    if type(request) is ReadIdentity:
        reply = parse_identity_reply(form, frame)
        _check_address(request, reply)
        _check_echo("group", request.group, reply.group)
        return reply
    reply = parse_full_reply(form, frame)
    _check_address(request, reply)
    if type(request) is SunfarControl:
        return _validate_control_reply(request, reply)
    group, item = group_and_item(request)
    _check_echo("group", group, reply.group)
    _check_echo("item", item, reply.item)  # absent in a fault (T05)
    if type(request) is SunfarWriteParameter:
        _check_write_echo(request, reply)
    return reply


def validate_short_reply(request: SunfarRequest, frame: bytes, form: FieldFormat) -> SunfarReply:
    """A short reply echoes nothing but the address."""
    reply = parse_short_reply(form, frame)
    _check_address(request, reply)
    return reply


def _check_address(request: SunfarRequest, reply: SunfarReply) -> None:
    """Another station's whole and valid frame has its size in the error: the bus drops it and waits on (F02)."""
    if request.address == BROADCAST:  # 2.2: no answer is due
        raise AddressError("protocols.sifang.broadcast_answered", expected=BROADCAST - 1, found=reply.address)
    if reply.address != request.address:
        size = SHORT_LAYOUT.size if reply.response.is_short else WRITE_LAYOUT.size
        raise AddressError("protocols.address", expected=request.address, found=reply.address, size=size)


def _check_echo(name: str, expected: int, found: int | None) -> None:
    if found is not None and found != expected:
        raise EchoError(f"protocols.sifang.echo.{name}", expected=expected, found=found)


def _validate_control_reply(request: SunfarControl, reply: SunfarReply) -> SunfarReply:
    """Item and data are published only where they name the monitor that F6.12 is known to select."""
    _check_echo("group", 0, reply.group)
    if request.expected_item is not None and reply.item == request.expected_item:
        return reply
    return SunfarReply(reply.address, reply.response, reply.state, reply.group, fault_code=reply.fault_code)


def _check_write_echo(request: SunfarWriteParameter, reply: SunfarReply) -> None:
    """Done: the drive echoes the data. Refused: it says 0000 (note of section 3 (4)), and nothing else."""
    if reply.response is SunfarResponse.OK:
        if request.data not in (reply.data, reply.nibble_data):
            raise EchoError("protocols.sifang.echo.data", expected=request.data, found=reply.data)
    elif reply.data:
        echoed = reply.data == request.data and _is_own_echo(request, reply)
        key = "protocols.sifang.own_echo" if echoed else "protocols.sifang.refused_data"
        raise EchoError(key, expected=0, found=reply.data)


def _is_own_echo(request: SunfarWriteParameter, reply: SunfarReply) -> bool:
    """The bytes are our class-3 request: its class reads as response 3, its operation 00 as "not ready" (T21)."""
    return not request.save and reply.response is SunfarResponse.PASSWORD and reply.state is SunfarState.NOT_READY
