"""What a C320 frame says, for people: tolerant digits and nibble frames are read, and said to be what they are.

The codec judges; this module only shows. Fields are shown also where the sum or the end mark is wrong.
"""

from __future__ import annotations

from typing import Any

from drivebus.errors import ProtocolError
from drivebus.protocols.checksum import TOLERANT_HEX_DIGITS
from drivebus.protocols.codec import Effect
from drivebus.protocols.describe import Direction, FrameDescription, Note, bilingual, note
from drivebus.protocols.sunfar.classify import OPERATION_EFFECTS
from drivebus.protocols.sunfar.codec import SunfarCodec
from drivebus.protocols.sunfar.describe_reply import describe_reply
from drivebus.protocols.sunfar.frame import (
    HEX_HEAD,
    SHORT_LAYOUT,
    WRITE_LAYOUT,
    AsciiFormat,
    FieldFormat,
    FrameFields,
    FrameLayout,
    MixedFormat,
)
from drivebus.protocols.sunfar.messages import ReceivedRequest, SunfarWriteParameter
from drivebus.protocols.sunfar.requests import REQUEST_LAYOUTS
from drivebus.protocols.sunfar.tables import CLASS_OFFSET, OPERATION_BY_CODE, STATE_BY_CODE, SunfarOperation
from drivebus.protocols.sunfar.tolerant import (
    DEFAULT_DECODE_OPTIONS,
    SunfarDecodeOptions,
    class_digit,
    decode_or_problems,
    frame_errata,
    is_readable,
    locate_value,
    nibble_interpretation,
    unchecked_fields,
)


def describe(
    data: bytes,
    encoding: str | None = None,
    direction: Direction | None = None,
    request: bytes | None = None,
    meaning: SunfarDecodeOptions = DEFAULT_DECODE_OPTIONS,
) -> FrameDescription:
    """The frame explained; a response against its ``request`` frame, or without it with its candidate readings.

    Without ``encoding`` the head tells it, without ``direction`` the shape. Never raises for any bytes.
    """
    encoding = encoding or ("hex" if data[:1] == bytes((HEX_HEAD,)) else "ascii")
    codec = SunfarCodec(encoding, digits="tolerant", nibble=True)  # type: ignore[arg-type]
    form: FieldFormat = AsciiFormat(TOLERANT_HEX_DIGITS) if encoding == "ascii" else MixedFormat()
    if direction == "request" or (direction is None and request is None and _is_request(data, form)):
        return _describe_request(data, codec, form, meaning)
    return describe_reply(data, codec, form, request, meaning)


def _is_request(data: bytes, form: FieldFormat) -> bool:
    """By length and byte 3. An 18-byte frame with 3 there is a write, unless its data are a refusal's 0000 (T21)."""
    if len(data) == SHORT_LAYOUT.size:
        return False
    if len(data) != WRITE_LAYOUT.size:
        return _begins_with_request(data, form) or not _begins_with_frame(data, form, WRITE_LAYOUT, SHORT_LAYOUT)
    try:
        kind, values = form.digit(data[CLASS_OFFSET], CLASS_OFFSET), form.read(WRITE_LAYOUT, data).values
    except ProtocolError:
        return False
    refusal = values[2] in STATE_BY_CODE and values[2] != SunfarOperation.NONE and values[5] == 0
    return kind == 5 or (kind == 3 and not refusal)


def _begins_with_frame(data: bytes, form: FieldFormat, *layouts: FrameLayout) -> bool:
    """Whether the first bytes are a whole frame of one of these, whatever follows them."""
    return any(len(data) >= layout.size and is_readable(form, layout, data[: layout.size]) for layout in layouts)


def _begins_with_request(data: bytes, form: FieldFormat) -> bool:
    layout = REQUEST_LAYOUTS.get(class_digit(data, form))
    return layout is not None and _begins_with_frame(data, form, layout)


def _describe_request(
    data: bytes, codec: SunfarCodec, form: FieldFormat, meaning: SunfarDecodeOptions
) -> FrameDescription:
    heard, problems = decode_or_problems(data, codec)
    layout = REQUEST_LAYOUTS.get(class_digit(data, form))
    raw = unchecked_fields(data, form, layout) if layout else None
    if raw is None or layout is None:
        return FrameDescription("c320", codec.encoding, "request", False, problems=problems)
    fields = _request_fields(raw.values, meaning)
    errata = frame_errata(data, form, layout, raw)
    emitted = _canonical_request(heard, codec, raw) if heard else None
    readings = nibble_interpretation(raw)
    kind, operation = raw.values[1:3]
    hazards = _hazards(kind, operation) if heard else ()  # a drive obeys no frame that is not one
    return FrameDescription(
        "c320", codec.encoding, "request", heard is not None, fields, problems, errata, hazards, emitted, readings
    )


def _request_fields(values: tuple[int, ...], meaning: SunfarDecodeOptions) -> dict[str, Any]:
    address, kind, operation, *rest = values
    fields: dict[str, Any] = {"address": address, "class": kind, "operation": operation}
    if operation in OPERATION_BY_CODE:
        fields["operation_name"] = OPERATION_BY_CODE[operation].name.lower()
    if kind == 4:
        (data,) = rest
        fields["data"] = data
        if operation in OPERATION_BY_CODE and OPERATION_BY_CODE[operation].sets_frequency:
            fields["frequency_hz"] = meaning.to_hz(data)
        return fields
    fields["group"], item = rest[:2]
    if kind != 0:
        fields["item"] = item
    return fields | locate_value(kind, rest[0], item, rest[2] if kind in (3, 5) else None, meaning)


def _hazards(kind: int, operation: int) -> tuple[Note, ...]:
    """T01: an operation acts in every class, whatever the frame seems to be for."""
    if kind == 4 or operation == SunfarOperation.NONE:
        return ()
    ordered = OPERATION_EFFECTS.get(OPERATION_BY_CODE[operation], Effect.MOTION)
    key = "starts" if ordered is Effect.MOTION else "acts"
    name = bilingual(f"protocols.sifang.order.{OPERATION_BY_CODE[operation].name.lower()}")
    return (note(f"protocols.sifang.hazard.{key}", operation=operation, name=name, kind=kind),)


def _canonical_request(heard: ReceivedRequest, codec: SunfarCodec, raw: FrameFields) -> bytes | None:
    """What a correct host sends for this request; None where it would not send it at all."""
    request = heard.request
    if raw.nibble_data is not None and isinstance(request, SunfarWriteParameter):
        request = SunfarWriteParameter(request.address, request.group, request.item, raw.nibble_data, request.save)
    try:
        return codec.encode_request(request)
    except ValueError:
        return None
