"""Errors and outcomes as JSON and back: the one shape in which every door of the plant tells them."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import Any

from drivebus import errors, i18n
from drivebus.drives.state import FrameExchange, Outcome
from drivebus.errors import DrivebusError, ServiceError
from drivebus.profiles.model import Text
from drivebus.service.auth.rights import Right

Json = dict[str, Any]


def os_reason(error: Exception) -> str:
    """Why a store can't be written, in the system's words where there are any."""
    params = error.params if isinstance(error, DrivebusError) else {}
    return str(params.get("reason") or getattr(error, "strerror", None) or error)


def localized(key: str, params: Mapping[str, Any] | None = None) -> Json:
    """A sentence in both languages."""
    return {language: i18n.text(key, language, **(params or {})) for language in i18n.LANGUAGES}


def to_plain(value: Any) -> Any:
    """A parameter of a sentence as JSON: texts and sentences in both languages, words as words."""
    if isinstance(value, Enum):
        return value.value
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, Mapping):
        return {str(name): to_plain(one) for name, one in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [to_plain(one) for one in value]
    if hasattr(value, "en") and hasattr(value, "zh"):
        return {"en": value.en, "zh": value.zh}
    sentence = getattr(value, "text", None)
    return {language: sentence(language) for language in i18n.LANGUAGES} if callable(sentence) else str(value)


def build_error_json(code: str, kind: str, params: Mapping[str, Any], outcome: Json | None = None) -> Json:
    """The one shape of an error, without the outer ``error``; ``code`` is the key of its sentence."""
    return {
        "code": code,
        "kind": kind,
        "text": localized(code, params),
        "params": to_plain(params),
        "outcome": outcome,
    }


def error_to_json(error: DrivebusError) -> Json:
    """An error as every door shows it."""
    outcome = error.outcome
    found = outcome_json(outcome) if isinstance(outcome, Outcome) else outcome
    return build_error_json(error.key, type(error).__name__, error.params, found)


def error_from_json(found: Json) -> DrivebusError:
    """The error that ``failure`` told of; ``failure`` of it says the same again. Raises KeyError for what is none."""
    kind = getattr(errors, str(found["kind"]), ServiceError)
    kind = kind if isinstance(kind, type) and issubclass(kind, DrivebusError) else ServiceError
    error: DrivebusError = kind(
        found["code"], **{name: _param_from_json(name, value) for name, value in found["params"].items()}
    )
    error.outcome = found["outcome"]
    return error


def _param_from_json(name: str, value: Any) -> Any:
    """A right is one word on the wire, and says itself in both languages."""
    if name == "right":
        return next((right for right in Right if right == value), value)
    return Text(**value) if isinstance(value, dict) and value.keys() == {"en", "zh"} else value


def outcome_json(outcome: Outcome, command: str = "") -> Json:
    """An outcome with its sentence and the frames that prove it."""
    return {
        "word": str(outcome.status),
        "key": outcome.key,
        "text": localized(outcome.key, outcome.params),
        "params": to_plain(outcome.params),
        "notes": [{"key": key, "text": localized(key, params)} for key, params in outcome.notes],
        "frames": [exchange_json(one) for one in outcome.exchanges],
        "command": command,
    }


def exchange_json(exchange: FrameExchange) -> Json:
    """One frame of a command and what came back; times are monotonic seconds."""
    return {
        "sent": exchange.sent.hex(" ").upper(),
        "received": exchange.received.hex(" ").upper(),
        "sent_at_s": exchange.sent_at,
        "received_at_s": exchange.received_at,
        "error": exchange.error,
        "params": to_plain(exchange.params),
    }
