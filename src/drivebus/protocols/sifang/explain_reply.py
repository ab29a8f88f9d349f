"""What a C320 reply says, for people, with its request or without it."""

from __future__ import annotations

from typing import Any

from drivebus.errors import ProtocolError
from drivebus.message import Complete, Incomplete
from drivebus.protocols.checksum import STRICT
from drivebus.protocols.describe import Candidate, Description, Note, check_whole, note, problem
from drivebus.protocols.sifang.codec import SifangCodec
from drivebus.protocols.sifang.frame import (
    IDENTITY,
    SHORT,
    WRITE,
    AsciiForm,
    Fields,
    Form,
    Layout,
    PackedForm,
)
from drivebus.protocols.sifang.messages import ReadIdentity, Request
from drivebus.protocols.sifang.replies import framed_size, read_full, read_short
from drivebus.protocols.sifang.tables import (
    RESPONSES,
    STATES,
    Response,
    State,
)
from drivebus.protocols.sifang.tolerant import (
    Meaning,
    digit_or_none,
    errata_of,
    heard_or_why,
    other_reading,
    place,
    raw_fields,
    reads,
)

_VOLTAGES = {"2": 220, "4": 380}


def describe_reply(data: bytes, codec: SifangCodec, form: Form, request: bytes | None, meaning: Meaning) -> Description:
    asked, problems = _asked(request, codec)
    if not problems:
        problems = _reply_problems(data, codec, form, asked)
    layout = _reply_layout(data, form, asked)
    raw = raw_fields(data, form, layout)
    if raw is None:
        return Description("c320", codec.encoding, "response", False, problems=problems)
    errata = errata_of(data, form, layout, raw)
    fields = _reply_fields(layout, raw.values, asked, meaning)
    readings = other_reading(raw)
    if asked is None and layout is not SHORT:
        readings += _readings(raw.values, layout, data, form, meaning)
    emitted = _answered(form, layout, raw) if not problems else None
    return Description(
        "c320", codec.encoding, "response", not problems, fields, problems, errata, (), emitted, readings
    )


def _asked(request: bytes | None, codec: SifangCodec) -> tuple[Request | None, tuple[Note, ...]]:
    if request is None:
        return None, ()
    heard, problems = heard_or_why(request, codec)
    if heard is None:
        return None, (note("protocols.request"), *problems)
    return heard.request, ()


def _reply_problems(data: bytes, codec: SifangCodec, form: Form, asked: Request | None) -> tuple[Note, ...]:
    try:
        if asked is not None:
            check_whole(codec.decode_reply(asked, data), data)
        else:
            _check_alone(data, form)
    except ProtocolError as error:
        return (problem(error),)
    return ()


def _check_alone(data: bytes, form: Form) -> None:
    """A reply without its request: whole, and readable in one of its shapes."""
    size = framed_size(form, data)
    check_whole(Incomplete(size) if len(data) < size else Complete(None, size), data)
    if size == SHORT.size:
        read_short(form, data)
        return
    read_full(form, data)  # a class-0 reply's digits 7-8 read as a nibble item


def _only_identity(data: bytes) -> bool:
    """A hex frame whose byte 7 is a digit of its own: packed items leave it 0."""
    return data[7] != 0 and reads(PackedForm(), IDENTITY, data[: IDENTITY.size])


def _reply_layout(data: bytes, form: Form, asked: Request | None) -> Layout:
    if len(data) < WRITE.size or digit_or_none(data, form) in (6, 7, 8):
        return SHORT
    if isinstance(asked, ReadIdentity) or (asked is None and _only_identity(data)):
        return IDENTITY if reads(form, IDENTITY, data[: IDENTITY.size]) else WRITE
    return WRITE


def _reply_fields(layout: Layout, values: tuple[int, ...], asked: Request | None, meaning: Meaning) -> dict[str, Any]:
    fields: dict[str, Any] = {"address": values[0], "response": values[1]}
    if values[1] in RESPONSES:
        fields["response_name"] = RESPONSES[values[1]].name.lower()
    if layout is SHORT:
        return fields
    fields |= {"state": values[2], "group": values[3]}
    if values[2] in STATES:
        fields["state_name"] = STATES[values[2]].name.lower()
    if layout is IDENTITY or isinstance(asked, ReadIdentity):
        return fields | _identity_fields(values)
    group, item, data = values[3:]
    if values[2] == State.FAULT:
        return fields | {"fault_code": item, "data": data}
    fields |= {"item": item, "data": data}
    if asked is None or values[1] != Response.OK:
        return fields
    return fields | place(asked.kind, group, item, data, meaning)


def _identity_fields(values: tuple[int, ...]) -> dict[str, Any]:
    """``info``, and of group 0 the voltage class and the power in decimal digits (section 3 (1))."""
    state, group, *digits = values[2:]
    if state == State.FAULT:
        head = "--"
    else:
        head = f"{digits[0]:X}{digits[1]:X}" if len(digits) == 3 else f"{digits[0]:02X}"
    rest = f"{digits[-1]:04X}"
    fields: dict[str, Any] = {"info": head + rest}
    if group == 0 and head[0] in _VOLTAGES:
        fields["voltage_class"] = _VOLTAGES[head[0]]
    if group == 0 and rest.isdecimal():
        fields["power_kw"] = int(rest) / 10
    return fields


def _answered(form: Form, layout: Layout, raw: Fields) -> bytes:
    """What a correct station sends for this reply."""
    plain: Form = AsciiForm(STRICT) if isinstance(form, AsciiForm) else PackedForm()
    values = raw.values if raw.other_data is None else (*raw.values[:-1], raw.other_data)
    return plain.build(layout, *values)


def _readings(
    values: tuple[int, ...], layout: Layout, data: bytes, form: Form, meaning: Meaning
) -> tuple[Candidate, ...]:
    """What a reply may answer: it does not say which class it answers (T04)."""
    found: list[Candidate] = []
    group, fault = values[3], values[2] == State.FAULT
    if layout is WRITE and not fault:
        item, word = values[4:]
        if group == 0:
            found.append(Candidate(note("protocols.sifang.reading.monitor"), place(1, 0, item, word, meaning)))
        found.append(Candidate(note("protocols.sifang.reading.parameter"), place(2, group, item, word, meaning)))
    identity = _identity_reading(data, form, group)
    if identity is not None:
        found.append(Candidate(note("protocols.sifang.reading.identity"), identity))
    if values[1] == Response.PASSWORD and values[2] == State.NOT_READY:
        found.append(Candidate(note("protocols.sifang.reading.echo"), {}))
    return tuple(found)


def _identity_reading(data: bytes, form: Form, group: int) -> dict[str, Any] | None:
    """The class-0 reading where it is one: groups 0-3; of group 0 a known voltage class and decimal power."""
    raw = raw_fields(data, form, IDENTITY)
    if raw is None or group > 3:
        return None
    fields = _identity_fields(raw.values)
    return fields if group or {"voltage_class", "power_kw"}.issubset(fields) else None
