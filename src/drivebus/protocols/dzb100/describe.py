"""Descriptions of DZB100 frames for people: fields, errata, hazards. The codec decides validity."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

from drivebus.errors import ProtocolError
from drivebus.protocols.codec import Complete
from drivebus.protocols.describe import (
    FrameDescription,
    FrameDirection,
    Interpretation,
    Note,
    error_note,
    note,
    whole_message,
)
from drivebus.protocols.dzb100.codec import (
    ACK_DONE,
    ACK_REFUSED,
    FRAME_SIZE,
    HEADS,
    MARK_ALL,
    MARK_ONE,
    Dzb100Codec,
    check_head,
    parse_digits,
    parse_reply,
)
from drivebus.protocols.dzb100.messages import (
    COMMAND_BY_CODE,
    FREQUENCY_CODINGS,
    LAST_PARAMETER,
    LAST_QUERY_ITEM,
    Dzb100Command,
    Dzb100Control,
    Dzb100Query,
    Dzb100ReadParameter,
    Dzb100Request,
    FaultCoding,
    FrequencyCoding,
    StateWord,
    decode_frequency,
)
from drivebus.values import bilingual_text

MAINS_HZ = 50.0
"""A setpoint above the mains frequency suggests that the coding is wrong by a factor of ten."""
_EXAMPLE_1_FRAME = b"C\x03\x01010103E8"
"""The manual's first example, which calls this word 10.0 Hz."""
_CODEC = Dzb100Codec()


@dataclass(frozen=True, slots=True)
class Dzb100DecodeOptions:
    """Codings that a profile names; until the setpoint coding is known, descriptions warn of the others."""

    setpoint_coding: FrequencyCoding = "hex-0.1"
    query_coding: FrequencyCoding = "hex-0.1"
    fault_coding: FaultCoding = "decimal"
    setpoint_coding_known: bool = False


DEFAULT_DECODE_OPTIONS = Dzb100DecodeOptions()


def describe(
    data: bytes,
    encoding: str | None = None,
    direction: FrameDirection | None = None,
    request: bytes | None = None,
    options: Dzb100DecodeOptions = DEFAULT_DECODE_OPTIONS,
) -> FrameDescription:
    """Describe a frame; a reply against its ``request`` frame where given. Never raises for any bytes.

    Without ``direction`` byte 2 decides: 01 and 02 are requests, and ``interpretations`` lists the reply of head C
    whose state digit they may be.
    """
    guessed = direction is None
    direction = direction or ("request" if request is None and data[2:3] in (b"\x01", b"\x02") else "response")
    problems = _problems(data, direction, request, options)
    fields = _fields(data, direction, options)
    errata: tuple[Note, ...] = ()
    hazards: tuple[Note, ...] = ()
    canonical = None if problems else data
    if direction == "request" and not problems:
        message = _decode_request(data)
        canonical = _canonical_request(message)
        errata, hazards = tuple(_errata(data, message)), _hazards(message, options)
    interpretations = _interpretations(data) if guessed and direction == "request" and not problems else ()
    return FrameDescription(
        family="dzb100",
        encoding="ascii",
        direction=direction,
        valid=not problems,
        fields=fields,
        problems=problems,
        errata=errata,
        hazards=hazards,
        canonical=canonical,
        interpretations=interpretations,
    )


def _interpretations(data: bytes) -> tuple[Interpretation, ...]:
    """List the reply with a state digit in byte B that has the bytes of a C request."""
    if _problems(data, "response", None, DEFAULT_DECODE_OPTIONS):  # of any head but C
        return ()
    fields = {"accepted": None, "digit": data[2]}
    return (Interpretation(note("protocols.dzb100.reading.state_digit", digit=data[2]), fields),)


def _problems(
    data: bytes, direction: FrameDirection, request: bytes | None, options: Dzb100DecodeOptions
) -> tuple[Note, ...]:
    try:
        if direction == "request":
            _decode_request(data)
        elif request is not None:
            whole_message(_CODEC.decode_reply(_decode_request(request), data), data)
        else:
            whole_message(check_head(data) or Complete(parse_reply(data), FRAME_SIZE), data)
        if data[:1] == b"Q":
            _check_state_word(data, options)
    except ProtocolError as error:
        return (error_note(error),)
    return ()


def _decode_request(frame: bytes) -> Dzb100Request:
    request: Dzb100Request = whole_message(_CODEC.decode_request(frame), frame)
    return request


def _check_state_word(data: bytes, options: Dzb100DecodeOptions) -> None:
    _, item, word = parse_digits(data)
    if item == 3 and data[2] == ACK_DONE:
        StateWord.parse(word, options.fault_coding)


