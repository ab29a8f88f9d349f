"""pydantic's findings → problems in our own words: unknown and missing keys, types, choices, ranges, lengths."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ValidationError

from drivebus.profiles.diagnostics import Issue, bilingual_text, issue
from drivebus.profiles.notation import nearest_names
from drivebus.profiles.schema import ProfileIn

_TOML_TYPES = {
    "int_type": "integer",
    "int_from_float": "integer",
    "float_type": "number",
    "finite_number": "number",
    "string_type": "string",
    "bool_type": "boolean",
    "list_type": "array",
    "dict_type": "table",
    "model_type": "table",
}
"""pydantic's type faults → TOML's own words for types, i18n ``profiles.type.<word>``."""
_RANGE_OPERATORS = {"greater_than": ">", "greater_than_equal": ">=", "less_than": "<", "less_than_equal": "<="}


def issues_from_pydantic(error: ValidationError, root: type[BaseModel] = ProfileIn) -> list[Issue]:
    """One problem for each fault that pydantic names in a file of this shape, unions counted once."""
    found: dict[tuple[str | int, ...], Issue] = {}
    for fault in error.errors(include_url=False):
        path = tuple(part for part in fault["loc"] if part not in ("[key]", "str", "int", "float", "bool"))
        found.setdefault(path, _to_issue(fault, path, root))
    return list(found.values())


def _to_issue(fault: Any, path: tuple[str | int, ...], root: type[BaseModel]) -> Issue:
    kind, value, ctx = fault["type"], fault["input"], fault.get("ctx", {})
    if kind == "extra_forbidden":
        return issue("unknown_key", path, path[-1], known=", ".join(_known_keys(path, root)))
    if kind == "missing":
        return issue("missing_key", path, "-", name=path[-1])
    if kind == "literal_error":
        if path[0] == "commands" and "toggle" in str(value):
            return issue("toggle", path, value)
        return issue("choice", path, value, choices=ctx["expected"].replace(" or ", ", "))
    if kind in _RANGE_OPERATORS:
        bound = next(iter(ctx.values()))
        return issue("range", path, value, bound=f"{_RANGE_OPERATORS[kind]} {bound}")
    if kind in ("too_short", "too_long", "string_too_short", "string_too_long"):
        few = ctx.get("min_length", 0)
        return issue("length", path, value, bound=f">= {few}" if "min_length" in ctx else f"<= {ctx['max_length']}")
    if kind == "string_pattern_mismatch":
        return issue("pattern", path, value, pattern=ctx["pattern"])
    return issue("type", path, value, type=bilingual_text(f"profiles.type.{_TOML_TYPES.get(kind, 'other')}"))


def _known_keys(path: tuple[str | int, ...], root: type[BaseModel]) -> list[str]:
    """The keys that the table of an unknown one may have; those that look like it where some do."""
    model: Any = root
    for part in path[:-1]:
        model = _child_model(model, part)
        if model is None:
            return []
    fields = [info.alias or name for name, info in model.model_fields.items()]
    return nearest_names(str(path[-1]), fields) or sorted(fields)


def _child_model(model: Any, part: str | int) -> Any:
    """The model of a table's value, through Optional and dict."""
    fields = getattr(model, "model_fields", None)
    if fields is None:
        return None
    info = next((f for name, f in fields.items() if (f.alias or name) == part), None)
    return _find_model(info.annotation) if info else model


def _find_model(annotation: Any) -> Any:
    if hasattr(annotation, "model_fields"):
        return annotation
    inner = (_find_model(argument) for argument in getattr(annotation, "__args__", ()))
    return next((found for found in inner if found is not None), None)
