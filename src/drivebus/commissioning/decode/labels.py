"""The words of a described frame in a language: names of fields, and of the commands, states and codings in them."""

from __future__ import annotations

from typing import Any

from drivebus import i18n
from drivebus.protocols import dzb100


def field_label(name: str, language: str) -> str:
    """A field's name for people, or a coding's (``frequency_hz_by_coding``); else the name that JSON gives it."""
    return _text_or_none(f"decode.field.{name}", language) or _text_or_none(dzb100.coding_key(name), language) or name


def value_text(name: str, value: Any, language: str) -> str | None:
    """What a field's value is called: yes and no, orders, states and answers, signals; None where it is no word."""
    if isinstance(value, bool) or value is None:
        return i18n.text(f"decode.{str(value).lower()}", language)
    if not isinstance(value, str):
        return None
    if name.endswith("_name") or name == "commands":
        return _text_or_none(f"decode.word.{value}", language)
    return _text_or_none(f"signal.{value}", language) if name == "name" else None


def _text_or_none(key: str, language: str) -> str | None:
    return i18n.text(key, language) if i18n.known(key) else None
