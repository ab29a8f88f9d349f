"""Errors and outcomes as JSON and back: the one shape in which every door of the plant tells them."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import Any

from drivebus import errors, i18n
from drivebus.drives.state import Exchange, Outcome
from drivebus.errors import DrivebusError, PlantError
from drivebus.plant.access.refusals import AccessError
from drivebus.plant.access.rights import Right
from drivebus.profiles.model import Text

Json = dict[str, Any]

_STATUS: tuple[tuple[type[DrivebusError], int], ...] = (
    (errors.NotFound, 404),
    (errors.ParamsError, 422),
    (errors.Forbidden, 403),
    (errors.AuditUnavailable, 503),
    (errors.ServiceUnavailable, 503),
    (errors.PlantError, 409),
    (errors.ConfigurationError, 422),
    (errors.LimitError, 422),
    (errors.CapabilityError, 422),
    (errors.OutcomeUnknown, 504),
    (errors.StopUnconfirmed, 504),
    (errors.Refused, 502),
    (errors.NotReached, 502),
    (errors.DriveError, 409),
    (errors.Expired, 409),
    (errors.Superseded, 409),
    (errors.NotPermitted, 409),
)
"""First match wins; what is left (protocol, silence, port) is 502: the line or the drive failed."""


def why(error: Exception) -> str:
    """Why a store can't be written, in the system's words where there are any."""
    params = error.params if isinstance(error, DrivebusError) else {}
    return str(params.get("reason") or getattr(error, "strerror", None) or error)


def both(key: str, params: Mapping[str, Any] | None = None) -> Json:
    """A sentence in both languages."""
    return {language: i18n.text(key, language, **(params or {})) for language in i18n.LANGUAGES}


def plain(value: Any) -> Any:
    """A parameter of a sentence as JSON: texts and sentences in both languages, words as words."""
    if isinstance(value, Enum):
        return value.value
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, Mapping):
        return {str(name): plain(one) for name, one in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(one) for one in value]
    if hasattr(value, "en") and hasattr(value, "zh"):
        return {"en": value.en, "zh": value.zh}
    sentence = getattr(value, "text", None)
    return {language: sentence(language) for language in i18n.LANGUAGES} if callable(sentence) else str(value)


def told(code: str, kind: str, params: Mapping[str, Any], status: int, outcome: Json | None = None) -> Json:
    """The one shape of an error, without the outer ``error``; ``code`` is the key of its sentence."""
    return {
        "code": code, "kind": kind, "text": both(code, params), "params": plain(params), "outcome": outcome,
        "status": status,
    }  # fmt: skip


def failure(error: DrivebusError) -> Json:
    """An error as every door shows it."""
    outcome = error.outcome
    found = outcome_json(outcome) if isinstance(outcome, Outcome) else outcome
    return told(error.key, type(error).__name__, error.params, status_of(error), found)


def status_of(error: DrivebusError) -> int:
    """The HTTP status of an error."""
    if isinstance(error, AccessError):
        return error.status
    return next((status for kind, status in _STATUS if isinstance(error, kind)), 502)


def raised(found: Json) -> DrivebusError:
    """The error that ``failure`` told of; ``failure`` of it says the same again. Raises KeyError for what is none."""
    kind = getattr(errors, str(found["kind"]), PlantError)
    kind = kind if isinstance(kind, type) and issubclass(kind, DrivebusError) else PlantError
    error: DrivebusError = kind(found["code"], **{name: _param(name, value) for name, value in found["params"].items()})
    error.outcome = found["outcome"]
    return error


def _param(name: str, value: Any) -> Any:
    """A right is one word on the wire, and says itself in both languages."""
    if name == "right":
        return next((right for right in Right if right == value), value)
    return Text(**value) if isinstance(value, dict) and value.keys() == {"en", "zh"} else value


def outcome_json(outcome: Outcome, command: str = "") -> Json:
    """An outcome with its sentence and the frames that prove it."""
    return {
        "word": str(outcome.word), "key": outcome.key, "text": both(outcome.key, outcome.params),
        "params": plain(outcome.params),
        "notes": [{"key": key, "text": both(key, params)} for key, params in outcome.notes],
        "frames": [frame_json(one) for one in outcome.evidence], "command": command,
    }  # fmt: skip


def frame_json(exchange: Exchange) -> Json:
    """One frame of a command and what came back; times are monotonic seconds."""
    return {
        "sent": exchange.sent.hex(" ").upper(), "received": exchange.received.hex(" ").upper(),
        "sent_at_s": exchange.sent_at, "received_at_s": exchange.received_at, "error": exchange.error,
        "params": plain(exchange.params),
    }  # fmt: skip
