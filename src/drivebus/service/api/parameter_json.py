"""Readings of parameters as JSON, and where a parameter lives."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from drivebus.errors import ProfileError
from drivebus.profiles.model import DriveProfile
from drivebus.profiles.notation import find_entry
from drivebus.protocols.family import Locator
from drivebus.values import Reading

Json = dict[str, Any]


def reading_json(reading: Reading) -> Json:
    return {
        "raw": reading.raw,
        "value": reading.value,
        "unit": reading.unit,
        "quality": str(reading.quality),
        "reason": reading.reason,
    }


def readings_json(profile: DriveProfile, found: Mapping[str, Reading]) -> Json:
    """Readings by any of their names, each with its wire address."""
    return {name: reading_json(one) | {"address_hex": address_hex(profile, name)} for name, one in found.items()}


def address_hex(profile: DriveProfile, name: str) -> str | None:
    """The wire address of a parameter or signal by any of its names; None where nobody knows it."""
    try:
        return locator_hex(find_entry(profile, name).locator)
    except ProfileError:
        return None


def locator_hex(locator: Locator) -> str:
    return f"{locator[1]:04X}H"
