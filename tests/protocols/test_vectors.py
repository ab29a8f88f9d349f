"""The golden frames are what their schema says, and hang together."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest

from fixtures.vectors import MODELS, VECTORS_FOLDER, Vector, all_vectors, load_vectors

SCHEMA: dict[str, Any] = json.loads((VECTORS_FOLDER / "schema.json").read_text(encoding="utf-8"))
TYPES: dict[str, Any] = {
    "object": dict,
    "array": list,
    "string": str,
    "integer": int,
    "number": (int, float),
    "boolean": bool,
}
PROSE = {"$schema", "title", "description", "$defs"}


def faults(value: Any, schema: dict[str, Any], where: str = "") -> list[str]:
    """Return the faults of a value, for the keywords that our schema uses; an unknown keyword is a fault too."""
    found: list[str] = []
    for keyword, wanted in schema.items():
        if keyword not in PROSE:
            found += [f"{where}: {each}" for each in CHECKS[keyword](value, wanted, schema)]
    return found


def of_type(value: Any, wanted: str | list[str], _: dict[str, Any]) -> list[str]:
    names = [wanted] if isinstance(wanted, str) else wanted
    fits = any(isinstance(value, TYPES[name]) and (name == "boolean" or not isinstance(value, bool)) for name in names)
    return [] if fits else [f"{value!r} is not {names}"]


def of_properties(value: Any, wanted: dict[str, Any], _: dict[str, Any]) -> list[str]:
    return [each for name in value if name in wanted for each in faults(value[name], wanted[name], name)]


def of_reference(value: Any, wanted: str, _: dict[str, Any]) -> list[str]:
    return faults(value, SCHEMA["$defs"][wanted.removeprefix("#/$defs/")])


def of_pattern(value: Any, wanted: str, _: dict[str, Any]) -> list[str]:
    return [] if not isinstance(value, str) or re.search(wanted, value) else [f"{value!r} does not fit {wanted}"]


def of_dependents(value: Any, wanted: dict[str, list[str]], _: dict[str, Any]) -> list[str]:
    return [
        f"{name} without {other}"
        for name, needs in wanted.items()
        if name in value
        for other in needs
        if other not in value
    ]


def bound(compare: Any) -> Any:
    """A keyword that compares a number, a text's length or a list's; it says nothing of other types."""
    return lambda value, wanted, _: [] if compare(value, wanted) else [f"{value!r} breaks {wanted}"]


def number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


CHECKS: dict[str, Any] = {
    "type": of_type,
    "properties": of_properties,
    "$ref": of_reference,
    "pattern": of_pattern,
    "dependentRequired": of_dependents,
    "required": lambda value, wanted, _: [f"{name} is missing" for name in wanted if name not in value],
    "additionalProperties": lambda value, _, schema: [
        f"{name} is not a key" for name in value if name not in schema["properties"]
    ],
    "items": lambda value, wanted, _: [each for item in value for each in faults(item, wanted)],
    "enum": bound(lambda value, wanted: value in wanted),
    "const": bound(lambda value, wanted: value is wanted),
    "minimum": bound(lambda value, wanted: not number(value) or value >= wanted),
    "maximum": bound(lambda value, wanted: not number(value) or value <= wanted),
    "minLength": bound(lambda value, wanted: len(value) >= wanted),
    "minItems": bound(lambda value, wanted: len(value) >= wanted),
    "maxItems": bound(lambda value, wanted: len(value) <= wanted),
    "minProperties": bound(lambda value, wanted: len(value) >= wanted),
}


@pytest.mark.parametrize("vector", all_vectors(), ids=lambda vector: vector.id)
def test_a_vector_fits_the_schema_and_its_file(vector: Vector) -> None:
    assert faults(vector.line, SCHEMA) == []
    assert vector.id.startswith(vector.model + "-")
    if vector.direction == "request":
        assert "reply_to" not in vector.line
    elif vector.request is not None:
        assert (vector.request.direction, vector.request.encoding) == ("request", vector.encoding)


def test_every_id_is_used_once_and_every_family_has_frames() -> None:
    names = [vector.id for vector in all_vectors()]
    assert len(names) == len(set(names))
    assert all(load_vectors(model) for model in MODELS)
    assert {vector.model for vector in all_vectors()} == set(MODELS)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"hex": "01 0"}, "does not fit"),
        ({"colour": "red"}, "colour is not a key"),
        ({"fields": {"address": "1", "function": 3}}, "is not ['integer']"),
        ({"fields": {"address": 256, "function": 3}}, "256 breaks 255"),
        ({"fields": {"address": 1, "function": 3, "speed": 2}}, "speed is not a key"),
        ({"fields": {"address": 1, "function": True}}, "True is not ['integer']"),
        ({"erratum": "a digit is wrong"}, "erratum without decodable"),
        ({"direction": "both"}, "'both' breaks"),
    ],
)
def test_a_bad_vector_is_rejected(change: dict[str, Any], expected: str) -> None:
    good = next(each for each in load_vectors("vc660") if each.plain).line
    assert faults(good, SCHEMA) == []
    assert any(expected in each for each in faults(good | change, SCHEMA))


def test_the_sources_name_every_file_and_no_machine() -> None:
    text = (VECTORS_FOLDER / "SOURCES.md").read_text(encoding="utf-8")
    assert all(f"`{model}.jsonl`" in text for model in MODELS)
    assert not re.search(r"(^|\s)/\w+/|\\\\|[A-Z]:\\", text)
