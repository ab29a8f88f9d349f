"""Descriptions of Sunfar frames for people: fields, errata, hazards and possible interpretations.

The codec decides validity. This reader, never used on a bus, also reads other digit spellings and one nibble a byte,
reports them as errata, and shows the fields of a frame whose checksum or end mark is wrong.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

from drivebus.errors import ProtocolError
from drivebus.protocols.checksum import STRICT_HEX_DIGITS, TOLERANT_HEX_DIGITS, sum16
from drivebus.protocols.describe import (
    FrameDescription,
    FrameDirection,
    Interpretation,
    Note,
    check_size,
    error_note,
    note,
    whole_message,
)
from drivebus.protocols.sunfar.codec import (
    OPERATIONS_WITHOUT_MOTION,
    REQUEST_LAYOUTS,
    SunfarCodec,
    expected_reply_size,
    parse_full_reply,
    parse_short_reply,
)
from drivebus.protocols.sunfar.frame import (
    END_MARK,
    HEX_HEAD,
    IDENTITY_LAYOUT,
    SHORT_LAYOUT,
    WRITE_LAYOUT,
    AsciiFormat,
    FieldFormat,
    FrameFields,
    FrameLayout,
    MixedFormat,
    PackedFormat,
)
from drivebus.protocols.sunfar.messages import (
    CLASS_OFFSET,
    OPERATION_BY_CODE,
    RESPONSE_BY_CODE,
    STATE_BY_CODE,
    VOLTAGE_CLASSES,
    MonitorIndexCoding,
    ReadIdentity,
    ReceivedRequest,
    SunfarOperation,
    SunfarRequest,
    SunfarResponse,
    SunfarState,
    SunfarWriteParameter,
    monitor_index,
    parameter_name,
)
from drivebus.values import bilingual_text


@dataclass(frozen=True, slots=True)
class SunfarDecodeOptions:
    """Facts of a profile that a description needs: frequency step, frequency monitors and parameters."""

    frequency_step_hz: float = 0.01
    frequency_monitors: Collection[int] = (0,)
    """Numbers n of d.n; d.0 is the output frequency on all models."""
    frequency_parameters: Collection[tuple[int, int]] = ((0, 2),)
    """(group, item); F0.2 is the digital frequency in the manuals of the other models."""
    monitor_index: MonitorIndexCoding = "binary"

    def to_hz(self, data: int) -> float:
        return round(data * self.frequency_step_hz, 6)


DEFAULT_DECODE_OPTIONS = SunfarDecodeOptions()


def describe(
    data: bytes,
    encoding: str | None = None,
    direction: FrameDirection | None = None,
    request: bytes | None = None,
    options: SunfarDecodeOptions = DEFAULT_DECODE_OPTIONS,
) -> FrameDescription:
    """Describe a frame; a response against its ``request``, or without one with its possible interpretations.

    Without ``encoding`` the first byte decides, without ``direction`` the shape. Never raises for any bytes.
    """
    encoding = encoding or ("hex" if data[:1] == bytes((HEX_HEAD,)) else "ascii")
    codec = SunfarCodec(encoding, digits="tolerant", nibble=True)  # type: ignore[arg-type]
    fmt: FieldFormat = AsciiFormat(TOLERANT_HEX_DIGITS) if encoding == "ascii" else MixedFormat()
    if direction == "request" or (direction is None and request is None and _is_request(data, fmt)):
        return _describe_request(data, codec, fmt, options)
    return _describe_reply(data, codec, fmt, request, options)


def _is_request(data: bytes, fmt: FieldFormat) -> bool:
    """Decide by length and byte 3; 18 bytes with class 3 are a write unless they can be a rejection with data 0000."""
    if len(data) == SHORT_LAYOUT.size:
        return False
    if len(data) != WRITE_LAYOUT.size:
        return _begins_with_request(data, fmt) or not _begins_with_frame(data, fmt, WRITE_LAYOUT, SHORT_LAYOUT)
    try:
        frame_class, values = fmt.digit(data[CLASS_OFFSET], CLASS_OFFSET), fmt.read(WRITE_LAYOUT, data).values
    except ProtocolError:
        return False
    refusal = values[2] in STATE_BY_CODE and values[2] != SunfarOperation.NONE and values[5] == 0
    return frame_class == 5 or (frame_class == 3 and not refusal)


def _begins_with_frame(data: bytes, fmt: FieldFormat, *layouts: FrameLayout) -> bool:
    """Return whether the first bytes are a whole frame of one of these layouts."""
    return any(len(data) >= layout.size and _is_readable(fmt, layout, data[: layout.size]) for layout in layouts)


def _begins_with_request(data: bytes, fmt: FieldFormat) -> bool:
    layout = REQUEST_LAYOUTS.get(_class_digit(data, fmt))
    return layout is not None and _begins_with_frame(data, fmt, layout)


def _describe_request(
    data: bytes, codec: SunfarCodec, fmt: FieldFormat, options: SunfarDecodeOptions
) -> FrameDescription:
    received, problems = _decode_or_problems(data, codec)
    layout = REQUEST_LAYOUTS.get(_class_digit(data, fmt))
    raw = _unchecked_fields(data, fmt, layout) if layout else None
    if raw is None or layout is None:
        return FrameDescription(
            family="sunfar", encoding=codec.encoding, direction="request", valid=False, problems=problems
        )
    fields = _request_fields(raw.values, options)
    errata = _frame_errata(data, fmt, layout, raw)
    canonical = _canonical_request(received, codec, raw) if received else None
    interpretations = _nibble_interpretation(raw)
    frame_class, operation = raw.values[1:3]
    hazards = _hazards(frame_class, operation) if received else ()  # a drive ignores an invalid frame
    return FrameDescription(
        family="sunfar",
        encoding=codec.encoding,
        direction="request",
        valid=received is not None,
        fields=fields,
        problems=problems,
        errata=errata,
        hazards=hazards,
        canonical=canonical,
        interpretations=interpretations,
    )


def _request_fields(values: tuple[int, ...], options: SunfarDecodeOptions) -> dict[str, Any]:
    address, frame_class, operation, *rest = values
    fields: dict[str, Any] = {"address": address, "class": frame_class, "operation": operation}
    if operation in OPERATION_BY_CODE:
        fields["operation_name"] = OPERATION_BY_CODE[operation].name.lower()
    if frame_class == 4:
        (data,) = rest
        fields["data"] = data
        if operation in OPERATION_BY_CODE and OPERATION_BY_CODE[operation].sets_frequency:
            fields["frequency_hz"] = options.to_hz(data)
        return fields
    fields["group"], item = rest[:2]
    if frame_class != 0:
        fields["item"] = item
    return fields | _value_fields(frame_class, rest[0], item, rest[2] if frame_class in (3, 5) else None, options)


def _hazards(frame_class: int, operation: int) -> tuple[Note, ...]:
    """Report an operation in a class other than 4: a drive obeys it all the same."""
    if frame_class == 4 or operation == SunfarOperation.NONE:
        return ()
    key = "acts" if operation in OPERATIONS_WITHOUT_MOTION else "starts"
    name = bilingual_text(f"protocols.sunfar.order.{OPERATION_BY_CODE[operation].name.lower()}")
    return (note(f"protocols.sunfar.hazard.{key}", operation=operation, name=name, kind=frame_class),)


def _canonical_request(received: ReceivedRequest, codec: SunfarCodec, raw: FrameFields) -> bytes | None:
    """Return the frame of a correct master for this request; None where the codec refuses to encode it."""
    request = received.request
    if raw.nibble_data is not None and isinstance(request, SunfarWriteParameter):
        request = SunfarWriteParameter(request.address, request.group, request.item, raw.nibble_data, request.save)
    try:
        return codec.encode_request(request)
    except ValueError:
        return None


def _describe_reply(
    data: bytes, codec: SunfarCodec, fmt: FieldFormat, request: bytes | None, options: SunfarDecodeOptions
) -> FrameDescription:
    sent_request, problems = _decode_sent_request(request, codec)
    if not problems:
        problems = _reply_problems(data, codec, fmt, sent_request)
    layout = _reply_layout(data, fmt, sent_request)
    raw = _unchecked_fields(data, fmt, layout)
    if raw is None:
        return FrameDescription(
            family="sunfar", encoding=codec.encoding, direction="response", valid=False, problems=problems
        )
    errata = _frame_errata(data, fmt, layout, raw)
    fields = _reply_fields(layout, raw.values, sent_request, options)
    interpretations = _nibble_interpretation(raw)
    if sent_request is None and layout is not SHORT_LAYOUT:
        interpretations += _interpretations(raw.values, layout, data, fmt, options)
    canonical = _canonical_reply(fmt, layout, raw) if not problems else None
    return FrameDescription(
        family="sunfar",
        encoding=codec.encoding,
        direction="response",
        valid=not problems,
        fields=fields,
        problems=problems,
        errata=errata,
        canonical=canonical,
        interpretations=interpretations,
    )


def _decode_sent_request(request: bytes | None, codec: SunfarCodec) -> tuple[SunfarRequest | None, tuple[Note, ...]]:
    if request is None:
        return None, ()
    received, problems = _decode_or_problems(request, codec)
    if received is None:
        return None, (note("protocols.request"), *problems)
    return received.request, ()


def _reply_problems(
    data: bytes, codec: SunfarCodec, fmt: FieldFormat, sent_request: SunfarRequest | None
) -> tuple[Note, ...]:
    try:
        if sent_request is not None:
            whole_message(codec.decode_reply(sent_request, data), data)
        else:
            _check_standalone(data, fmt)
    except ProtocolError as error:
        return (error_note(error),)
    return ()


def _check_standalone(data: bytes, fmt: FieldFormat) -> None:
    """Check a reply without its request: whole, and readable in one layout."""
    size = expected_reply_size(fmt, data)
    check_size(size, data)
    if size == SHORT_LAYOUT.size:
        parse_short_reply(fmt, data)
        return
    parse_full_reply(fmt, data)  # digits 7-8 of a class-0 reply read as an item


def _is_identity_only(data: bytes) -> bool:
    """Return whether byte 7 of a hex frame is a digit of its own; a packed item leaves it 0."""
    return data[7] != 0 and _is_readable(PackedFormat(), IDENTITY_LAYOUT, data[: IDENTITY_LAYOUT.size])


def _reply_layout(data: bytes, fmt: FieldFormat, sent_request: SunfarRequest | None) -> FrameLayout:
    if len(data) < WRITE_LAYOUT.size or _class_digit(data, fmt) in (6, 7, 8):
        return SHORT_LAYOUT
    if isinstance(sent_request, ReadIdentity) or (sent_request is None and _is_identity_only(data)):
        return IDENTITY_LAYOUT if _is_readable(fmt, IDENTITY_LAYOUT, data[: IDENTITY_LAYOUT.size]) else WRITE_LAYOUT
    return WRITE_LAYOUT


def _reply_fields(
    layout: FrameLayout, values: tuple[int, ...], sent_request: SunfarRequest | None, options: SunfarDecodeOptions
) -> dict[str, Any]:
    fields: dict[str, Any] = {"address": values[0], "response": values[1]}
    if values[1] in RESPONSE_BY_CODE:
        fields["response_name"] = RESPONSE_BY_CODE[values[1]].name.lower()
    if layout is SHORT_LAYOUT:
        return fields
    fields |= {"state": values[2], "group": values[3]}
    if values[2] in STATE_BY_CODE:
        fields["state_name"] = STATE_BY_CODE[values[2]].name.lower()
    if layout is IDENTITY_LAYOUT or isinstance(sent_request, ReadIdentity):
        return fields | _identity_fields(values)
    group, item, data = values[3:]
    if values[2] == SunfarState.FAULT:
        return fields | {"fault_code": item, "data": data}
    fields |= {"item": item, "data": data}
    if sent_request is None or values[1] != SunfarResponse.OK:
        return fields
    return fields | _value_fields(sent_request.frame_class, group, item, data, options)


def _identity_fields(values: tuple[int, ...]) -> dict[str, Any]:
    """Return ``info``, and of group 0 the voltage class and the power in decimal digits (C320 manual 3 (1))."""
    state, group, *digits = values[2:]
    if state == SunfarState.FAULT:
        head = "--"
    else:
        head = f"{digits[0]:X}{digits[1]:X}" if len(digits) == 3 else f"{digits[0]:02X}"
    rest = f"{digits[-1]:04X}"
    fields: dict[str, Any] = {"info": head + rest}
    if group == 0 and head[0] in VOLTAGE_CLASSES:
        fields["voltage_class"] = VOLTAGE_CLASSES[head[0]]
    if group == 0 and rest.isdecimal():
        fields["power_kw"] = int(rest) / 10
    return fields


def _canonical_reply(fmt: FieldFormat, layout: FrameLayout, raw: FrameFields) -> bytes:
    """Return the frame of a correct station for this reply."""
    plain: FieldFormat = AsciiFormat(STRICT_HEX_DIGITS) if isinstance(fmt, AsciiFormat) else PackedFormat()
    values = raw.values if raw.nibble_data is None else (*raw.values[:-1], raw.nibble_data)
    return plain.build(layout, *values)


def _interpretations(
    values: tuple[int, ...], layout: FrameLayout, data: bytes, fmt: FieldFormat, options: SunfarDecodeOptions
) -> tuple[Interpretation, ...]:
    """List the requests that a reply may answer: the frame does not name the class."""
    interpretations: list[Interpretation] = []
    group, fault = values[3], values[2] == SunfarState.FAULT
    if layout is WRITE_LAYOUT and not fault:
        item, word = values[4:]
        if group == 0:
            interpretations.append(
                Interpretation(note("protocols.sunfar.reading.monitor"), _value_fields(1, 0, item, word, options))
            )
        interpretations.append(
            Interpretation(note("protocols.sunfar.reading.parameter"), _value_fields(2, group, item, word, options))
        )
    identity = _identity_interpretation(data, fmt, group)
    if identity is not None:
        interpretations.append(Interpretation(note("protocols.sunfar.reading.identity"), identity))
    if values[1] == SunfarResponse.PASSWORD and values[2] == SunfarState.NOT_READY:
        interpretations.append(Interpretation(note("protocols.sunfar.reading.echo"), {}))
    return tuple(interpretations)


def _identity_interpretation(data: bytes, fmt: FieldFormat, group: int) -> dict[str, Any] | None:
    """Return the fields as a class-0 reply, if plausible: groups 0-3; group 0 with a known voltage class and power."""
    raw = _unchecked_fields(data, fmt, IDENTITY_LAYOUT)
    if raw is None or group > 3:
        return None
    fields = _identity_fields(raw.values)
    return fields if group or {"voltage_class", "power_kw"}.issubset(fields) else None


def _class_digit(data: bytes, fmt: FieldFormat) -> int:
    """Return the class or response code; -1 where the frame has none."""
    try:
        return fmt.digit(data[CLASS_OFFSET], CLASS_OFFSET)
    except (ProtocolError, IndexError):
        return -1


def _unchecked_fields(data: bytes, fmt: FieldFormat, layout: FrameLayout) -> FrameFields | None:
    """Return the fields of a frame; a wrong end mark or checksum is corrected first."""
    frame = data[: layout.size]
    if len(frame) < layout.size or frame[0] != fmt.head:
        return None
    total = sum16(frame[1:-5])
    checksum = b"%04X" % total if isinstance(fmt, AsciiFormat) else total.to_bytes(4, "big")
    for attempt in (frame, frame[:-5] + checksum + bytes((END_MARK,))):
        try:
            return fmt.read(layout, attempt)
        except ProtocolError:
            continue
    return None


def _value_fields(
    frame_class: int, group: int, item: int, data: int | None, options: SunfarDecodeOptions
) -> dict[str, Any]:
    """Return monitor or parameter in the manual's notation with its data, and the frequency where it is one."""
    fields: dict[str, Any] = {}
    if frame_class in (1, 4):
        index = monitor_index(item, options.monitor_index)
        fields["monitor"] = f"d.{index}"
        is_frequency = index in options.frequency_monitors
    elif frame_class in (2, 3, 5):
        fields["parameter"] = parameter_name(group, item)
        is_frequency = (group, item) in options.frequency_parameters
    else:
        return fields
    if data is not None:
        fields["data"] = data
        if is_frequency:
            fields["frequency_hz"] = options.to_hz(data)
    return fields


