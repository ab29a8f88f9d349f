"""What is wrong with somebody's parameters, in our own words and both languages, whoever found it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from drivebus import i18n
from drivebus.errors import InvalidParameters
from drivebus.profiles.model import Text
from drivebus.service.api.errors import localized

Json = dict[str, Any]

FAULT_MESSAGES = {
    "extra_forbidden": "unknown",
    "missing": "missing",
    "model_type": "object",
    "model_attributes_type": "object",
    "dict_type": "object",
    "invalid_key": "string",
    "string_type": "string",
    "string_unicode": "unicode",
    "string_pattern_mismatch": "pattern",
    "string_too_short": "characters_least",
    "string_too_long": "characters_most",
    "float_type": "number",
    "finite_number": "finite",
    "int_type": "integer",
    "bool_type": "boolean",
    "list_type": "list",
    "too_short": "entries_least",
    "too_long": "entries_most",
    "greater_than_equal": "at_least",
    "less_than_equal": "at_most",
    "literal_error": "choice",
    "enum": "choice",
}
"""pydantic's type of a fault → i18n ``params.<word>``: all that our models can raise."""


def param_fault(path: str, found: Any, key: str, **params: Any) -> Json:
    """One parameter that is wrong: where, what stands there, and what should."""
    return {"path": path, "found": str(found)[:200], "expected": localized(f"params.{key}", params)}


def pydantic_faults(faults: Iterable[Mapping[str, Any]], skipped: int = 0) -> list[Json]:
    """What pydantic found, as faults; ``skipped`` parts of each path are no part of the parameters."""
    return [_translate(one, ".".join(map(str, one["loc"][skipped:]))) for one in faults]


def _translate(found: Mapping[str, Any], path: str) -> Json:
    about = found.get("ctx", {})
    bounds = {name: f"{about[name]:.15g}" for name in ("ge", "le") if name in about}
    others = {name: about[name] for name in ("min_length", "max_length", "pattern") if name in about}
    choices = str(about.get("expected", "")).replace(" or ", ", ")
    key = FAULT_MESSAGES.get(found["type"], "other")
    return param_fault(path, repr(found.get("input")), key, choices=choices, **bounds, **others)


def params_error(operation: str, faults: list[Json]) -> InvalidParameters:
    """The error that names each fault in its sentence too."""
    problems = Text(*("; ".join(_fault_sentence(one, language) for one in faults) for language in i18n.LANGUAGES))
    return InvalidParameters("plant.params", operation=operation, problems=problems, faults=faults)


def _fault_sentence(one: Json, language: str) -> str:
    expected = one["expected"][language]
    return f"{one['path']}: {expected}" if one["path"] else expected
