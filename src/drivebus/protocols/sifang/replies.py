"""C320 replies to frames and back: what a station writes, and what a host believes of it against its request."""

from __future__ import annotations

from drivebus.errors import AddressError, AlphabetError, CodeError, EchoError
from drivebus.protocols.sifang.frame import IDENTITY, SHORT, WRITE, Form, check_head
from drivebus.protocols.sifang.messages import Control, ReadIdentity, Reply, Request, WriteParameter
from drivebus.protocols.sifang.requests import in_range, read_key
from drivebus.protocols.sifang.tables import BROADCAST, KIND_AT, RESPONSES, STATES, Response, State

_ABSENT = "--"
"""Digits 7-8 of a class-0 reply in a fault [OPEN]: not believed."""


def build_reply(form: Form, reply: Reply) -> bytes:
    """The frame of a reply: short for response 6, 7, 8; class-0 digits where ``info`` is set; else item and data."""
    in_range("address", reply.address, BROADCAST - 1)
    if reply.response.short:
        return form.build(SHORT, reply.address, reply.response, 0)
    if reply.state is None or reply.group is None:
        raise ValueError("a full reply has a state and a group")
    in_range("group", reply.group, 0x0F)
    head = (reply.address, reply.response, reply.state, reply.group)
    if reply.info is not None and _ABSENT not in reply.info:
        return form.build(IDENTITY, *head, *_info_fields(reply.info))
    item = reply.fault_code if reply.state is State.FAULT else reply.item
    data = int(reply.info[2:], 16) if reply.info is not None else reply.data
    if item is None or data is None:
        raise ValueError("a full reply has data and an item, or in a fault its code")
    in_range("item", item, 0xFF)
    in_range("data", data, 0xFFFF)
    return form.build(WRITE, *head, item, data)


def _info_fields(info: str) -> tuple[int, int, int]:
    if len(info) != 6 or not set(info) <= set("0123456789ABCDEF"):
        raise ValueError(f"info {info!r}: expected six digits")
    return int(info[0], 16), int(info[1], 16), int(info[2:], 16)


def framed_size(form: Form, data: bytes) -> int:
    """Bytes of the reply that begins at offset 0: at least 11, and exact once its response code is there (T06)."""
    check_head(form, data)
    if len(data) <= KIND_AT:
        return SHORT.size
    code = form.digit(data[KIND_AT], KIND_AT)
    response = RESPONSES.get(code)
    if response is None:
        raise CodeError("protocols.sifang.response", expected="0-4, 6-8", found=code)
    return SHORT.size if response.short else WRITE.size


def read_short(form: Form, frame: bytes) -> Reply:
    """Response 6, 7 or 8: no state, its digits read 00."""
    address, response, zero = form.read(SHORT, frame).values
    if zero:
        raise CodeError("protocols.sifang.short_state", expected=0, found=zero)
    return Reply(address, RESPONSES[response])


def read_full(form: Form, frame: bytes) -> Reply:
    """A reply with item and data, not yet judged against a request."""
    fields = form.read(WRITE, frame)
    address, response, state, group, item, data = fields.values
    known = _state(state)
    if known is State.FAULT:  # T05
        return Reply(address, RESPONSES[response], known, group, None, data, item, None, fields.other_data)
    return Reply(address, RESPONSES[response], known, group, item, data, None, None, fields.other_data)


def read_identity(form: Form, frame: bytes) -> Reply:
    """A reply to class 0. In a fault its digits 7-8 may be the fault code or the information: absent [OPEN]."""
    try:
        fields = form.read(IDENTITY, frame)
    except AlphabetError:
        return _identity_in_fault(form, frame)
    address, response, state, group, seven, eight, rest = fields.values
    known = _state(state)
    digits = _ABSENT if known is State.FAULT else f"{seven:X}{eight:X}"
    return Reply(address, RESPONSES[response], known, group, info=f"{digits}{rest:04X}", other_data=fields.other_data)


def _identity_in_fault(form: Form, frame: bytes) -> Reply:
    """A hex frame whose byte 8 is no digit: a fault code of 10H or more, or no frame."""
    fields = form.read(WRITE, frame)
    address, response, state, group, item, rest = fields.values
    if _state(state) is not State.FAULT:
        raise AlphabetError("protocols.sifang.digit", expected=0x0F, found=item, position=8)
    return Reply(address, RESPONSES[response], State.FAULT, group, info=f"{_ABSENT}{rest:04X}")


def _state(code: int) -> State:
    state = STATES.get(code)
    if state is None:
        raise CodeError("protocols.sifang.state", expected="00-05, 11-16, 20, 21", found=code)
    return state


def judged(request: Request, frame: bytes, form: Form) -> Reply:
    """The whole reply ``frame`` as far as it can be believed against its request."""
    if type(request) is ReadIdentity:
        reply = read_identity(form, frame)
        _check_address(request, reply)
        _check_echo("group", request.group, reply.group)
        return reply
    reply = read_full(form, frame)
    _check_address(request, reply)
    if type(request) is Control:
        return _control_reply(request, reply)
    group, item = read_key(request)
    _check_echo("group", group, reply.group)
    _check_echo("item", item, reply.item)  # absent in a fault (T05)
    if type(request) is WriteParameter:
        _check_written(request, reply)
    return reply


def judged_short(request: Request, frame: bytes, form: Form) -> Reply:
    """A short reply echoes nothing but the address."""
    reply = read_short(form, frame)
    _check_address(request, reply)
    return reply


def _check_address(request: Request, reply: Reply) -> None:
    """Another station's whole and valid frame has its size in the error: the bus drops it and waits on (F02)."""
    if request.address == BROADCAST:  # 2.2: no answer is due
        raise AddressError("protocols.sifang.broadcast_answered", expected=BROADCAST - 1, found=reply.address)
    if reply.address != request.address:
        size = SHORT.size if reply.response.short else WRITE.size
        raise AddressError("protocols.address", expected=request.address, found=reply.address, size=size)


def _check_echo(name: str, expected: int, found: int | None) -> None:
    if found is not None and found != expected:
        raise EchoError(f"protocols.sifang.echo.{name}", expected=expected, found=found)


def _control_reply(request: Control, reply: Reply) -> Reply:
    """Item and data are published only where they name the monitor that F6.12 is known to select."""
    _check_echo("group", 0, reply.group)
    if request.expected_item is not None and reply.item == request.expected_item:
        return reply
    return Reply(reply.address, reply.response, reply.state, reply.group, fault_code=reply.fault_code)


def _check_written(request: WriteParameter, reply: Reply) -> None:
    """Done: the drive echoes the data. Refused: it says 0000 (note of section 3 (4)), and nothing else."""
    if reply.response is Response.OK:
        if request.data not in (reply.data, reply.other_data):
            raise EchoError("protocols.sifang.echo.data", expected=request.data, found=reply.data)
    elif reply.data:
        echoed = reply.data == request.data and _looks_sent(request, reply)
        key = "protocols.sifang.own_echo" if echoed else "protocols.sifang.refused_data"
        raise EchoError(key, expected=0, found=reply.data)


def _looks_sent(request: WriteParameter, reply: Reply) -> bool:
    """The bytes are our class-3 request: its class reads as response 3, its operation 00 as "not ready" (T21)."""
    return not request.save and reply.response is Response.PASSWORD and reply.state is State.NOT_READY
