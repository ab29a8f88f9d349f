"""What a profile adds to a described frame: notation, scaled values, command names, and what is dangerous about it.

Added fields: ``scaled`` (C320) or ``value`` (DZB100), a text with unit; ``frequency_hz_by_coding`` (DZB100, T08);
``fault`` (the keypad's label); for Modbus what ``registers`` says.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any, Final

from drivebus.commissioning.decode import registers
from drivebus.commissioning.decode.quantity import Annotations, FieldDict, entries, entry_at, quantity_fields
from drivebus.profiles import DriveProfile
from drivebus.protocols import dzb100, sunfar
from drivebus.protocols.describe import FrameDescription


def annotate(profile: DriveProfile, found: FrameDescription, asked: Mapping[str, Any] | None) -> FrameDescription:
    """The description with what the profile knows of its fields. ``asked``: the fields of its request, if known."""
    fields, errata, hazards = _ANNOTATORS[profile.family](profile, found, asked or {})
    return replace(
        found,
        fields={**found.fields, **fields},
        errata=(*found.errata, *errata),
        hazards=(*found.hazards, *hazards),
    )


def sunfar_decode_options(profile: DriveProfile) -> sunfar.SunfarDecodeOptions:
    """What the C320 reader must know of a model: the frequency step and which values are frequencies."""
    hertz = [entry.locator for entry in entries(profile) if entry.unit == "Hz"]
    return sunfar.SunfarDecodeOptions(
        profile.setpoint_scale.factor,
        frozenset(index for space, index in hertz if space == "monitor"),
        frozenset((index >> 8, index & 0xFF) for space, index in hertz if space == "parameter"),
        "bcd" if profile.settings.get("monitor_index") == "bcd" else "binary",
    )


def dzb100_decode_options(profile: DriveProfile) -> dzb100.Dzb100DecodeOptions:
    """What the DZB100 reader must know: the codings that are settled, the default where they are not (T08)."""
    return dzb100.Dzb100DecodeOptions(
        _settled_coding(profile, "setpoint_coding") or "hex-0.1",
        _settled_coding(profile, "query_coding") or "hex-0.1",
        "hex" if profile.settings.get("fault_coding") == "hex" else "decimal",
        _settled_coding(profile, "setpoint_coding") is not None,
    )


def _settled_coding(profile: DriveProfile, setting: str) -> dzb100.FrequencyCoding | None:
    chosen = profile.settings.get(setting)
    return next((coding for coding in dzb100.FREQUENCY_CODINGS if coding == chosen), None)


def _annotate_sunfar(profile: DriveProfile, found: FrameDescription, asked: Mapping[str, Any]) -> Annotations:
    """The protocol's reader has named parameter, monitor and frequency; other quantities and faults are added."""
    fields, added = found.fields, FieldDict()
    notation = fields.get("parameter") or fields.get("monitor")
    entry = next((entry for entry in entries(profile) if entry.notation == notation), None)
    if entry is not None and entry.unit != "Hz":
        added |= quantity_fields(entry, fields.get("data"))
    return added | _fault_fields(profile, fields), (), ()


def _annotate_dzb100(profile: DriveProfile, found: FrameDescription, asked: Mapping[str, Any]) -> Annotations:
    """The protocol's reader has judged setpoints and queried frequencies; parameters get their value with its unit."""
    fields, added = found.fields, _fault_fields(profile, found.fields)
    word, head = fields.get("data"), fields.get("head")
    if word is None or (head == "C" and "frequency_hz" not in fields):
        return added, (), ()
    if head == "C":
        return added | _frequency_by_coding(word), (), ()
    space, index = ("query", fields.get("item")) if head == "Q" else ("parameter", fields.get("parameter"))
    entry = None if index is None else entry_at(profile, (space, index))
    if entry is not None and entry.unit == "Hz":
        added |= _frequency_by_coding(word)
    if entry is None or head == "Q":
        return added, (), ()
    coding = _settled_coding(profile, "parameter_coding")
    if entry.unit == "Hz" and coding is not None:
        return added | _value_in_hertz(word, coding), (), ()
    return added | quantity_fields(entry, word, name="value", frequency=False), (), ()


def _frequency_by_coding(word: int) -> FieldDict:
    """What the word is under each coding that the drive might have."""
    every: dict[str, float] = {}
    for coding in dzb100.FREQUENCY_CODINGS:
        with suppress(ValueError):
            every[coding] = dzb100.decode_frequency(word, coding)
    return FieldDict(frequency_hz_by_coding=every)


def _value_in_hertz(word: int, coding: dzb100.FrequencyCoding) -> FieldDict:
    try:
        return FieldDict(value=f"{dzb100.decode_frequency(word, coding):g} Hz")
    except ValueError:
        return FieldDict()


def _fault_fields(profile: DriveProfile, fields: Mapping[str, Any]) -> FieldDict:
    code = fields.get("fault_code")
    return FieldDict(fault=profile.fault(code).label) if code else FieldDict()


_ANNOTATORS: Final[Mapping[str, Callable[[DriveProfile, FrameDescription, Mapping[str, Any]], Annotations]]] = {
    "sifang": _annotate_sunfar,
    "dzb": _annotate_dzb100,
    "modbus": registers.annotate_modbus,
}
