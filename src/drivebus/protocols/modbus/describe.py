"""Descriptions of Modbus frames for people: a tolerant reader that first tries the strict codecs.

It also reads lower-case digits, a reply without its request, and the fields of a frame with a wrong check, and reports
each as an erratum or a problem. The meaning of registers comes from the profile.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from drivebus.errors import AlphabetError, ChecksumError, CodeError, LengthError, ProtocolError
from drivebus.protocols.checksum import crc16, hex_bytes
from drivebus.protocols.describe import (
    FrameDescription,
    FrameDirection,
    Interpretation,
    check_size,
    error_note,
    note,
    whole_message,
)
from drivebus.protocols.modbus import ascii, rtu
from drivebus.protocols.modbus.classify import parse_request_frame
from drivebus.protocols.modbus.messages import ECHO_FUNCTIONS, READ_FUNCTIONS, REGISTER_FUNCTIONS
from drivebus.protocols.modbus.pdu import FIXED_PDU, IllegalRequest
from drivebus.protocols.modbus.rtu import ErrorForm


class ReplyForm(NamedTuple):
    """Form of the replies of a station."""

    error_form: ErrorForm
    count_bytes: int
    """Bytes of the byte count in the reply to a read."""


def describe(
    data: bytes,
    encoding: str,
    direction: FrameDirection | None = None,
    request: bytes | None = None,
    error_form: ErrorForm = "exception",  # this and the next one as in ``ModbusRtuCodec``
    count_bytes: int = 1,
) -> FrameDescription:
    """Describe a frame; a response against its ``request``, or without one by its own fields. Never raises.

    Without ``direction`` it is a response where its request is given, else its shape decides; bytes that may be a
    request or its echo are described as a request.
    """
    form = ReplyForm(error_form, count_bytes)
    if direction is None and request is None:
        return _describe_either(data, encoding, form)
    return _describe_as(data, encoding, direction or "response", request, form)


def _describe_either(data: bytes, encoding: str, form: ReplyForm) -> FrameDescription:
    request = _describe_as(data, encoding, "request", None, form)
    response = _describe_as(data, encoding, "response", None, form)
    reads = response.fields.get("function") in READ_FUNCTIONS or "exception" in response.fields
    fits = response.valid or (reads and response.problems[0][0] in ("modbus.crc", "modbus.lrc"))
    return response if fits and not request.valid else request


def _describe_as(
    data: bytes, encoding: str, direction: FrameDirection, request: bytes | None, form: ReplyForm
) -> FrameDescription:
    try:
        return _describe_valid(data, encoding, direction, request, form)
    except AlphabetError as error:
        if data != data.upper():
            upper = _describe_as(data.upper(), encoding, direction, request, form)
            return replace(upper, errata=(note("modbus.lower_case"), *upper.errata))
        return FrameDescription(
            family="modbus", encoding=encoding, direction=direction, valid=False, problems=(error_note(error),)
        )
    except ProtocolError as error:
        shown = isinstance(error, ChecksumError | IllegalRequest)
        fields = (
            _fields_despite_error(data, encoding, direction, form)
            if shown
            else _head_fields(_unchecked_octets(data, encoding))
        )
        return FrameDescription(
            family="modbus",
            encoding=encoding,
            direction=direction,
            valid=False,
            fields=fields,
            problems=(error_note(error),),
        )


def _describe_valid(
    data: bytes, encoding: str, direction: FrameDirection, request: bytes | None, form: ReplyForm
) -> FrameDescription:
    rtu_codec = rtu.ModbusRtuCodec(form.error_form, count_bytes=form.count_bytes)
    codec = rtu_codec if encoding == "rtu" else ascii.ModbusAsciiCodec(form.error_form)
    interpretations: tuple[Interpretation, ...] = ()
    if direction == "request":
        whole_message(codec.decode_request(data), data)
    elif request is not None:
        whole_message(codec.decode_reply(parse_request_frame(request, encoding), data), data)
    else:
        _check_standalone(data, encoding, form)
        interpretations = _interpretations(data, encoding, form)
    fields = decode_fields(_unchecked_octets(data, encoding), direction, form.count_bytes)
    return FrameDescription(
        family="modbus",
        encoding=encoding,
        direction=direction,
        valid=True,
        fields=fields,
        canonical=data,
        interpretations=interpretations,
    )


def _check_standalone(data: bytes, encoding: str, form: ReplyForm) -> None:
    """Check a reply without its request, by its own fields and its check."""
    smallest = rtu.EXCEPTION_FRAME_SIZE if encoding == "rtu" else ascii.EXCEPTION_FRAME_SIZE
    if len(data) < smallest:  # too short to tell its length
        raise LengthError("protocols.length", expected=smallest, found=len(data))
    octets = data if encoding == "rtu" else hex_bytes(data[1:7], start=1)
    extent = _standalone_length(octets, short=_is_short_error(data, encoding, form), form=form)
    size = extent + rtu.CRC_SIZE if encoding == "rtu" else ascii.frame_size(extent)
    check_size(size, data)
    if encoding == "rtu":
        rtu.check_frame(data, size)
    else:
        ascii.check_frame(data)


def _is_short_error(data: bytes, encoding: str, form: ReplyForm) -> bool:
    if encoding == "ascii":
        return form.error_form == "short" and len(data) == ascii.EXCEPTION_FRAME_SIZE
    return form.error_form == "short" and len(data) == rtu.EXCEPTION_FRAME_SIZE and data[2] == 0 and crc16(data) == 0


def _standalone_length(octets: bytes, *, short: bool, form: ReplyForm) -> int:
    function, head = octets[1], 2 + form.count_bytes
    count = int.from_bytes(octets[2:head], "big")
    if function & 0x80 or short:
        return 3
    if function in ECHO_FUNCTIONS:
        sub_function = int.from_bytes(octets[2:4], "big")
        if function == 8 and sub_function:
            raise CodeError("modbus.sub_function", expected=0, found=sub_function)
        return FIXED_PDU.size
    if function not in READ_FUNCTIONS:
        raise CodeError("modbus.unknown_function", expected=("1-6", "8", "15", "16"), found=function)
    if count == 0 and form.error_form != "short":
        raise LengthError("modbus.byte_count", expected=2 if function in REGISTER_FUNCTIONS else 1, found=count)
    if function in REGISTER_FUNCTIONS and count % 2:
        raise LengthError("modbus.odd_byte_count", found=count)
    return head + count


def _unchecked_octets(data: bytes, encoding: str) -> bytes:
    """Return the octets without verifying the check; empty where the digits can't be read."""
    if encoding == "rtu":
        return data[:-2]
    try:
        return hex_bytes(data[1:-4])
    except (AlphabetError, ValueError):
        return b""


