"""What a C320 reply says, for people, with its request or without it."""

from __future__ import annotations

from typing import Any

from drivebus.errors import ProtocolError
from drivebus.protocols.checksum import STRICT_HEX_DIGITS
from drivebus.protocols.codec import Complete, Incomplete
from drivebus.protocols.describe import FrameDescription, Interpretation, Note, error_note, note, require_whole_frame
from drivebus.protocols.sunfar.codec import SunfarCodec
from drivebus.protocols.sunfar.frame import (
    IDENTITY_LAYOUT,
    SHORT_LAYOUT,
    WRITE_LAYOUT,
    AsciiFormat,
    FieldFormat,
    FrameFields,
    FrameLayout,
    PackedFormat,
)
from drivebus.protocols.sunfar.messages import ReadIdentity, SunfarRequest
from drivebus.protocols.sunfar.replies import expected_reply_size, parse_full_reply, parse_short_reply
from drivebus.protocols.sunfar.tables import RESPONSE_BY_CODE, STATE_BY_CODE, SunfarResponse, SunfarState
from drivebus.protocols.sunfar.tolerant import (
    SunfarDecodeOptions,
    class_digit,
    decode_or_problems,
    frame_errata,
    is_readable,
    locate_value,
    nibble_interpretation,
    unchecked_fields,
)

_VOLTAGE_CLASSES = {"2": 220, "4": 380}


def describe_reply(
    data: bytes, codec: SunfarCodec, form: FieldFormat, request: bytes | None, meaning: SunfarDecodeOptions
) -> FrameDescription:
    asked, problems = _decode_request(request, codec)
    if not problems:
        problems = _reply_problems(data, codec, form, asked)
    layout = _reply_layout(data, form, asked)
    raw = unchecked_fields(data, form, layout)
    if raw is None:
        return FrameDescription("c320", codec.encoding, "response", False, problems=problems)
    errata = frame_errata(data, form, layout, raw)
    fields = _reply_fields(layout, raw.values, asked, meaning)
    readings = nibble_interpretation(raw)
    if asked is None and layout is not SHORT_LAYOUT:
        readings += _interpretations(raw.values, layout, data, form, meaning)
    emitted = _canonical_reply(form, layout, raw) if not problems else None
    return FrameDescription(
        "c320", codec.encoding, "response", not problems, fields, problems, errata, (), emitted, readings
    )


def _decode_request(request: bytes | None, codec: SunfarCodec) -> tuple[SunfarRequest | None, tuple[Note, ...]]:
    if request is None:
        return None, ()
    heard, problems = decode_or_problems(request, codec)
    if heard is None:
        return None, (note("protocols.request"), *problems)
    return heard.request, ()


def _reply_problems(
    data: bytes, codec: SunfarCodec, form: FieldFormat, asked: SunfarRequest | None
) -> tuple[Note, ...]:
    try:
        if asked is not None:
            require_whole_frame(codec.decode_reply(asked, data), data)
        else:
            _check_standalone(data, form)
    except ProtocolError as error:
        return (error_note(error),)
    return ()


def _check_standalone(data: bytes, form: FieldFormat) -> None:
    """A reply without its request: whole, and readable in one of its shapes."""
    size = expected_reply_size(form, data)
    require_whole_frame(Incomplete(size) if len(data) < size else Complete(None, size), data)
    if size == SHORT_LAYOUT.size:
        parse_short_reply(form, data)
        return
    parse_full_reply(form, data)  # a class-0 reply's digits 7-8 read as a nibble item


def _is_identity_only(data: bytes) -> bool:
    """A hex frame whose byte 7 is a digit of its own: packed items leave it 0."""
    return data[7] != 0 and is_readable(PackedFormat(), IDENTITY_LAYOUT, data[: IDENTITY_LAYOUT.size])


def _reply_layout(data: bytes, form: FieldFormat, asked: SunfarRequest | None) -> FrameLayout:
    if len(data) < WRITE_LAYOUT.size or class_digit(data, form) in (6, 7, 8):
        return SHORT_LAYOUT
    if isinstance(asked, ReadIdentity) or (asked is None and _is_identity_only(data)):
        return IDENTITY_LAYOUT if is_readable(form, IDENTITY_LAYOUT, data[: IDENTITY_LAYOUT.size]) else WRITE_LAYOUT
    return WRITE_LAYOUT


