"""Errors and outcomes as JSON and back: the one shape in which every client gets them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import Enum
from typing import Any

from drivebus import errors, i18n
from drivebus.drives.outcome import FrameExchange, Outcome
from drivebus.drives.permissives import CommandKind
from drivebus.drives.state import Direction, DriveState
from drivebus.errors import DrivebusError, InvalidParameters, ServiceError, SystemReason
from drivebus.profiles.diagnostics import fault_path
from drivebus.service.auth.rights import Right
from drivebus.types import Json
from drivebus.values import Text

# --- sentences and their parameters -----------------------------------------------------------------------------------


def localized(key: str, params: Mapping[str, Any] | None = None) -> Json:
    """Return a sentence in both languages."""
    return {language: i18n.text(key, language, **(params or {})) for language in i18n.LANGUAGES}


def to_plain(value: Any) -> Any:
    """Return a parameter of a sentence as JSON: texts in both languages, enums by their value."""
    if isinstance(value, Enum):
        return value.value
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, Mapping):
        return {str(name): to_plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [to_plain(item) for item in value]
    if isinstance(value, Text):
        return value.by_language()
    text = getattr(value, "text", None)
    return {language: text(language) for language in i18n.LANGUAGES} if callable(text) else str(value)


def failure_reason(error: Exception) -> Any:
    """Return why a file failed, as the parameter of a sentence."""
    params = error.params if isinstance(error, DrivebusError) else {}
    return params.get("reason") or SystemReason(error)


# --- errors -----------------------------------------------------------------------------------------------------------


def build_error_json(
    code: str,
    kind: str,
    params: Mapping[str, Any],
    *,
    outcome: Json | None = None,
    may_be_running: bool | None = None,
) -> Json:
    """Return the shape of an error; ``code`` is the key of its sentence, ``kind`` the name of its class."""
    return {
        "code": code,
        "kind": kind,
        "text": localized(code, params),
        "params": to_plain(params),
        "outcome": outcome,
        "may_be_running": may_be_running,
    }


def error_to_json(error: DrivebusError) -> Json:
    """Return an error as every client gets it."""
    outcome = error.outcome
    document = outcome_json(outcome) if isinstance(outcome, Outcome) else outcome
    return build_error_json(
        error.key, type(error).__name__, error.params, outcome=document, may_be_running=error.may_be_running
    )


def error_from_json(data: Json) -> DrivebusError:
    """Return the error that ``error_to_json`` wrote; a class that is no error becomes ServiceError.

    Raises KeyError for an object that is no error.
    """
    kind = getattr(errors, str(data["kind"]), ServiceError)
    kind = kind if isinstance(kind, type) and issubclass(kind, DrivebusError) else ServiceError
    params = {name: _param_from_json(name, value) for name, value in data["params"].items()}
    error: DrivebusError = kind(data["code"], **params)
    error.outcome = data["outcome"]
    error.may_be_running = data.get("may_be_running")  # a service of an older version does not state it
    return error


_ENUMS_BY_PARAM: Mapping[str, type[Enum]] = {
    "right": Right,
    "state": DriveState,
    "direction": Direction,
    "kind": CommandKind,
}
"""Parameters that are a word of the user's language in a sentence, and a value of an enum as JSON."""


def _param_from_json(name: str, value: Any) -> Any:
    """Return the parameter of a sentence: a right, a state and a text by language are objects there."""
    if name in _ENUMS_BY_PARAM:
        return next((member for member in _ENUMS_BY_PARAM[name] if member.value == value), value)
    return Text.from_mapping(value) if isinstance(value, dict) and value.keys() >= {"en", "zh"} else value


# --- wrong parameters -------------------------------------------------------------------------------------------------

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
    "printable": "printable",
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
"""pydantic's type of a fault → sentence ``params.<key>``: every fault that the models of the operations can raise."""


def param_fault(path: str, found: Any, key: str, **params: Any) -> Json:
    """Return one wrong parameter: its path, the value found, and the sentence ``params.<key>`` of the expected one."""
    return {"path": path, "found": str(found)[:200], "expected": localized(f"params.{key}", params)}


def pydantic_faults(faults: Iterable[Mapping[str, Any]], params: Any) -> list[Json]:
    """Return the faults that pydantic found in ``params``: one a value, which names each of its types."""
    by_path: dict[str, Json] = {}
    for fault in faults:
        found = _translate(fault, ".".join(map(str, fault_path(fault, params))))
        earlier = by_path.setdefault(found["path"], found)
        if earlier is not found:
            sentences = {"first": Text(**earlier["expected"]), "other": Text(**found["expected"])}
            earlier["expected"] = localized("params.either", sentences)
    return list(by_path.values())


def _translate(fault: Mapping[str, Any], path: str) -> Json:
    context = fault.get("ctx", {})
    bounds = {name: f"{context[name]:.15g}" for name in ("ge", "le") if name in context}
    others = {name: context[name] for name in ("min_length", "max_length", "pattern") if name in context}
    choices = str(context.get("expected", "")).replace(" or ", ", ").split(", ")
    key = FAULT_MESSAGES.get(fault["type"], "other")
    return param_fault(path, repr(fault.get("input")), key, choices=choices, **bounds, **others)


def params_error(operation: str, faults: list[Json]) -> InvalidParameters:
    """Return the error whose sentence names every fault."""
    problems = Text.per_language(
        lambda language: i18n.join((_fault_sentence(fault, language) for fault in faults), "clauses", language)
    )
    return InvalidParameters("plant.params", operation=operation, problems=problems, faults=faults)


def _fault_sentence(fault: Json, language: str) -> str:
    expected = fault["expected"][language]
    return i18n.text("params.fault", language, path=fault["path"], expected=expected) if fault["path"] else expected


# --- outcomes ---------------------------------------------------------------------------------------------------------


def outcome_json(outcome: Outcome, command: str = "") -> Json:
    """Return an outcome with its sentence and the frames that prove it."""
    return {
        "status": str(outcome.status),
        "key": outcome.key,
        "text": localized(outcome.key, outcome.params),
        "params": to_plain(outcome.params),
        "notes": [{"key": key, "text": localized(key, params)} for key, params in outcome.notes],
        "frames": [exchange_json(exchange) for exchange in outcome.exchanges],
        "command": command,
    }


def exchange_json(exchange: FrameExchange) -> Json:
    """Return one frame of a command and its reply; times are monotonic seconds."""
    return {
        "sent": exchange.sent.hex(" ").upper(),
        "received": exchange.received.hex(" ").upper(),
        "sent_at_s": exchange.sent_at,
        "received_at_s": exchange.received_at,
        "error": exchange.error,
        "params": to_plain(exchange.params),
    }