def _frame_errata(data: bytes, fmt: FieldFormat, layout: FrameLayout, raw: FrameFields) -> tuple[Note, ...]:
    """List where these bytes differ from what a correct sender writes for the same numbers."""
    plain: FieldFormat = AsciiFormat(STRICT_HEX_DIGITS) if isinstance(fmt, AsciiFormat) else PackedFormat()
    errata: list[Note] = []
    canonical = plain.build(layout, *raw.values)
    if data[: layout.size - 5] != canonical[:-5] or _is_checksum_misspelled(data[: layout.size], plain, layout):
        key = "digits" if isinstance(fmt, AsciiFormat) else "nibbles"
        errata.append(note(f"protocols.sunfar.erratum.{key}"))
    if raw.nibble_data is not None:
        errata.append(note("protocols.sunfar.erratum.ambiguous", packed=raw.values[-1], nibbles=raw.nibble_data))
    return tuple(errata)


def _is_checksum_misspelled(frame: bytes, plain: FieldFormat, layout: FrameLayout) -> bool:
    """Return whether the checksum is right but in another spelling, with canonical fields."""
    tolerant: FieldFormat = AsciiFormat(TOLERANT_HEX_DIGITS) if isinstance(plain, AsciiFormat) else MixedFormat()
    return _is_readable(tolerant, layout, frame) and not _is_readable(plain, layout, frame)


def _is_readable(fmt: FieldFormat, layout: FrameLayout, frame: bytes) -> bool:
    try:
        fmt.read(layout, frame)
    except ProtocolError:
        return False
    return True


def _nibble_interpretation(raw: FrameFields) -> tuple[Interpretation, ...]:
    if raw.nibble_data is None:
        return ()
    return (Interpretation(note("protocols.sunfar.reading.nibbles"), {"data": raw.nibble_data}),)


def _decode_or_problems(data: bytes, codec: SunfarCodec) -> tuple[ReceivedRequest | None, tuple[Note, ...]]:
    try:
        return whole_message(codec.decode_request(data), data), ()
    except ProtocolError as error:
        return None, (error_note(error),)
