"""A drive model for people: what it can do, its signals, parameters, faults, caveats and keypad steps."""

from __future__ import annotations

from typing import Any

from drivebus.profiles.model import Caveat, DriveProfile, Evidence, OpenQuestion, Parameter, Signal
from drivebus.service.api.parameter_json import locator_hex
from drivebus.service.live.views import fault_json, text_json

Json = dict[str, Any]


def profile_json(profile: DriveProfile) -> Json:
    """All of a profile that somebody at a drive wants to know."""
    line, rule = profile.serial, profile.write_support
    return {
        "model": profile.model,
        "maker": text_json(profile.maker),
        "title": text_json(profile.title),
        "grade": profile.grade,
        "family": profile.family,
        "encodings": list(profile.encodings),
        "line": {
            "baud": line.baud,
            "format": line.format,
            "bauds": list(line.bauds),
            "formats": list(line.formats),
        },
        "limits": {"minimum_hz": profile.limits.minimum_hz, "maximum_hz": profile.limits.maximum_hz},
        "capabilities": sorted(profile.capabilities),
        "jog_frequency": profile.jog_frequency,
        "signals": [_signal(one) for one in profile.signals.values()],
        "parameters": [_parameter(one) for one in profile.parameters.values()],
        "faults": [fault_json(one) for one in profile.faults.values()],
        "caveats": [_caveat(one) for one in profile.caveats],
        "keypad": [text_json(one) for one in profile.keypad],
        "wiring": text_json(profile.wiring),
        "open_questions": [_question(one) for one in profile.open_questions],
        "can_save": rule.eeprom and "save" in profile.capabilities,
        "can_write_ram": rule.ram,
    }


def _evidence(evidence: Evidence) -> Json:
    return {"kind": evidence.kind, "source": evidence.source}


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


def _parameter(parameter: Parameter) -> Json:
    return {
        "notation": parameter.notation,
        "address_hex": locator_hex(parameter.locator),
        "text": text_json(parameter.text),
        "unit": parameter.unit,
        "minimum": parameter.minimum,
        "maximum": parameter.maximum,
        "choices": {str(raw): text_json(text) for raw, text in parameter.choices.items()},
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
        "setting": question.setting,
        "default": question.default,
        "choices": list(question.choices),
        "text": text_json(question.text),
        "reason": text_json(question.reason),
        "settle": text_json(question.settle),
    }
