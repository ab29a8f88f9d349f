"""Frames on the wire for people: bytes and meaning, decoded only when somebody looks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from drivebus import i18n
from drivebus.bus.trace import Kind
from drivebus.commissioning import wording
from drivebus.commissioning.explain import explain
from drivebus.errors import DrivebusError
from drivebus.plant.failure import both
from drivebus.plant.lines import Line, Seen
from drivebus.protocols.describe import Description

Json = dict[str, Any]
KEPT = 4096
"""So many meanings are remembered."""
EXPLAINED = (Kind.SENT, Kind.REPLY)


def frame_json(line: Line, seen: Seen) -> Json:
    """One frame. ``time_ms`` is a label, ``time_s`` monotonic."""
    number, time_ms, event = seen
    error = event.error
    return {
        "n": number, "time_ms": time_ms, "time_s": round(event.time, 6), "kind": event.kind.value,
        "station": event.station, "hex": event.data.hex(" ").upper(), "text": _text(line, seen),
        "error": None if not isinstance(error, DrivebusError) else _error(error),
    }  # fmt: skip


def _error(error: DrivebusError) -> Json:
    return {"code": error.key, "text": both(error.key, error.params)}


@dataclass(frozen=True, slots=True)
class Framed:
    """A frame that is told when somebody takes it."""

    line: Line
    seen: Seen

    def json(self, now: float) -> Json:
        return frame_json(self.line, self.seen)


def _text(line: Line, seen: Seen) -> Json:
    """What it says; what is not ours to read is named by its kind only."""
    event = seen.event
    profile = next((unit.profile for unit in line.units.values() if unit.setting.address == event.station), None)
    if profile is None or not event.data or event.kind not in EXPLAINED:
        return both(f"plant.frame_{event.kind.value}")
    return dict(_told(profile.source or profile.model, event.data, event.kind is Kind.SENT))


@lru_cache(maxsize=KEPT)
def _told(model: str, data: bytes, asked: bool) -> Json:
    """Polls say the same again and again."""
    try:
        found = explain(model, data, direction="request" if asked else "response")
    except DrivebusError as error:
        return both(error.key, error.params)
    return {language: _sentence(found, language) for language in i18n.LANGUAGES}


def _sentence(found: Description, language: str) -> str:
    """Its fields in a row, and what is wrong with it."""
    fields = [_field(name, value, language) for name, value in found.fields.items()]
    notes = [i18n.text(key, language, **params) for key, params in (*found.problems, *found.hazards)]
    comma, semicolon = (i18n.text(f"decode.{sign}", language) for sign in ("comma", "semicolon"))
    return semicolon.join([comma.join(fields), *notes])


def _field(name: str, value: Any, language: str) -> str:
    return f"{wording.label(name, language)} {_shown(name, value, language)}"


def _shown(name: str, value: Any, language: str) -> str:
    if isinstance(value, dict):
        return ", ".join(_field(one, each, language) for one, each in value.items())
    if isinstance(value, list | tuple):
        return " ".join(_shown(name, each, language) for each in value)
    said = wording.word(name, value, language)
    return str(getattr(value, "value", value)) if said is None else said
