"""Labels of a described frame in one language: names of fields, and of commands, states and codings."""

from __future__ import annotations

from typing import Any

from drivebus import i18n
from drivebus.values import Text

HEX_FIELDS = frozenset({"data", "register", "value", "raw", "word", "crc"})
"""Fields that manuals print in hexadecimal."""


def field_label(name: str, language: str) -> str:
    """Return the label of a field or of a coding (key of ``frequency_hz_by_coding``); else its JSON name."""
    return _text_or_none("decode.field." + name.replace("-", "_").replace(".", "_"), language) or name


def value_text(name: str, value: Any, language: str) -> str | None:
    """Return the text of a truth value, command, state, response, signal or raw word; None for other values."""
    if name == "commands" and value == []:
        return i18n.text("decode.word.none", language)
    if isinstance(value, bool) or value is None:
        return i18n.text(f"decode.{str(value).lower()}", language)
    if isinstance(value, Text):
        return str(getattr(value, language))
    if isinstance(value, int) and name in HEX_FIELDS:
        return f"{value} ({value:04X}H)"
    if not isinstance(value, str):
        return None
    if name == "status_bits":
        return _text_or_none(f"drives.bit_{value}", language)
    if name.endswith("_name") or name == "commands":
        return _text_or_none(f"decode.word.{value}", language)
    return _text_or_none(f"signal.{value}", language) if name == "name" else None


def _text_or_none(key: str, language: str) -> str | None:
    return i18n.text(key, language) if i18n.known(key) else None
