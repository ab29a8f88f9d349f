"""What a C320 frame says, for people: tolerant digits and nibble frames are read, and said to be what they are.

The codec judges; this module only shows. Fields are shown also where the sum or the end mark is wrong.
"""

from __future__ import annotations

from typing import Any

from drivebus.errors import ProtocolError
from drivebus.message import Effect
from drivebus.protocols.checksum import TOLERANT
from drivebus.protocols.describe import Description, Direction, Note, note, words
from drivebus.protocols.sifang.codec import SifangCodec
from drivebus.protocols.sifang.effect import OPERATION_EFFECTS
from drivebus.protocols.sifang.explain_reply import describe_reply
from drivebus.protocols.sifang.frame import (
    HEX_HEAD,
    SHORT,
    WRITE,
    AsciiForm,
    Fields,
    Form,
    Layout,
    MixedForm,
)
from drivebus.protocols.sifang.messages import Heard, WriteParameter
from drivebus.protocols.sifang.requests import REQUEST_LAYOUTS
from drivebus.protocols.sifang.tables import (
    KIND_AT,
    OPERATIONS,
    STATES,
    Operation,
)
from drivebus.protocols.sifang.tolerant import (
    C320,
    Meaning,
    digit_or_none,
    errata_of,
    heard_or_why,
    other_reading,
    place,
    raw_fields,
    reads,
)


def describe(
    data: bytes,
    encoding: str | None = None,
    direction: Direction | None = None,
    request: bytes | None = None,
    meaning: Meaning = C320,
) -> Description:
    """The frame explained; a response against its ``request`` frame, or without it with its candidate readings.

    Without ``encoding`` the head tells it, without ``direction`` the shape. Never raises for any bytes.
    """
    encoding = encoding or ("hex" if data[:1] == bytes((HEX_HEAD,)) else "ascii")
    codec = SifangCodec(encoding, digits="tolerant", nibble=True)  # type: ignore[arg-type]
    form: Form = AsciiForm(TOLERANT) if encoding == "ascii" else MixedForm()
    if direction == "request" or (direction is None and request is None and _is_request(data, form)):
        return _describe_request(data, codec, form, meaning)
    return describe_reply(data, codec, form, request, meaning)


def _is_request(data: bytes, form: Form) -> bool:
    """By length and byte 3. An 18-byte frame with 3 there is a write, unless its data are a refusal's 0000 (T21)."""
    if len(data) == SHORT.size:
        return False
    if len(data) != WRITE.size:
        return _begins_request(data, form) or not _begins(data, form, WRITE, SHORT)
    try:
        kind, values = form.digit(data[KIND_AT], KIND_AT), form.read(WRITE, data).values
    except ProtocolError:
        return False
    refusal = values[2] in STATES and values[2] != Operation.NONE and values[5] == 0
    return kind == 5 or (kind == 3 and not refusal)


def _begins(data: bytes, form: Form, *layouts: Layout) -> bool:
    """Whether the first bytes are a whole frame of one of these, whatever follows them."""
    return any(len(data) >= layout.size and reads(form, layout, data[: layout.size]) for layout in layouts)


def _begins_request(data: bytes, form: Form) -> bool:
    layout = REQUEST_LAYOUTS.get(digit_or_none(data, form))
    return layout is not None and _begins(data, form, layout)


def _describe_request(data: bytes, codec: SifangCodec, form: Form, meaning: Meaning) -> Description:
    heard, problems = heard_or_why(data, codec)
    layout = REQUEST_LAYOUTS.get(digit_or_none(data, form))
    raw = raw_fields(data, form, layout) if layout else None
    if raw is None or layout is None:
        return Description("c320", codec.encoding, "request", False, problems=problems)
    fields = _request_fields(raw.values, meaning)
    errata = errata_of(data, form, layout, raw)
    emitted = _emitted(heard, codec, raw) if heard else None
    readings = other_reading(raw)
    kind, operation = raw.values[1:3]
    hazards = _hazards(kind, operation) if heard else ()  # a drive obeys no frame that is not one
    return Description(
        "c320", codec.encoding, "request", heard is not None, fields, problems, errata, hazards, emitted, readings
    )


def _request_fields(values: tuple[int, ...], meaning: Meaning) -> dict[str, Any]:
    address, kind, operation, *rest = values
    fields: dict[str, Any] = {"address": address, "class": kind, "operation": operation}
    if operation in OPERATIONS:
        fields["operation_name"] = OPERATIONS[operation].name.lower()
    if kind == 4:
        (data,) = rest
        fields["data"] = data
        if operation in OPERATIONS and OPERATIONS[operation].sets_frequency:
            fields["frequency_hz"] = meaning.hz(data)
        return fields
    fields["group"], item = rest[:2]
    if kind != 0:
        fields["item"] = item
    return fields | place(kind, rest[0], item, rest[2] if kind in (3, 5) else None, meaning)


def _hazards(kind: int, operation: int) -> tuple[Note, ...]:
    """T01: an operation acts in every class, whatever the frame seems to be for."""
    if kind == 4 or operation == Operation.NONE:
        return ()
    ordered = OPERATION_EFFECTS.get(OPERATIONS[operation], Effect.MOTION)
    key = "starts" if ordered is Effect.MOTION else "acts"
    name = words(f"protocols.sifang.order.{OPERATIONS[operation].name.lower()}")
    return (note(f"protocols.sifang.hazard.{key}", operation=operation, name=name, kind=kind),)


def _emitted(heard: Heard, codec: SifangCodec, raw: Fields) -> bytes | None:
    """What a correct host sends for this request; None where it would not send it at all."""
    request = heard.request
    if raw.other_data is not None and isinstance(request, WriteParameter):
        request = WriteParameter(request.address, request.group, request.item, raw.other_data, request.save)
    try:
        return codec.encode_request(request)
    except ValueError:
        return None
