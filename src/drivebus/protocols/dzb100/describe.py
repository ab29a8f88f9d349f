"""What a DZB100 frame says, for people. The codec judges; this module only shows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from drivebus.errors import ProtocolError
from drivebus.protocols.codec import Complete
from drivebus.protocols.describe import (
    Direction,
    FrameDescription,
    Interpretation,
    Note,
    bilingual,
    error_note,
    note,
    require_whole_frame,
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
from drivebus.protocols.dzb100.messages import COMMAND_BY_CODE, Dzb100Command, Dzb100Control, Dzb100Request
from drivebus.protocols.dzb100.values import (
    FREQUENCY_CODINGS,
    FaultCoding,
    FrequencyCoding,
    StateWord,
    decode_frequency,
)

MAINS_HZ = 50.0
"""A setpoint that reads above it deserves a second look at the coding (T08)."""
_EXAMPLE_1_FRAME = b"C\x03\x01010103E8"
"""The manual's first example, which calls this 10.0 Hz."""
_CODEC = Dzb100Codec()


@dataclass(frozen=True, slots=True)
class Dzb100DecodeOptions:
    """What a profile's settings add. The default coding of all three is unsettled hex-0.1."""

    setpoint_coding: FrequencyCoding = "hex-0.1"
    query_coding: FrequencyCoding = "hex-0.1"
    fault_coding: FaultCoding = "decimal"
    setpoint_settled: bool = False


DEFAULT_DECODE_OPTIONS = Dzb100DecodeOptions()


def describe(
    data: bytes,
    encoding: str | None = None,
    direction: Direction | None = None,
    request: bytes | None = None,
    meaning: Dzb100DecodeOptions = DEFAULT_DECODE_OPTIONS,
) -> FrameDescription:
    """The frame explained; a response against its ``request`` frame where given. Never raises for any bytes.

    Without ``direction`` byte 2 tells: 01 and 02 are requests; in a C frame they may be a reply's state digits as well,
    which ``readings`` then says (T20).
    """
    guessed = direction is None
    direction = direction or ("request" if request is None and data[2:3] in (b"\x01", b"\x02") else "response")
    problems = _problems(data, direction, request, meaning)
    fields = _fields(data, direction, meaning)
    errata, hazards, emitted = (), (), None if problems else data
    if direction == "request" and not problems:
        sent = _CODEC.decode_request(data).message  # type: ignore[union-attr]
        emitted = _canonical_request(sent)
        errata, hazards = _errata(data, emitted), _hazards(sent, meaning)  # type: ignore[assignment]
    readings = _interpretations(data) if guessed and direction == "request" and not problems else ()
    return FrameDescription(
        "dzb100", "ascii", direction, not problems, fields, problems, errata, hazards, emitted, readings
    )


def _interpretations(data: bytes) -> tuple[Interpretation, ...]:
    """A C request to one drive has the bytes of a reply that puts its state digit into B [OPEN]."""
    if _problems(data, "response", None, DEFAULT_DECODE_OPTIONS):  # of any head but C
        return ()
    fields = {"accepted": None, "digit": data[2]}
    return (Interpretation(note("protocols.dzb.reading.state_digit", digit=data[2]), fields),)


def _problems(
    data: bytes, direction: Direction, request: bytes | None, meaning: Dzb100DecodeOptions
) -> tuple[Note, ...]:
    try:
        if direction == "request":
            require_whole_frame(_CODEC.decode_request(data), data)
        elif request is not None:
            require_whole_frame(_CODEC.decode_reply(_decode_request(request), data), data)
        else:
            require_whole_frame(check_head(data) or Complete(parse_reply(data), FRAME_SIZE), data)
        if data[:1] == b"Q":
            _check_state_word(data, meaning)
    except ProtocolError as error:
        return (error_note(error),)
    return ()


def _decode_request(request: bytes) -> Dzb100Request:
    verdict = _CODEC.decode_request(request)
    require_whole_frame(verdict, request)
    asked: Dzb100Request = verdict.message  # type: ignore[union-attr]
    return asked


