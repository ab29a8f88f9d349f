"""``frame_json``: traced frames as JSON, decoded only when a client reads them."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from drivebus import i18n
from drivebus.bus.trace import TraceKind
from drivebus.commissioning.decode import labels
from drivebus.commissioning.decode.describe import describe_frame
from drivebus.errors import DrivebusError
from drivebus.profiles.model import DriveProfile
from drivebus.protocols.describe import FrameDescription
from drivebus.service.api.errors import localized
from drivebus.service.runtime.bus import BusRuntime, TracedFrame
from drivebus.types import Json

DECODE_CACHE_SIZE = 4096  # polls repeat the same frames
DECODED_KINDS = (TraceKind.SENT, TraceKind.REPLY)


def frame_json(bus: BusRuntime, frame: TracedFrame) -> Json:
    """Return one frame; ``time_ms`` is the wall clock, ``time_s`` the monotonic one."""
    number, time_ms, event = frame
    error = event.error
    return {
        "n": number,
        "time_ms": time_ms,
        "time_s": round(event.time, 6),
        "kind": event.kind.value,
        "station": event.station,
        "hex": event.data.hex(" ").upper(),
        "text": _frame_text(bus, frame),
        "error": None if not isinstance(error, DrivebusError) else _error(error),
    }


def _error(error: DrivebusError) -> Json:
    return {"code": error.key, "text": localized(error.key, error.params)}


def _frame_text(bus: BusRuntime, frame: TracedFrame) -> Json:
    """Return the fields of a frame by the profile of its drive; only the kind of one that has no drive on this bus."""
    event = frame.event
    profile = next((drive.profile for drive in bus.drives.values() if drive.config.address == event.station), None)
    if profile is None or not event.data or event.kind not in DECODED_KINDS:
        return localized(f"plant.frame_{event.kind.value}")
    return dict(_decode(profile, event.data, is_request=event.kind is TraceKind.SENT))


@lru_cache(maxsize=DECODE_CACHE_SIZE)
def _decode(profile: DriveProfile, data: bytes, *, is_request: bool) -> Json:
    """Return the text of a frame. No file is read: a read delays the buses, and the file may have changed since."""
    try:
        description = describe_frame(profile, data, direction="request" if is_request else "response")
    except DrivebusError as error:
        return localized(error.key, error.params)
    return {language: _describe(description, language) for language in i18n.LANGUAGES}


def _describe(description: FrameDescription, language: str) -> str:
    """Return the fields, then the problems of a frame."""
    fields = [_field_text(name, value, language) for name, value in description.fields.items()]
    notes = [i18n.text(key, language, **params) for key, params in (*description.problems, *description.hazards)]
    return i18n.join([i18n.join(fields, "phrases", language), *notes], "clauses", language)


def _field_text(name: str, value: Any, language: str) -> str:
    return f"{labels.field_label(name, language)} {_value_text(name, value, language)}"


def _value_text(name: str, value: Any, language: str) -> str:
    if isinstance(value, dict):
        return i18n.join((_field_text(inner, item, language) for inner, item in value.items()), "phrases", language)
    if isinstance(value, list | tuple):
        return " ".join(_value_text(name, item, language) for item in value)
    text = labels.value_text(name, value, language)
    return str(getattr(value, "value", value)) if text is None else text
