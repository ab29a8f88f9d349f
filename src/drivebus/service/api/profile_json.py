"""Profiles and parameter readings as JSON."""

from __future__ import annotations

from collections.abc import Mapping

from drivebus.errors import ProfileError
from drivebus.profiles.model import Caveat, DriveProfile, Evidence, OpenQuestion, Parameter, Signal
from drivebus.profiles.notation import find_entry
from drivebus.protocols.family import Locator
from drivebus.service.live.views import fault_json, text_json
from drivebus.types import Json
from drivebus.values import Reading, Text, bilingual_text


def profile_json(profile: DriveProfile) -> Json:
    """Return a drive model: its capabilities, signals, parameters, faults, caveats and keypad steps."""
    serial, writing = profile.serial, profile.write_support
    return {
        "model": profile.model,
        "maker": text_json(profile.maker),
        "title": text_json(profile.title),
        "grade": profile.grade,
        "family": profile.family,
        "encodings": list(profile.encodings),
        "serial": {
            "baud": serial.baud,
            "format": serial.format,
            "bauds": list(serial.bauds),
            "formats": list(serial.formats),
        },
        "limits": {"minimum_hz": profile.limits.minimum_hz, "maximum_hz": profile.limits.maximum_hz},
        "capabilities": sorted(profile.capabilities),
        "jog_frequency": profile.jog_frequency,
        "signals": [_signal(signal) for signal in profile.signals.values()],
        "status_bits": _status_bits(profile),
        "parameters": [_parameter(parameter) for parameter in profile.parameters.values()],
        "faults": [fault_json(fault) for fault in profile.faults.values()],
        "caveats": [_caveat(caveat) for caveat in profile.caveats],
        "keypad": [text_json(step) for step in profile.keypad],
        "wiring": text_json(profile.wiring),
        "open_questions": [_question(question) for question in profile.open_questions],
        "can_save": writing.eeprom and "save" in profile.capabilities,
        "can_write_ram": writing.ram,
        "has_loopback": profile.modbus is not None and profile.modbus.loopback,
    }


def _evidence(evidence: Evidence) -> Json:
    return {"kind": evidence.kind, "source": evidence.source.en, "text": text_json(evidence.source)}


def _signal(signal: Signal) -> Json:
    return {
        "name": signal.name,
        "notation": signal.notation,
        "address_hex": locator_hex(signal.locator),
        "unit": signal.unit,
        "period_s": signal.period_s,
        "text": text_json(signal.text),
        "evidence": _evidence(signal.evidence),
    }


def _status_bits(profile: DriveProfile) -> list[Json]:
    bits = {} if profile.status is None else profile.status.bits
    return [
        {"name": name, "mask": mask, "text": text_json(bilingual_text(f"drives.bit_{name}"))}
        for name, mask in bits.items()
    ]


def _parameter(parameter: Parameter) -> Json:
    return {
        "notation": parameter.notation,
        "address_hex": locator_hex(parameter.locator),
        "text": text_json(parameter.text),
        "unit": parameter.unit,
        "minimum": parameter.minimum,
        "maximum": parameter.maximum,
        "choices": {str(raw): text_json(text) for raw, text in parameter.choices.items()},
        "choices_complete": parameter.choices_complete,
        "help": text_json(parameter.help),
        "caveat": parameter.caveat,
        "writable": parameter.writable,
        "readable": parameter.readable,
        "factory": parameter.factory,
        "evidence": _evidence(parameter.evidence),
    }


def _caveat(caveat: Caveat) -> Json:
    return {"id": caveat.id, "text": text_json(caveat.text), "evidence": _evidence(caveat.evidence)}


def _question(question: OpenQuestion) -> Json:
    return {
        "name": question.name,
        "value": question.value.en if isinstance(question.value, Text) else question.value,
        "choices": list(question.choices),
        "text": text_json(question.text),
        "reason": text_json(question.reason),
        "procedure": text_json(question.procedure),
    }


def reading_json(reading: Reading) -> Json:
    return {
        "raw": reading.raw,
        "value": reading.value,
        "unit": reading.unit,
        "quality": str(reading.quality),
        "reason": reading.reason,
    }


def readings_json(profile: DriveProfile, readings: Mapping[str, Reading]) -> Json:
    """Return readings by the names under which they were read, each with its wire address and its text."""
    return {name: reading_json(reading) | _entry_json(profile, name) for name, reading in readings.items()}


def _entry_json(profile: DriveProfile, name: str) -> Json:
    """Return wire address and text of a parameter or signal by any of its names; null for an unknown name."""
    try:
        entry = find_entry(profile, name)
    except ProfileError:
        return {"address_hex": None, "text": None}
    return {"address_hex": locator_hex(entry.locator), "text": text_json(entry.text)}


def locator_hex(locator: Locator) -> str:
    return f"{locator[1]:04X}H"
