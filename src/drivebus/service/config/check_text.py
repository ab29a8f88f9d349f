"""Texts of the file that would write more than themselves into a log, a terminal or a page (S13)."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

from drivebus.profiles.diagnostics import CONTROL_CHARACTERS, Issue, KeyPath, issue

_ALLOWED_IN_EXPRESSIONS = re.compile(r"[\n\t]")
"""An expression may stand on several lines."""


def text_problems(raw: Mapping[str, Any]) -> Iterator[Issue]:
    """Every text of the file, wherever it stands."""
    yield from _check_value(raw, ())


def _check_value(value: Any, path: KeyPath) -> Iterator[Issue]:
    if isinstance(value, Mapping):
        for name, inner in value.items():
            yield from _check_value(inner, (*path, name))
    elif isinstance(value, list):
        for inner in value:
            yield from _check_value(inner, path)
    elif isinstance(value, str):
        text = _ALLOWED_IN_EXPRESSIONS.sub(" ", value) if path[-1:] == ("require",) else value
        found = CONTROL_CHARACTERS.search(text)
        if found is not None:
            yield issue("control", path, CONTROL_CHARACTERS.sub("�", value), code=f"U+{ord(found[0]):04X}")
