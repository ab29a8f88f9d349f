"""Texts of the file that would write more than themselves into a log, a terminal or a page (S13)."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

from drivebus.profiles.complaint import CONTROL, Path, Problem, problem

_LINES = re.compile(r"[\n\t]")
"""An expression may stand on several lines."""


def problems(raw: Mapping[str, Any]) -> Iterator[Problem]:
    """Every text of the file, wherever it stands."""
    yield from _below(raw, ())


def _below(value: Any, path: Path) -> Iterator[Problem]:
    if isinstance(value, Mapping):
        for name, inner in value.items():
            yield from _below(inner, (*path, name))
    elif isinstance(value, list):
        for inner in value:
            yield from _below(inner, path)
    elif isinstance(value, str):
        text = _LINES.sub(" ", value) if path[-1:] == ("require",) else value
        found = CONTROL.search(text)
        if found is not None:
            yield problem("control", path, CONTROL.sub("�", value), code=f"U+{ord(found[0]):04X}")