def _head_fields(octets: bytes) -> dict[str, Any]:
    return dict(zip(("address", "function"), octets, strict=False))


def _fields_despite_error(data: bytes, encoding: str, direction: FrameDirection, form: ReplyForm) -> Mapping[str, Any]:
    """Return the fields of a frame with a wrong check or of an illegal request."""
    octets = _unchecked_octets(data, encoding)
    try:
        return decode_fields(octets, direction, form.count_bytes)
    except (IndexError, ValueError):
        return _head_fields(octets)


def decode_fields(octets: bytes, direction: FrameDirection, count_bytes: int = 1) -> dict[str, Any]:
    """Return the fields of a frame's octets. Raises IndexError or ValueError where they are too few."""
    fields, function = _head_fields(octets), octets[1]
    if direction == "response" and function & 0x80:
        return fields | {"function": function & 0x7F, "exception": octets[2]}
    if direction == "response" and len(octets) == 3:
        return fields | {"error": True}
    if direction == "response" and function in REGISTER_FUNCTIONS:
        return fields | {"registers": _unpack_words(octets[2 + count_bytes :])}
    if direction == "response" and function in READ_FUNCTIONS:
        return fields | {"bits": _unpack_all_bits(octets[2 + count_bytes :])}
    register, word = _unpack_words(octets[2:6])
    if function == 8:
        return fields | {"sub_function": register, "data": word}
    fields["register"] = register
    if function in (5, 6):
        return fields | {"value": word}
    fields["count"] = word
    if function == 16 and direction == "request":
        fields["values"] = _unpack_words(octets[7:])
    elif function == 15 and direction == "request":
        fields["values"] = _unpack_all_bits(octets[7:])[:word]
    return fields


def _unpack_words(octets: bytes) -> list[int]:
    if len(octets) % 2:
        raise ValueError("half a register")
    return [int.from_bytes(octets[at : at + 2], "big") for at in range(0, len(octets), 2)]


def _unpack_all_bits(octets: bytes) -> list[bool]:
    return [bool(octet >> place & 1) for octet in octets for place in range(8)]


def _interpretations(data: bytes, encoding: str, form: ReplyForm) -> tuple[Interpretation, ...]:
    """List what a reply may answer, as far as its own bytes decide."""
    octets = _unchecked_octets(data, encoding)
    function = octets[1]
    if function in READ_FUNCTIONS and len(octets) > 3:
        size = len(octets) - 2 - form.count_bytes
        count = size // 2 if function in REGISTER_FUNCTIONS else 8 * size
        key = "modbus.reading.registers" if function in REGISTER_FUNCTIONS else "modbus.reading.bits"
        return (Interpretation(note(key, count=count), {"function": function, "count": count}),)
    if len(octets) == FIXED_PDU.size:
        fields = {} if function in (15, 16) else decode_fields(octets, "request")
        return (Interpretation(note("modbus.reading.echo"), fields),)
    if function == 6 and encoding == "rtu":
        fields = {"function": 6, "register": data[3], "value_high_byte": data[4]}
        return (Interpretation(note("modbus.reading.cut_echo", register=data[3], high=data[4]), fields),)
    return ()
