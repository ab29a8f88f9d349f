"""What a Modbus frame says, for people: a tolerant reader beside the strict codecs, which it asks first.

It forgives lower-case digits, reads a reply without its request, and shows the fields of a frame whose check is wrong;
it says so each time. What a register means is not known here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from drivebus.errors import AlphabetError, ChecksumError, CodeError, LengthError, ProtocolError
from drivebus.message import Complete, Incomplete
from drivebus.protocols.checksum import crc16, hex_bytes
from drivebus.protocols.describe import Candidate, Description, Direction, check_whole, note, problem
from drivebus.protocols.modbus import ascii, rtu
from drivebus.protocols.modbus.effects import request_of
from drivebus.protocols.modbus.messages import ECHO_FUNCTIONS, READ_FUNCTIONS, REGISTER_FUNCTIONS
from drivebus.protocols.modbus.pdu import SIX
from drivebus.protocols.modbus.requests import BadRequest
from drivebus.protocols.modbus.rtu import ErrorForm


def describe(
    data: bytes,
    encoding: str,
    direction: Direction | None = None,
    request: bytes | None = None,
    error_form: ErrorForm = "exception",
) -> Description:
    """The frame explained; a response against its ``request``, or without one as what it may be. Never raises.

    Without ``direction`` it is a response where its request is given, else what its shape says; bytes that are a
    request and its echo alike are called a request.
    """
    if direction is None and request is None:
        return _either(data, encoding, error_form)
    return _one(data, encoding, direction or "response", request, error_form)


def _either(data: bytes, encoding: str, error_form: ErrorForm) -> Description:
    asked = _one(data, encoding, "request", None, error_form)
    answered = _one(data, encoding, "response", None, error_form)
    reads = answered.fields.get("function") in READ_FUNCTIONS or "exception" in answered.fields
    fits = answered.valid or (reads and answered.problems[0][0] in ("modbus.crc", "modbus.lrc"))
    return answered if fits and not asked.valid else asked


def _one(data: bytes, encoding: str, way: Direction, request: bytes | None, error_form: ErrorForm) -> Description:
    try:
        return _read(data, encoding, way, request, error_form)
    except AlphabetError as error:
        if data != data.upper():
            upper = _one(data.upper(), encoding, way, request, error_form)
            return replace(upper, errata=(note("modbus.lower_case"), *upper.errata))
        return Description("modbus", encoding, way, False, problems=(problem(error),))
    except ProtocolError as error:
        shown = isinstance(error, ChecksumError | BadRequest)
        fields = _despite(data, encoding, way) if shown else _head(_octets(data, encoding))
        return Description("modbus", encoding, way, False, fields, (problem(error),))


def _read(
    data: bytes, encoding: str, direction: Direction, request: bytes | None, error_form: ErrorForm
) -> Description:
    codec = rtu.RtuCodec(error_form) if encoding == "rtu" else ascii.AsciiCodec(error_form)
    readings: tuple[Candidate, ...] = ()
    if direction == "request":
        check_whole(codec.decode_request(data), data)
    elif request is not None:
        check_whole(codec.decode_reply(request_of(request, encoding), data), data)
    else:
        _check_alone(data, encoding, error_form)
        readings = _readings(data, encoding)
    fields = fields_of(_octets(data, encoding), direction)
    return Description("modbus", encoding, direction, True, fields, canonical=data, readings=readings)


def _check_alone(data: bytes, encoding: str, error_form: ErrorForm) -> None:
    """A reply without its request: its own fields and its check tell whether it is one."""
    smallest = rtu.ERROR_SIZE if encoding == "rtu" else ascii.ERROR_SIZE
    if len(data) < smallest:
        raise LengthError("protocols.length", expected=smallest, found=len(data))
    octets = data if encoding == "rtu" else hex_bytes(data[1:7], start=1)
    extent = _extent_alone(octets, _is_short_error(data, encoding, error_form), error_form)
    size = extent + rtu.CHECK if encoding == "rtu" else ascii.size_of(extent)
    check_whole(Incomplete(size) if len(data) < size else Complete(None, size), data)
    if encoding == "rtu":
        rtu.checked(data, size)
    else:
        ascii.checked(data)


def _is_short_error(data: bytes, encoding: str, error_form: ErrorForm) -> bool:
    if encoding == "ascii":
        return error_form == "short" and len(data) == ascii.ERROR_SIZE
    return error_form == "short" and len(data) == rtu.ERROR_SIZE and data[2] == 0 and crc16(data) == 0


def _extent_alone(octets: bytes, short: bool, error_form: ErrorForm) -> int:
    function, count = octets[1], octets[2]
    if function & 0x80 or short:
        return 3
    if function in ECHO_FUNCTIONS:
        return SIX.size
    if function not in READ_FUNCTIONS:
        raise CodeError("modbus.unknown_function", expected="1-6, 8, 15, 16", found=function)
    if (count == 0 and error_form != "short") or (function in REGISTER_FUNCTIONS and count % 2):
        raise LengthError("modbus.byte_count", expected=count + 1, found=count)
    return 3 + count


def _octets(data: bytes, encoding: str) -> bytes:
    """What the bytes say, without their check; empty where the digits can't be read."""
    if encoding == "rtu":
        return data[:-2]
    try:
        return hex_bytes(data[1:-4])
    except (AlphabetError, ValueError):
        return b""


