"""The page compares values of the API only with values that the API declares."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, get_args

import pytest

from drivebus import web
from drivebus.service.api.operations.drive_view import DriveObject, SignalObject

SCRIPTS = Path(web.__file__).parent / "static" / "js"


def declared_values(model: Any, name: str) -> set[str]:
    """Return the strings of a field that is a ``Literal``, or one with None."""
    annotation = model.model_fields[name].annotation
    return {value for part in (annotation, *get_args(annotation)) for value in get_args(part) if isinstance(value, str)}


@pytest.mark.parametrize(
    ("model", "name", "js_name"),
    [
        (DriveObject, "jog_frequency", "jog_frequency"),
        (DriveObject, "presence", "presence"),
        (SignalObject, "quality", "quality"),
    ],
)
def test_the_page_compares_a_field_with_declared_values_only(model: Any, name: str, js_name: str) -> None:
    comparison = re.compile(rf'\b{re.escape(js_name)} [!=]== "(\w+)"')
    compared = {value for path in SCRIPTS.rglob("*.js") for value in comparison.findall(path.read_text())}
    assert compared and compared <= declared_values(model, name)
