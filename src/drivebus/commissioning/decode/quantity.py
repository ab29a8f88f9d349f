"""A raw word as the quantity that a profile says it is."""

from __future__ import annotations

from typing import Any

from drivebus.profiles import DriveProfile
from drivebus.profiles.model import Locator, Parameter, Signal
from drivebus.protocols.describe import Note

FieldDict = dict[str, Any]
Annotations = tuple[FieldDict, tuple[Note, ...], tuple[Note, ...]]
"""Fields, errata and hazards that a profile adds to a described frame."""
ProfileEntry = Signal | Parameter


def entries(profile: DriveProfile) -> list[ProfileEntry]:
    """All signals and parameters of a model."""
    return [*profile.signals.values(), *profile.parameters.values()]


def entry_at(profile: DriveProfile, locator: Locator) -> ProfileEntry | None:
    """What the profile lists at an address."""
    return next((entry for entry in entries(profile) if entry.locator == locator), None)


def scaled_value(entry: ProfileEntry, word: int) -> float | None:
    """The quantity of a word; None where it is no number of this coding."""
    try:
        return entry.scale.value(word)
    except ValueError:
        return None


def quantity_fields(
    entry: ProfileEntry | None, word: int | None, *, name: str = "scaled", frequency: bool = True
) -> FieldDict:
    """``frequency_hz`` where it is one, else a text with unit under ``name``; nothing where nothing is known."""
    if entry is None or word is None or not entry.unit:
        return {}
    value = scaled_value(entry, word)
    if value is None:
        return {}
    if entry.unit == "Hz" and frequency:
        return {"frequency_hz": value}
    return {name: f"{value:.{entry.scale.decimals}f} {entry.unit}"}
