"""Description of a frame for people and for JSON: the result of every protocol's ``describe``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from drivebus.errors import LengthError, ProtocolError, TrailingError
from drivebus.protocols.codec import Codec, DecodeResult, Incomplete

FrameDirection = Literal["request", "response"]
Note = tuple[str, Mapping[str, Any]]
"""An i18n key and its parameters."""


@dataclass(frozen=True, slots=True)
class Interpretation:
    """Possible meaning of a reply whose request is not known."""

    note: Note
    fields: Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameDescription:
    """Description of one frame."""

    family: str
    encoding: str
    direction: FrameDirection
    valid: bool
    """A tolerant reader of this direction takes the bytes as one whole frame."""
    fields: Mapping[str, Any] = field(default_factory=dict)
    problems: tuple[Note, ...] = ()
    """Reasons why the frame is not valid."""
    errata: tuple[Note, ...] = ()
    """Differences from ``canonical``."""
    hazards: tuple[Note, ...] = ()
    """Effects of the frame that its form does not suggest."""
    canonical: bytes | None = None
    """Bytes that a correct sender emits for this message; None where it would not send it."""
    interpretations: tuple[Interpretation, ...] = ()


def note(key: str, **params: Any) -> Note:
    """Return a note: its sentence is looked up when the language is known."""
    return key, params


def error_note(error: ProtocolError) -> Note:
    """Return the note of a protocol error."""
    return error.key, error.params


def whole_message(result: DecodeResult, data: bytes) -> Any:
    """Return the message of bytes that are exactly one frame. Raises LengthError or TrailingError for all others."""
    if isinstance(result, Incomplete):
        raise LengthError("protocols.length", expected=result.need, found=len(data))
    check_size(result.size, data)
    return result.message


def decode_frame(
    codec: Codec, data: bytes, direction: FrameDirection, request: bytes | None, fitting_request: Callable[[bytes], Any]
) -> Any:
    """Return the message of bytes that are exactly one frame. Raises ProtocolError for all others.

    A response is decoded as the reply to ``request``, or without one as the reply to ``fitting_request(data)``.
    """
    if direction == "request":
        return whole_message(codec.decode_request(data), data)
    sent = fitting_request(data) if request is None else whole_message(codec.decode_request(request), request)
    return whole_message(codec.decode_reply(sent, data), data)


def check_size(size: int, data: bytes) -> None:
    """Raise LengthError or TrailingError where the bytes are fewer or more than a frame of this size has."""
    if len(data) < size:
        raise LengthError("protocols.length", expected=size, found=len(data))
    if len(data) > size:
        raise TrailingError("protocols.trailing", expected=size, found=len(data))