def _fields(data: bytes, direction: FrameDirection, options: Dzb100DecodeOptions) -> dict[str, Any]:
    """Return the fields as far as the digits can be read, also of an invalid frame."""
    fields: dict[str, Any] = {"head": chr(data[0])} if data and data[0] in HEADS else {}
    if not fields or len(data) < FRAME_SIZE:
        return fields
    try:
        address, index, word = parse_digits(data)
    except ProtocolError:
        return fields
    fields |= _mark_fields(data[0], data[2], direction) | {"address": address}
    if data[0] == Dzb100Control.head:
        return fields | _control_fields(index, word, options)
    if data[0] == ord("Q"):
        return fields | {"item": index} | (_query_fields(index, word, options) if direction == "response" else {})
    fields["parameter"] = index
    return fields if data[0] == ord("R") and direction == "request" else fields | {"data": word}


def _mark_fields(head: int, mark: int, direction: FrameDirection) -> dict[str, Any]:
    if direction == "request":
        return {"broadcast": mark == MARK_ALL} if head == Dzb100Control.head and mark in (MARK_ONE, MARK_ALL) else {}
    if mark in (ACK_DONE, ACK_REFUSED):
        return {"accepted": mark == ACK_DONE}
    return {"accepted": None, "digit": mark & 0x0F}


def _control_fields(index: int, word: int, options: Dzb100DecodeOptions) -> dict[str, Any]:
    command = COMMAND_BY_CODE.get(index % 10)
    fields: dict[str, Any] = {"command": index % 10, "data": word}
    if command is not None:
        fields["command_name"] = command.name.removesuffix("_2").lower()
        if not command.is_stop and command is not Dzb100Command.RESET:
            fields |= _frequency_fields(word, options.setpoint_coding)
    return fields


def _query_fields(item: int, word: int, options: Dzb100DecodeOptions) -> dict[str, Any]:
    fields: dict[str, Any] = {"data": word}
    if item in (0, 1):
        fields |= _frequency_fields(word, options.query_coding)
    if item == 3:
        try:
            state = StateWord.parse(word, options.fault_coding)
        except ProtocolError:
            return fields
        fields |= {"command": state.command, "state": state.state, "fault_code": state.fault_code}
    return fields


def _frequency_fields(word: int, coding: FrequencyCoding) -> dict[str, float]:
    try:
        return {"frequency_hz": decode_frequency(word, coding)}
    except ValueError:
        return {}


def _canonical_request(request: Dzb100Request) -> bytes | None:
    """Return the canonical frame of this request; None where the codec can't encode it."""
    if isinstance(request, Dzb100Control) and request.broadcast and request.command.is_stop:
        request = replace(request, address=0)
    try:
        return _CODEC.encode_request(request)
    except ValueError:
        return None


def _errata(data: bytes, request: Dzb100Request) -> Iterator[Note]:
    """Yield what a correct sender writes otherwise, and the misprint of the manual."""
    address, index, word = parse_digits(data)
    if isinstance(request, Dzb100Control):
        if index != request.command:
            yield note("protocols.dzb100.erratum.command", found=index)
        if word and (request.command.is_stop or request.command is Dzb100Command.RESET):
            yield note("protocols.dzb100.erratum.stop_data", found=f"{word:04X}H")
        if request.broadcast and address:
            yield note("protocols.dzb100.erratum.broadcast", found=address)
    elif isinstance(request, Dzb100Query) and index > LAST_QUERY_ITEM:
        yield note("protocols.dzb100.erratum.item", found=index)
    elif index > LAST_PARAMETER:
        yield note("protocols.dzb100.erratum.parameter", found=index)
    if word and isinstance(request, Dzb100Query | Dzb100ReadParameter):
        yield note("protocols.dzb100.erratum.read_data", found=f"{word:04X}H")
    if address == 0 and data[2] == MARK_ONE:
        yield note("protocols.dzb100.erratum.address_0")
    if data == _EXAMPLE_1_FRAME:
        yield note("protocols.dzb100.erratum.example_1")


def _hazards(request: Dzb100Request, options: Dzb100DecodeOptions) -> tuple[Note, ...]:
    if isinstance(request, Dzb100Control):
        return _control_hazards(request, options)
    if request.head == ord("P") and request.data == 0:
        return (note("protocols.dzb100.hazard.write_of_zero", parameter=request.index),)
    return ()


def _control_hazards(request: Dzb100Control, options: Dzb100DecodeOptions) -> tuple[Note, ...]:
    if request.command.is_stop or request.command is Dzb100Command.RESET:
        return (note("protocols.dzb100.hazard.carries_frequency", found=request.data),) if request.data else ()
    hz = _frequency_fields(request.data, options.setpoint_coding).get("frequency_hz", 0.0)
    if options.setpoint_coding_known or hz <= MAINS_HZ:
        return ()
    others = (
        f"{value:g} ({coding})"
        for coding in FREQUENCY_CODINGS
        for value in _frequency_fields(request.data, coding).values()
    )
    coding = bilingual_text(coding_key(options.setpoint_coding))
    return (note("protocols.dzb100.hazard.tenfold", frequency_hz=hz, coding=coding, readings=tuple(others)),)


def coding_key(coding: str) -> str:
    """Return the i18n key of a coding's label."""
    return "decode.field." + coding.replace("-", "_").replace(".", "_")
