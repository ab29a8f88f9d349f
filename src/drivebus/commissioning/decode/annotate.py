"""Names, units and scaled values of a profile for the fields of a described frame, shared by all families."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from drivebus.profiles import DriveProfile
from drivebus.profiles.model import Parameter, Signal
from drivebus.protocols.describe import FrameDescription, Note

FieldDict = dict[str, Any]
ProfileEntry = Signal | Parameter


def annotate(
    description: FrameDescription, fields: FieldDict, errata: tuple[Note, ...] = (), hazards: tuple[Note, ...] = ()
) -> FrameDescription:
    """Return the description with more fields, errata and hazards."""
    return replace(
        description,
        fields={**description.fields, **fields},
        errata=(*description.errata, *errata),
        hazards=(*description.hazards, *hazards),
    )


def scaled_value(entry: ProfileEntry, word: int) -> float | None:
    """Return the scaled value of a word; None where the word is no number of its coding."""
    try:
        return entry.scale.value(word)
    except ValueError:
        return None


def quantity_fields(
    entry: ProfileEntry | None, word: int | None, *, name: str = "scaled", frequency: bool = True
) -> FieldDict:
    """Return ``frequency_hz`` for a frequency, else a text with unit under ``name``; nothing for an unknown unit."""
    if entry is None or word is None or not entry.unit:
        return {}
    value = scaled_value(entry, word)
    if value is None:
        return {}
    if entry.unit == "Hz" and frequency:
        return {"frequency_hz": value}
    return {name: f"{value:.{entry.scale.decimals}f} {entry.unit}"}


def fault_fields(profile: DriveProfile, fields: Mapping[str, Any]) -> FieldDict:
    """Return the keypad's label and the text of the fault code, if there is one, and its cause and remedy if known."""
    code = fields.get("fault_code")
    if not code:
        return FieldDict()
    fault = profile.fault(code)
    advice = {"fault_cause": fault.cause, "fault_remedy": fault.remedy}
    label_and_text = FieldDict(fault=fault.label, fault_text=fault.text)
    return label_and_text | FieldDict(**{name: text for name, text in advice.items() if text})


def broadcast_field(profile: DriveProfile, description: FrameDescription) -> FieldDict:
    """Return ``broadcast`` for a request to every drive at once."""
    is_broadcast = profile.broadcast is not None and description.fields.get("address") == profile.broadcast
    return FieldDict(broadcast=True) if is_broadcast and description.direction == "request" else FieldDict()