def _check_state_word(data: bytes, meaning: Dzb100DecodeOptions) -> None:
    _, item, word = parse_digits(data)
    if item == 3 and data[2] == ACK_DONE:
        StateWord.parse(word, meaning.fault_coding)


def _fields(data: bytes, direction: Direction, meaning: Dzb100DecodeOptions) -> dict[str, Any]:
    """As far as the digits can be read, also where something else is wrong."""
    fields: dict[str, Any] = {"head": chr(data[0])} if data and data[0] in HEADS else {}
    if not fields or len(data) < FRAME_SIZE:
        return fields
    try:
        address, index, word = parse_digits(data)
    except ProtocolError:
        return fields
    fields |= _mark_fields(data[0], data[2], direction) | {"address": address}
    if data[0] == Dzb100Control.head:
        return fields | _control_fields(index, word, meaning)
    if data[0] == ord("Q"):
        return fields | {"item": index} | (_query_fields(index, word, meaning) if direction == "response" else {})
    fields["parameter"] = index
    return fields if data[0] == ord("R") and direction == "request" else fields | {"data": word}


def _mark_fields(head: int, mark: int, direction: Direction) -> dict[str, Any]:
    if direction == "request":
        return {"broadcast": mark == MARK_ALL} if head == Dzb100Control.head and mark in (MARK_ONE, MARK_ALL) else {}
    if mark in (ACK_DONE, ACK_REFUSED):
        return {"accepted": mark == ACK_DONE}
    return {"accepted": None, "digit": mark & 0x0F}


def _control_fields(index: int, word: int, meaning: Dzb100DecodeOptions) -> dict[str, Any]:
    command = COMMAND_BY_CODE.get(index % 10)
    fields: dict[str, Any] = {"command": index % 10, "data": word}
    if command is not None:
        fields["command_name"] = command.name.removesuffix("_2").lower()
        if not command.is_stop and command is not Dzb100Command.RESET:
            fields |= _frequency_fields(word, meaning.setpoint_coding)
    return fields


def _query_fields(item: int, word: int, meaning: Dzb100DecodeOptions) -> dict[str, Any]:
    fields: dict[str, Any] = {"data": word}
    if item in (0, 1):
        fields |= _frequency_fields(word, meaning.query_coding)
    if item == 3:
        try:
            state = StateWord.parse(word, meaning.fault_coding)
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
    """What a correct host sends for this; None where it would not send it at all."""
    try:
        return _CODEC.encode_request(request)
    except ValueError:
        return None


def _errata(data: bytes, emitted: bytes | None) -> tuple[Note, ...]:
    found = [] if data == emitted else [note("protocols.dzb.erratum.not_canonical")]
    if data == _EXAMPLE_1_FRAME:
        found.append(note("protocols.dzb.erratum.example_1"))
    return tuple(found)


def _hazards(request: Dzb100Request, meaning: Dzb100DecodeOptions) -> tuple[Note, ...]:
    if isinstance(request, Dzb100Control):
        return _control_hazards(request, meaning)
    if request.head == ord("P") and request.data == 0:
        return (note("protocols.dzb.hazard.write_of_zero", parameter=request.index),)
    return ()


def _control_hazards(request: Dzb100Control, meaning: Dzb100DecodeOptions) -> tuple[Note, ...]:
    if request.command.is_stop or request.command is Dzb100Command.RESET:
        return (note("protocols.dzb.hazard.carries_frequency", found=request.data),) if request.data else ()
    hz = _frequency_fields(request.data, meaning.setpoint_coding).get("frequency_hz", 0.0)
    if meaning.setpoint_settled or hz <= MAINS_HZ:
        return ()
    others = (
        f"{value:g} ({coding})"
        for coding in FREQUENCY_CODINGS
        for value in _frequency_fields(request.data, coding).values()
    )
    coding = bilingual(coding_key(meaning.setpoint_coding))
    return (note("protocols.dzb.hazard.tenfold", frequency_hz=hz, coding=coding, readings=", ".join(others)),)


def coding_key(coding: str) -> str:
    """The i18n key of what a coding is called, its name of the settings beside it."""
    return "protocols.dzb.coding." + coding.replace("-", "_").replace(".", "_")
