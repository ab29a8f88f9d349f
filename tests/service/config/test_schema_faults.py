"""Each fault that the schemas of profiles, plant files and answers can find has words and a place in the file."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any, get_args, get_origin

import pytest
from pydantic import BaseModel, ValidationError

from drivebus import i18n
from drivebus.profiles.diagnostics import Issue, issues_from_pydantic
from drivebus.profiles.schema import ProfileFile
from drivebus.service.config.gateways import plant_file_schema
from drivebus.service.config.wizard import _PlantAnswersIn

KeyPath = tuple[str | int, ...]
SCHEMAS: list[type[BaseModel]] = [ProfileFile, plant_file_schema(), _PlantAnswersIn]
BAD: list[Any] = [
    True,
    1,
    1.5,
    10**400,
    -1,
    float("inf"),
    "",
    "A B",
    "x" * 3000,
    [],
    [1],
    ["x"] * 3000,
    {},
    {"float": 1},
    {"": 1.0},
    {"x": {"y": 1}},
    {"en": "x", "fr": "y"},
]


def places(annotation: Any, above: KeyPath = ()) -> Iterator[KeyPath]:
    """Yield each place of a schema: its keys, one unknown key of each table, and an entry of each table or array."""
    if hasattr(annotation, "model_fields"):
        for name, field in annotation.model_fields.items():
            yield (*above, field.alias or name)
            yield from places(field.annotation, (*above, field.alias or name))
        yield (*above, "no_such_key")
        return
    part: KeyPath = {dict: ("a",), list: (0,), tuple: (0,)}.get(get_origin(annotation), ())
    if part:
        yield (*above, *part)
    for argument in get_args(annotation):
        yield from places(argument, (*above, *part))


def document(place: KeyPath, value: Any) -> Any:
    """Return a file that has a value at a place and no other key."""
    for part in reversed(place):
        value = [value] if part == 0 else {part: value}
    return value


@cache
def faults(schema: type[BaseModel]) -> list[tuple[Issue, Any]]:
    """Return each fault of each bad value at each place, with its file."""
    found: list[tuple[Issue, Any]] = []
    for place in dict.fromkeys(places(schema)):
        for bad in BAD:
            data = document(place, bad)
            try:
                schema.model_validate(data)
            except ValidationError as error:
                found += [(issue, data) for issue in issues_from_pydantic(error, schema, data)]
    return found


@pytest.mark.parametrize("schema", SCHEMAS, ids=lambda schema: schema.__name__)
def test_every_fault_has_words_of_its_own(schema: type[BaseModel]) -> None:
    """A number of 400 digits was answered with *another type expected*."""
    assert len(faults(schema)) > 500
    for fault, data in faults(schema):
        assert i18n.known(f"profiles.kind.{fault.kind}"), data
        if fault.kind == "type":
            assert fault.params["type"].en != i18n.text("profiles.type.other", "en"), (fault.path, str(data)[:100])


@pytest.mark.parametrize("schema", SCHEMAS, ids=lambda schema: schema.__name__)
def test_every_fault_is_at_a_place_of_the_file(schema: type[BaseModel]) -> None:
    """The key was ``open_questions.a.assumed."dict[constrained-str,constrained-str]"``."""
    for fault, data in faults(schema):
        value, rest = data, list(fault.path)
        while rest and ((isinstance(value, dict) and rest[0] in value) or isinstance(value, list)):
            value = value[rest.pop(0)]
        absent = [fault.path[-1]] if fault.kind == "missing_key" else []
        assert rest in ([], absent), (fault.path, str(data)[:100])
