"""C320 requests to frames and back: what a host writes and a station hears."""

from __future__ import annotations

from drivebus.errors import AddressError, AlphabetError, ChecksumError, CodeError, ProtocolError
from drivebus.protocols.codec import Complete, DecodeResult, Incomplete
from drivebus.protocols.sunfar.frame import (
    CONTROL_LAYOUT,
    READ_LAYOUT,
    WRITE_LAYOUT,
    AsciiFormat,
    FieldFormat,
    FrameFields,
    FrameLayout,
    check_head,
)
from drivebus.protocols.sunfar.messages import (
    ReadIdentity,
    ReadMonitor,
    ReceivedRequest,
    SunfarControl,
    SunfarReadParameter,
    SunfarRequest,
    SunfarWriteParameter,
    UnknownItemError,
)
from drivebus.protocols.sunfar.tables import BROADCAST, CLASS_OFFSET, OPERATION_BY_CODE, SunfarOperation

_STOP_OPERATIONS = (SunfarOperation.STOP, SunfarOperation.JOG_STOP, SunfarOperation.EMERGENCY_STOP)
REQUEST_LAYOUTS = {0: READ_LAYOUT, 1: READ_LAYOUT, 2: READ_LAYOUT, 3: WRITE_LAYOUT, 4: CONTROL_LAYOUT, 5: WRITE_LAYOUT}


def build_request(form: FieldFormat, request: SunfarRequest) -> bytes:
    """The frame of a request. Nothing but ``Control`` can put an operation into it (T01, T07)."""
    check_range("address", request.address, BROADCAST)
    if type(request) is SunfarControl:
        return form.build(CONTROL_LAYOUT, request.address, 4, request.operation, _control_data(request))
    if type(request) is SunfarWriteParameter:
        check_range("group", request.group, 0x0F)
        check_range("item", request.item, 0xFF)
        check_range("data", request.data, 0xFFFF)
        head = (request.address, request.frame_class, SunfarOperation.NONE)
        return form.build(WRITE_LAYOUT, *head, request.group, request.item, request.data)
    group, item = group_and_item(request)
    if request.address == BROADCAST:
        raise ValueError(f"address {BROADCAST} is everybody: nobody answers a read")
    return form.build(READ_LAYOUT, request.address, request.frame_class, SunfarOperation.NONE, group, item)


def group_and_item(request: SunfarRequest) -> tuple[int, int]:
    group = 0 if type(request) is ReadMonitor else request.group  # type: ignore[union-attr]
    item = 0 if type(request) is ReadIdentity else request.item  # type: ignore[union-attr]
    check_range("group", group, 0x0F)
    check_range("item", item, 0xFF)
    return group, item


def _control_data(request: SunfarControl) -> int:
    """Only an operation that sets a frequency has data. A stop is never refused for having some: it sends 0000."""
    if request.operation in _STOP_OPERATIONS:
        return 0
    if request.operation not in OPERATION_BY_CODE:
        raise ValueError(f"operation {request.operation} is not one of the manual's (2.4.4)")
    check_range("data", request.data, 0xFFFF)
    if request.data and not SunfarOperation(request.operation).sets_frequency:
        raise ValueError(f"operation {request.operation:02X}H takes no data, {request.data} given")
    return request.data


def check_range(name: str, value: int, limit: int) -> None:
    if not 0 <= value <= limit:
        raise ValueError(f"{name} {value}: expected 0 to {limit}")


def decode_request(form: FieldFormat, data: bytes) -> DecodeResult:
    """The request that begins at offset 0, whoever sent it."""
    check_head(form, data)
    if len(data) <= CLASS_OFFSET:
        return Incomplete(READ_LAYOUT.size)
    layout = REQUEST_LAYOUTS.get(form.digit(data[CLASS_OFFSET], CLASS_OFFSET))
    if layout is None:
        return _reject_unknown_class(form, data)
    if len(data) < layout.size:
        return Incomplete(layout.size)
    return Complete(_received_request(_read_fields(form, layout, data[: layout.size])), layout.size)


def _read_fields(form: FieldFormat, layout: FrameLayout, frame: bytes) -> FrameFields:
    """The fields; a bad ASCII digit is told with the address of the station that is to complain (code 7)."""
    try:
        return form.read(layout, frame)
    except AlphabetError as error:
        if isinstance(form, AsciiFormat):
            error.params["address"] = _parse_address(form, frame)
        raise


def _parse_address(form: FieldFormat, frame: bytes) -> int | None:
    try:
        return form.digit(frame[1], 1) << 4 | form.digit(frame[2], 2)
    except AlphabetError:
        return None


def _reject_unknown_class(form: FieldFormat, data: bytes) -> DecodeResult:
    """Classes 6-F have no length: the frame is over where end mark and sum fit one of the three lengths."""
    for layout in (READ_LAYOUT, CONTROL_LAYOUT, WRITE_LAYOUT):
        if len(data) < layout.size:
            return Incomplete(layout.size)
        try:
            address, kind = form.read(layout, data[: layout.size]).values[:2]
        except ProtocolError:
            continue
        raise CodeError("protocols.sifang.class", expected="0-5", found=kind, address=address)
    raise ChecksumError("protocols.sifang.no_length", expected="0-5", found=data[CLASS_OFFSET])


def _received_request(fields: FrameFields) -> ReceivedRequest:
    address, kind, code, *rest = fields.values
    if address > BROADCAST:
        raise AddressError("protocols.sifang.address_range", expected=BROADCAST, found=address)
    operation = OPERATION_BY_CODE.get(code)
    if operation is None:
        raise CodeError("protocols.sifang.operation", expected="00-06, 10-16, 20, 21", found=code, address=address)
    return ReceivedRequest(_parse_request(address, kind, operation, rest), operation, fields.nibble_data)


def _parse_request(address: int, kind: int, operation: SunfarOperation, rest: list[int]) -> SunfarRequest:
    if kind == 4:
        return SunfarControl(address, operation, rest[0])
    group, item = rest[:2]
    if kind == 1:
        _check_unused_field("group", group, address)
        return ReadMonitor(address, item)
    if kind == 0:
        _check_unused_field("item", item, address)
        return ReadIdentity(address, group)
    if kind == 2:
        return SunfarReadParameter(address, group, item)
    return SunfarWriteParameter(address, group, item, rest[2], save=kind == 5)


def _check_unused_field(name: str, value: int, address: int) -> None:
    if value:
        raise UnknownItemError(f"protocols.sifang.unused.{name}", expected=0, found=value, address=address)