def _reply_fields(
    layout: FrameLayout, values: tuple[int, ...], asked: SunfarRequest | None, meaning: SunfarDecodeOptions
) -> dict[str, Any]:
    fields: dict[str, Any] = {"address": values[0], "response": values[1]}
    if values[1] in RESPONSE_BY_CODE:
        fields["response_name"] = RESPONSE_BY_CODE[values[1]].name.lower()
    if layout is SHORT_LAYOUT:
        return fields
    fields |= {"state": values[2], "group": values[3]}
    if values[2] in STATE_BY_CODE:
        fields["state_name"] = STATE_BY_CODE[values[2]].name.lower()
    if layout is IDENTITY_LAYOUT or isinstance(asked, ReadIdentity):
        return fields | _identity_fields(values)
    group, item, data = values[3:]
    if values[2] == SunfarState.FAULT:
        return fields | {"fault_code": item, "data": data}
    fields |= {"item": item, "data": data}
    if asked is None or values[1] != SunfarResponse.OK:
        return fields
    return fields | locate_value(asked.frame_class, group, item, data, meaning)


def _identity_fields(values: tuple[int, ...]) -> dict[str, Any]:
    """``info``, and of group 0 the voltage class and the power in decimal digits (section 3 (1))."""
    state, group, *digits = values[2:]
    if state == SunfarState.FAULT:
        head = "--"
    else:
        head = f"{digits[0]:X}{digits[1]:X}" if len(digits) == 3 else f"{digits[0]:02X}"
    rest = f"{digits[-1]:04X}"
    fields: dict[str, Any] = {"info": head + rest}
    if group == 0 and head[0] in _VOLTAGE_CLASSES:
        fields["voltage_class"] = _VOLTAGE_CLASSES[head[0]]
    if group == 0 and rest.isdecimal():
        fields["power_kw"] = int(rest) / 10
    return fields


def _canonical_reply(form: FieldFormat, layout: FrameLayout, raw: FrameFields) -> bytes:
    """What a correct station sends for this reply."""
    plain: FieldFormat = AsciiFormat(STRICT_HEX_DIGITS) if isinstance(form, AsciiFormat) else PackedFormat()
    values = raw.values if raw.nibble_data is None else (*raw.values[:-1], raw.nibble_data)
    return plain.build(layout, *values)


def _interpretations(
    values: tuple[int, ...], layout: FrameLayout, data: bytes, form: FieldFormat, meaning: SunfarDecodeOptions
) -> tuple[Interpretation, ...]:
    """What a reply may answer: it does not say which class it answers (T04)."""
    found: list[Interpretation] = []
    group, fault = values[3], values[2] == SunfarState.FAULT
    if layout is WRITE_LAYOUT and not fault:
        item, word = values[4:]
        if group == 0:
            found.append(
                Interpretation(note("protocols.sifang.reading.monitor"), locate_value(1, 0, item, word, meaning))
            )
        found.append(
            Interpretation(note("protocols.sifang.reading.parameter"), locate_value(2, group, item, word, meaning))
        )
    identity = _identity_interpretation(data, form, group)
    if identity is not None:
        found.append(Interpretation(note("protocols.sifang.reading.identity"), identity))
    if values[1] == SunfarResponse.PASSWORD and values[2] == SunfarState.NOT_READY:
        found.append(Interpretation(note("protocols.sifang.reading.echo"), {}))
    return tuple(found)


def _identity_interpretation(data: bytes, form: FieldFormat, group: int) -> dict[str, Any] | None:
    """The class-0 reading where it is one: groups 0-3; of group 0 a known voltage class and decimal power."""
    raw = unchecked_fields(data, form, IDENTITY_LAYOUT)
    if raw is None or group > 3:
        return None
    fields = _identity_fields(raw.values)
    return fields if group or {"voltage_class", "power_kw"}.issubset(fields) else None
