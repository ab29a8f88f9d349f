"""Descriptions of DZB100 frames with the facts of a profile.

Added fields: ``value``, a text with unit; ``frequency_hz_by_coding`` and ``current_by_coding``, under each coding that
the manual allows; the fault's label, text, cause and remedy: see ``annotate.fault_fields``.
"""

from __future__ import annotations

from contextlib import suppress

from drivebus.commissioning.decode.annotate import FieldDict, annotate, fault_fields, quantity_fields
from drivebus.profiles import DriveProfile
from drivebus.protocols import dzb100
from drivebus.protocols.describe import FrameDescription, FrameDirection


def describe(
    profile: DriveProfile, data: bytes, encoding: str, direction: FrameDirection | None, request: bytes | None
) -> FrameDescription:
    """Describe a frame; setpoints and queried frequencies are decoded by the protocol, parameters here."""
    description = dzb100.describe(data, encoding, direction, request, decode_options(profile))
    return annotate(description, fault_fields(profile, description.fields) | _word_fields(profile, description))


def decode_options(profile: DriveProfile) -> dzb100.Dzb100DecodeOptions:
    """Return the codings of a model, with the default where one is not determined."""
    setpoint_coding = _settled_coding(profile, "setpoint_coding")
    return dzb100.Dzb100DecodeOptions(
        setpoint_coding=setpoint_coding or "hex-0.1",
        query_coding=_settled_coding(profile, "query_coding") or "hex-0.1",
        fault_coding="hex" if profile.options.get("fault_coding") == "hex" else "decimal",
        setpoint_coding_known=setpoint_coding is not None,
    )


def _settled_coding(profile: DriveProfile, option: str) -> dzb100.FrequencyCoding | None:
    chosen = profile.options.get(option)
    return next((coding for coding in dzb100.FREQUENCY_CODINGS if coding == chosen), None)


def _word_fields(profile: DriveProfile, description: FrameDescription) -> FieldDict:
    """Return the meaning of the data word in a control, query or parameter frame."""
    fields = description.fields
    word, head = fields.get("data"), fields.get("head")
    if word is None:
        return {}
    if head == "C":
        return _frequency_by_coding(word) if "frequency_hz" in fields else {}
    space, index = ("query", fields.get("item")) if head == "Q" else ("parameter", fields.get("parameter"))
    entry = None if index is None else profile.entry_at((space, index))
    if entry is None:
        return {}
    added = _frequency_by_coding(word) if entry.unit == "Hz" else FieldDict()
    if head == "Q":
        return _current_by_coding(word) if entry.unit == "A" else added
    coding = _settled_coding(profile, "parameter_coding")
    if entry.unit == "Hz" and coding is not None:
        return added | _value_in_hertz(word, coding)
    return added | quantity_fields(entry, word, name="value", frequency=False)


def _frequency_by_coding(word: int) -> FieldDict:
    return FieldDict(frequency_hz_by_coding=_by_coding(word))


def _current_by_coding(word: int) -> FieldDict:
    return FieldDict(current_by_coding=[f"{number:g} A ({coding})" for coding, number in _by_coding(word).items()])


def _by_coding(word: int) -> dict[str, float]:
    """Return the number of a word under each coding that can read it."""
    numbers: dict[str, float] = {}
    for coding in dzb100.FREQUENCY_CODINGS:
        with suppress(ValueError):
            numbers[coding] = dzb100.decode_frequency(word, coding)
    return numbers


def _value_in_hertz(word: int, coding: dzb100.FrequencyCoding) -> FieldDict:
    try:
        return FieldDict(value=f"{dzb100.decode_frequency(word, coding):g} Hz")
    except ValueError:
        return FieldDict()