def _head(octets: bytes) -> dict[str, Any]:
    return dict(zip(("address", "function"), octets, strict=False))


def _despite(data: bytes, encoding: str, direction: Direction) -> Mapping[str, Any]:
    """The fields as they stand, where the check (or the station) says that they can't be."""
    octets = _octets(data, encoding)
    try:
        return fields_of(octets, direction)
    except (IndexError, ValueError):
        return _head(octets)


def fields_of(octets: bytes, direction: Direction) -> dict[str, Any]:
    """The names and values of a frame's octets. Raises IndexError or ValueError where they are too few."""
    fields, function = _head(octets), octets[1]
    if direction == "response" and function & 0x80:
        return fields | {"function": function & 0x7F, "exception": octets[2]}
    if direction == "response" and len(octets) == 3:
        return fields | {"error": True}
    if direction == "response" and function in REGISTER_FUNCTIONS:
        return fields | {"registers": _words(octets[3:])}
    if direction == "response" and function in READ_FUNCTIONS:
        return fields | {"bits": _bits(octets[3:])}
    register, word = _words(octets[2:6])
    if function == 8:
        return fields | {"sub_function": register, "data": word}
    fields["register"] = register
    if function in (5, 6):
        return fields | {"value": word}
    fields["count"] = word
    if function == 16 and direction == "request":
        fields["values"] = _words(octets[7:])
    elif function == 15 and direction == "request":
        fields["values"] = _bits(octets[7:])[:word]
    return fields


def _words(octets: bytes) -> list[int]:
    if len(octets) % 2:
        raise ValueError("half a register")
    return [int.from_bytes(octets[at : at + 2], "big") for at in range(0, len(octets), 2)]


def _bits(octets: bytes) -> list[bool]:
    return [bool(octet >> place & 1) for octet in octets for place in range(8)]


def _readings(data: bytes, encoding: str) -> tuple[Candidate, ...]:
    """What a reply may answer, as far as its own bytes tell."""
    octets = _octets(data, encoding)
    function = octets[1]
    if function in READ_FUNCTIONS and len(octets) > 3:
        count = octets[2] // 2 if function in REGISTER_FUNCTIONS else 8 * octets[2]
        key = "modbus.reading.registers" if function in REGISTER_FUNCTIONS else "modbus.reading.bits"
        return (Candidate(note(key, count=count), {"function": function, "count": count}),)
    if len(octets) == SIX.size:
        fields = {} if function in (15, 16) else fields_of(octets, "request")
        return (Candidate(note("modbus.reading.echo"), fields),)
    if function == 6 and encoding == "rtu":
        fields = {"function": 6, "register": data[3], "value_high_byte": data[4]}
        return (Candidate(note("modbus.reading.cut_echo", register=data[3], high=data[4]), fields),)
    return ()
