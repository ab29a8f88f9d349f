"""What a profile adds to a described frame: notation, scaled values, command names, and what is dangerous about it.

Added fields: ``scaled`` (C320) or ``value`` (DZB100), a text with unit; ``frequency_hz_by_coding`` (DZB100, T08);
``fault`` (the keypad's label); for Modbus what ``registers`` says.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any, Final

from drivebus.commissioning import registers
from drivebus.commissioning.quantity import Added, Fields, entries, entry_at, quantity
from drivebus.profiles import DriveProfile
from drivebus.protocols import dzb, sifang
from drivebus.protocols.describe import Description


def add(profile: DriveProfile, found: Description, asked: Mapping[str, Any] | None) -> Description:
    """The description with what the profile knows of its fields. ``asked``: the fields of its request, if known."""
    fields, errata, hazards = _ADDERS[profile.family](profile, found, asked or {})
    return replace(
        found,
        fields={**found.fields, **fields},
        errata=(*found.errata, *errata),
        hazards=(*found.hazards, *hazards),
    )


def of_sifang(profile: DriveProfile) -> sifang.Meaning:
    """What the C320 reader must know of a model: the frequency step and which values are frequencies."""
    hertz = [entry.locator for entry in entries(profile) if entry.unit == "Hz"]
    return sifang.Meaning(
        profile.setpoint_scale.factor,
        frozenset(index for space, index in hertz if space == "monitor"),
        frozenset((index >> 8, index & 0xFF) for space, index in hertz if space == "parameter"),
        "bcd" if profile.settings.get("monitor_index") == "bcd" else "binary",
    )


def of_dzb(profile: DriveProfile) -> dzb.Meaning:
    """What the DZB100 reader must know: the codings that are settled, the default where they are not (T08)."""
    return dzb.Meaning(
        _coding(profile, "setpoint_coding") or "hex-0.1",
        _coding(profile, "query_coding") or "hex-0.1",
        "hex" if profile.settings.get("fault_coding") == "hex" else "decimal",
        _coding(profile, "setpoint_coding") is not None,
    )


def _coding(profile: DriveProfile, setting: str) -> dzb.FrequencyCoding | None:
    chosen = profile.settings.get(setting)
    return next((coding for coding in dzb.FREQUENCY_CODINGS if coding == chosen), None)


def _sifang(profile: DriveProfile, found: Description, asked: Mapping[str, Any]) -> Added:
    """The protocol's reader has named parameter, monitor and frequency; other quantities and faults are added."""
    fields, added = found.fields, Fields()
    notation = fields.get("parameter") or fields.get("monitor")
    entry = next((entry for entry in entries(profile) if entry.notation == notation), None)
    if entry is not None and entry.unit != "Hz":
        added |= quantity(entry, fields.get("data"))
    return added | _fault(profile, fields), (), ()


def _dzb(profile: DriveProfile, found: Description, asked: Mapping[str, Any]) -> Added:
    """The protocol's reader has judged setpoints and queried frequencies; parameters get their value with its unit."""
    fields, added = found.fields, _fault(profile, found.fields)
    word, head = fields.get("data"), fields.get("head")
    if word is None or (head == "C" and "frequency_hz" not in fields):
        return added, (), ()
    if head == "C":
        return added | _by_coding(word), (), ()
    space, index = ("query", fields.get("item")) if head == "Q" else ("parameter", fields.get("parameter"))
    entry = None if index is None else entry_at(profile, (space, index))
    if entry is not None and entry.unit == "Hz":
        added |= _by_coding(word)
    if entry is None or head == "Q":
        return added, (), ()
    coding = _coding(profile, "parameter_coding")
    if entry.unit == "Hz" and coding is not None:
        return added | _in_hertz(word, coding), (), ()
    return added | quantity(entry, word, name="value", frequency=False), (), ()


def _by_coding(word: int) -> Fields:
    """What the word is under each coding that the drive might have."""
    every: dict[str, float] = {}
    for coding in dzb.FREQUENCY_CODINGS:
        with suppress(ValueError):
            every[coding] = dzb.decode_frequency(word, coding)
    return Fields(frequency_hz_by_coding=every)


def _in_hertz(word: int, coding: dzb.FrequencyCoding) -> Fields:
    try:
        return Fields(value=f"{dzb.decode_frequency(word, coding):g} Hz")
    except ValueError:
        return Fields()


def _fault(profile: DriveProfile, fields: Mapping[str, Any]) -> Fields:
    code = fields.get("fault_code")
    return Fields(fault=profile.fault(code).label) if code else Fields()


_ADDERS: Final[Mapping[str, Callable[[DriveProfile, Description, Mapping[str, Any]], Added]]] = {
    "sifang": _sifang,
    "dzb": _dzb,
    "modbus": registers.meaning,
}
