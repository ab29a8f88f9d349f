"""C320 requests to frames and back: what a host writes and a station hears."""

from __future__ import annotations

from drivebus.errors import AddressError, AlphabetError, ChecksumError, CodeError, ProtocolError
from drivebus.message import Complete, Incomplete, Verdict
from drivebus.protocols.sifang.frame import CONTROL, READ, WRITE, AsciiForm, Fields, Form, Layout, check_head
from drivebus.protocols.sifang.messages import (
    Control,
    Heard,
    ItemError,
    ReadIdentity,
    ReadMonitor,
    ReadParameter,
    Request,
    WriteParameter,
)
from drivebus.protocols.sifang.tables import BROADCAST, KIND_AT, OPERATIONS, Operation

_STOPS = (Operation.STOP, Operation.JOG_STOP, Operation.EMERGENCY_STOP)
REQUEST_LAYOUTS = {0: READ, 1: READ, 2: READ, 3: WRITE, 4: CONTROL, 5: WRITE}


def build_request(form: Form, request: Request) -> bytes:
    """The frame of a request. Nothing but ``Control`` can put an operation into it (T01, T07)."""
    in_range("address", request.address, BROADCAST)
    if type(request) is Control:
        return form.build(CONTROL, request.address, 4, request.operation, _control_data(request))
    if type(request) is WriteParameter:
        in_range("group", request.group, 0x0F)
        in_range("item", request.item, 0xFF)
        in_range("data", request.data, 0xFFFF)
        head = (request.address, request.kind, Operation.NONE)
        return form.build(WRITE, *head, request.group, request.item, request.data)
    group, item = read_key(request)
    if request.address == BROADCAST:
        raise ValueError(f"address {BROADCAST} is everybody: nobody answers a read")
    return form.build(READ, request.address, request.kind, Operation.NONE, group, item)


def read_key(request: Request) -> tuple[int, int]:
    group = 0 if type(request) is ReadMonitor else request.group  # type: ignore[union-attr]
    item = 0 if type(request) is ReadIdentity else request.item  # type: ignore[union-attr]
    in_range("group", group, 0x0F)
    in_range("item", item, 0xFF)
    return group, item


def _control_data(request: Control) -> int:
    """Only an operation that sets a frequency has data. A stop is never refused for having some: it sends 0000."""
    if request.operation in _STOPS:
        return 0
    if request.operation not in OPERATIONS:
        raise ValueError(f"operation {request.operation} is not one of the manual's (2.4.4)")
    in_range("data", request.data, 0xFFFF)
    if request.data and not Operation(request.operation).sets_frequency:
        raise ValueError(f"operation {request.operation:02X}H takes no data, {request.data} given")
    return request.data


def in_range(name: str, value: int, limit: int) -> None:
    if not 0 <= value <= limit:
        raise ValueError(f"{name} {value}: expected 0 to {limit}")


def hear(form: Form, data: bytes) -> Verdict:
    """The request that begins at offset 0, whoever sent it."""
    check_head(form, data)
    if len(data) <= KIND_AT:
        return Incomplete(READ.size)
    layout = REQUEST_LAYOUTS.get(form.digit(data[KIND_AT], KIND_AT))
    if layout is None:
        return _unknown_class(form, data)
    if len(data) < layout.size:
        return Incomplete(layout.size)
    return Complete(_heard(_read(form, layout, data[: layout.size])), layout.size)


def _read(form: Form, layout: Layout, frame: bytes) -> Fields:
    """The fields; a bad ASCII digit is told with the address of the station that is to complain (code 7)."""
    try:
        return form.read(layout, frame)
    except AlphabetError as error:
        if isinstance(form, AsciiForm):
            error.params["address"] = _address_digits(form, frame)
        raise


def _address_digits(form: Form, frame: bytes) -> int | None:
    try:
        return form.digit(frame[1], 1) << 4 | form.digit(frame[2], 2)
    except AlphabetError:
        return None


def _unknown_class(form: Form, data: bytes) -> Verdict:
    """Classes 6-F have no length: the frame is over where end mark and sum fit one of the three lengths."""
    for layout in (READ, CONTROL, WRITE):
        if len(data) < layout.size:
            return Incomplete(layout.size)
        try:
            address, kind = form.read(layout, data[: layout.size]).values[:2]
        except ProtocolError:
            continue
        raise CodeError("protocols.sifang.class", expected="0-5", found=kind, address=address)
    raise ChecksumError("protocols.sifang.no_length", expected="0-5", found=data[KIND_AT])


def _heard(fields: Fields) -> Heard:
    address, kind, code, *rest = fields.values
    if address > BROADCAST:
        raise AddressError("protocols.sifang.address_range", expected=BROADCAST, found=address)
    operation = OPERATIONS.get(code)
    if operation is None:
        raise CodeError("protocols.sifang.operation", expected="00-06, 10-16, 20, 21", found=code, address=address)
    return Heard(_request(address, kind, operation, rest), operation, fields.other_data)


def _request(address: int, kind: int, operation: Operation, rest: list[int]) -> Request:
    if kind == 4:
        return Control(address, operation, rest[0])
    group, item = rest[:2]
    if kind == 1:
        _check_unused("group", group, address)
        return ReadMonitor(address, item)
    if kind == 0:
        _check_unused("item", item, address)
        return ReadIdentity(address, group)
    if kind == 2:
        return ReadParameter(address, group, item)
    return WriteParameter(address, group, item, rest[2], save=kind == 5)


def _check_unused(name: str, value: int, address: int) -> None:
    if value:
        raise ItemError(f"protocols.sifang.unused.{name}", expected=0, found=value, address=address)
