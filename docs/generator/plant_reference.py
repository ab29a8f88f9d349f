"""Reference of plant.toml: tables of its keys from the schema, and units, states and the sample."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from drivebus import i18n
from drivebus.service import config
from drivebus.service.config.gateways import plant_file_schema
from drivebus.service.config.schema import Title
from drivebus.service.interlocks.evaluation import UNIT_MEASURES
from drivebus.service.interlocks.expression import STATE_WORDS
from drivebus.values import Text
from generator.terms import colon, localized, table, term

_SCHEMA = plant_file_schema().model_json_schema()
_TITLE = TypeAdapter(Title).json_schema()
_KINDS = {
    "integer": Text("whole number", "整数"),
    "number": Text("number", "数值"),
    "string": Text("text", "文本"),
    "boolean": Text("true or false", "true 或 false"),
    "array": Text("list", "列表"),
    "title": Text("text, or { en = …, zh = … }", "文本，或 { en = …, zh = … }"),
    "object": Text("table", "表"),
    "setting": Text("text, number, true or false", "文本、数值、true 或 false"),
    "needed": Text("needed", "必需"),
}
_NAMED = ("bus", "drive", "group", "interlock", "alarm")


def page(language: str) -> dict[str, str]:
    """Return the generated parts of the page."""
    sample = Path(config.__file__).parent / f"sample.{language}.toml"
    return {
        "keys": "\n".join(_tables(language)),
        "sample": f"```toml\n{sample.read_text(encoding='utf-8')}```\n",
        "units": i18n.join((f"`{unit}`" for unit in UNIT_MEASURES if unit), "items", language) + "\n",
        "states": i18n.join((f"`{word}`" for word in STATE_WORDS), "items", language) + "\n",
    }


def paths() -> Iterator[tuple[str, ...]]:
    """Yield every table and key of the schema."""
    for name, found in _SCHEMA["properties"].items():
        yield (name,)
        yield from ((name, *rest) for rest in _below(found))


def _below(found: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    for name, inner in _properties(found).items():
        yield (name,)
        yield from ((name, *rest) for rest in _below(inner))


def _properties(found: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the keys of a table, or of each table of a table of tables."""
    resolved = _resolved(found)
    each = _each(resolved)
    resolved = resolved if each is None else _resolved(each)
    return resolved.get("properties", {})


def _each(found: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """Return the schema of the values of a table with free keys; None for a table with fixed keys."""
    by_pattern = list(found.get("patternProperties", {}).values())
    each = by_pattern[0] if by_pattern else found.get("additionalProperties")
    return each if isinstance(each, Mapping) else None


def _resolved(found: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a schema without references and without the null of optional keys."""
    if "anyOf" in found:
        kinds = [option for option in found["anyOf"] if option.get("type") != "null"]
        return _resolved(kinds[0]) if len(kinds) == 1 else found
    if "$ref" in found:
        return _resolved(_SCHEMA["$defs"][found["$ref"].rpartition("/")[2]])
    return found


def _is_title(found: Mapping[str, Any]) -> bool:
    """Return whether the schema is that of a text by language, for which a plain string is accepted too."""
    return found.get("patternProperties", {}).keys() == _TITLE["patternProperties"].keys()


def _tables(language: str) -> Iterator[str]:
    for name, found in _SCHEMA["properties"].items():
        if not _properties(found):
            yield f"### `{name}`\n\n{paragraph((name,), language)}\n"
            continue
        header = f"[{name}.ID]" if name in _NAMED else f"[{name}]"
        yield from _table(header, (name,), found, language)


def _table(header: str, path: tuple[str, ...], found: Mapping[str, Any], language: str) -> Iterator[str]:
    heads = [term("name", language), term("values", language), term("default", language), term("meaning", language)]
    yield f"### `{header}`\n\n{paragraph(path, language)}\n"
    inner = _properties(found)
    each = _each(_resolved(found))
    needed = set(_resolved(found if each is None else each).get("required", ()))
    rows = [
        (
            f"`{name}`",
            _values(schema, language),
            _default(name, schema, needed, language),
            paragraph((*path, name), language),
        )
        for name, schema in inner.items()
    ]
    yield table(heads, rows)
    for name, schema in inner.items():
        if _properties(schema):
            yield from _table(f"{header[:-1]}.{name}]", (*path, name), schema, language)


def paragraph(path: tuple[str, ...], language: str) -> str:
    """Return the description of a key. Raises KeyError if there is none."""
    return i18n.catalogue(language)[f"plant_config.key.{'.'.join(path)}"]


def _values(found: Mapping[str, Any], language: str) -> str:
    schema = _resolved(found)
    if "enum" in schema:
        return i18n.join((f"`{value}`" for value in schema["enum"]), "items", language)
    if "anyOf" in schema:
        return localized(_KINDS["setting"], language)
    if _is_title(schema):
        return localized(_KINDS["title"], language)
    kind = localized(_KINDS[schema["type"]], language)
    if schema["type"] == "array":
        return f"{kind}{colon(language)}{_values(schema['items'], language)}"
    each = _each(schema)
    if each is not None:
        return f"{kind}{colon(language)}{_values(each, language)}"
    return f"{kind} {_range(schema)}".rstrip()


def _range(schema: Mapping[str, Any]) -> str:
    low, high = schema.get("minimum", schema.get("exclusiveMinimum")), schema.get("maximum")
    if low is None and high is None:
        return ""
    above = "> " if "exclusiveMinimum" in schema else ""
    return f"{above}{low:.12g} … {high:.12g}" if high is not None else f"≥ {low:.12g}"


def _default(name: str, found: Mapping[str, Any], needed: set[str], language: str) -> str:
    if name in needed:
        return localized(_KINDS["needed"], language)
    value = found.get("default")
    if value is None or isinstance(value, dict | list):
        return "–"
    return f"`{str(value).lower() if isinstance(value, bool) else value}`"
