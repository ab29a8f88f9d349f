"""What a frame says, for people and for JSON: the result of every protocol's ``describe``. Values only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from drivebus import i18n
from drivebus.errors import LengthError, ProtocolError, TrailingError
from drivebus.protocols.codec import DecodeResult, Incomplete

Direction = Literal["request", "response"]
Note = tuple[str, Mapping[str, Any]]
"""An i18n key and its params."""


@dataclass(frozen=True, slots=True)
class Interpretation:
    """One thing that a reply may mean where its request is not known."""

    note: Note
    fields: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class FrameDescription:
    """A frame explained. ``valid`` means: a tolerant reader of this direction takes these bytes as one whole frame.

    ``problems`` say why it is not valid; ``errata`` where it differs from what a correct sender emits, which is
    ``canonical``; ``hazards`` what it does besides, or instead of, what it seems to do.
    """

    family: str
    encoding: str
    direction: Direction
    valid: bool
    fields: Mapping[str, Any] = field(default_factory=dict)
    problems: tuple[Note, ...] = ()
    errata: tuple[Note, ...] = ()
    hazards: tuple[Note, ...] = ()
    canonical: bytes | None = None
    readings: tuple[Interpretation, ...] = ()


def note(key: str, **params: Any) -> Note:
    """A sentence to be looked up when the language is known."""
    return key, params


@dataclass(frozen=True, slots=True)
class BilingualText:
    """A name within a note, in both languages; ``i18n.text`` shows its own side."""

    en: str
    zh: str


def bilingual(key: str) -> BilingualText:
    """The words of an i18n key, for a place of a note."""
    return BilingualText(i18n.text(key, "en"), i18n.text(key, "zh"))


def error_note(error: ProtocolError) -> Note:
    """The note of a protocol error."""
    return error.key, error.params


def require_whole_frame(verdict: DecodeResult, data: bytes) -> None:
    """Raises LengthError or TrailingError unless these bytes are exactly the message."""
    if isinstance(verdict, Incomplete):
        raise LengthError("protocols.length", expected=verdict.need, found=len(data))
    if verdict.size != len(data):
        raise TrailingError("protocols.trailing", expected=verdict.size, found=len(data))
