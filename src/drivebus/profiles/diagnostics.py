"""Diagnostics of TOML files: file, line, key, value found, value expected and remedy, in both languages.

Profiles and ``plant.toml`` share them; each file type may have a text catalogue of its own.
"""

from __future__ import annotations

import difflib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel, ValidationError

from drivebus import i18n
from drivebus.control_characters import CONTROL_CHARACTERS, without_control_characters
from drivebus.errors import ProfileError, SystemReason
from drivebus.values import Text, bilingual_text

KeyPath = tuple[str | int, ...]
DEFAULT_CATALOGUE = "profiles"
"""Catalogue of the texts that every file type may use."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Diagnostic:
    """Fault of a TOML file: a profile or ``plant.toml``."""

    kind: str
    """Last part of the i18n key of its text, ``<catalogue>.kind.<kind>``."""
    key: str
    """Dotted, as in TOML: ``signals.output_frequency.unit``; empty for the whole file."""
    found: Text
    """As TOML writes the value; a dash for one that is absent."""
    is_absent: bool
    """The key or file does not exist, so no value was found."""
    expected: Text
    remedy: Text
    file: str = ""
    line: int | None = None
    catalogue: str = DEFAULT_CATALOGUE
    """Catalogue of its texts; for a kind that it lacks the texts of ``DEFAULT_CATALOGUE`` are used."""

    def text(self, language: str = "en") -> str:
        """Return the whole sentence: location, fault, value found, value expected, remedy."""
        return printable_text(
            "profiles.diagnostic_absent" if self.is_absent else "profiles.diagnostic",
            language,
            where=self._location(language),
            what=i18n.text(_text_key(self.catalogue, "kind", self.kind), language),
            found=self.found,
            expected=self.expected,
            remedy=self.remedy,
        )

    def _location(self, language: str) -> str:
        location = self.file if self.line is None else f"{self.file}:{self.line}"
        return i18n.text("profiles.where", language, location=location, key=self.key) if self.key else location


def control_character_issues(value: Any, path: KeyPath = (), multiline: Collection[str] = ()) -> Iterator[Issue]:
    """Yield the texts and keys of a file that hold control characters: they would corrupt logs, terminals and pages.

    ``multiline``: keys whose texts may have several lines.
    """
    if isinstance(value, Mapping):
        for name, inner in value.items():
            yield from control_character_issues(str(name), path)
            yield from control_character_issues(inner, (*path, str(name)), multiline)
    elif isinstance(value, list):
        for inner in value:
            yield from control_character_issues(inner, path, multiline)
    elif isinstance(value, str):
        text = value.replace("\n", " ").replace("\t", " ") if path and path[-1] in multiline else value
        match = CONTROL_CHARACTERS.search(text)
        if match is not None:
            yield issue("control_character", path, without_control_characters(value), code=f"U+{ord(match[0]):04X}")


def printable_text(key: str, language: str, /, **params: Any) -> str:
    """Return a text without control characters: a file may hold them, a log or a terminal must not get them."""
    return without_control_characters(i18n.text(key, language, **params))


@dataclass(frozen=True, slots=True)
class Issue:
    """Fault of a key whose line is not known yet."""

    kind: str
    path: KeyPath
    found: Any
    params: dict[str, Any]
    """Parameters of the texts ``<catalogue>.expected.<kind>`` and ``<catalogue>.remedy.<kind>``."""
    related: tuple[KeyPath, ...] = ()
    """Other keys that take part in it: the one that stands in the user's file is reported."""


def issue(
    kind: str, path: Sequence[str | int], found: Any, /, *, related: Sequence[KeyPath] = (), **params: Any
) -> Issue:
    """Return an issue of the value ``found`` at ``path``; ``params`` complete its sentence."""
    return Issue(kind, tuple(path), found, params, tuple(related))


def unreadable_issue(error: OSError) -> Issue:
    """Return the issue of a file or folder that can't be read."""
    reason = Text.per_language(SystemReason(error).text)
    return issue("folder", (), reason) if isinstance(error, IsADirectoryError) else issue("unreadable", (), reason)


def to_diagnostic(fault: Issue, file: str, line: int | None, catalogue: str = DEFAULT_CATALOGUE) -> Diagnostic:
    """Return the diagnostic of an issue, with its texts in both languages."""
    return Diagnostic(
        kind=fault.kind,
        key=dotted_key(fault.path),
        found=Text.per_language(lambda language: format_value(fault.found, language)),
        is_absent=fault.found is None,
        expected=bilingual_text(_text_key(catalogue, "expected", fault.kind), **fault.params),
        remedy=bilingual_text(_text_key(catalogue, "remedy", fault.kind), **fault.params),
        file=file,
        line=line,
        catalogue=catalogue,
    )


def listed_values(values: Iterable[object]) -> tuple[str, ...]:
    """Return values as the parameter of a diagnostic that names what may be chosen; a dash without one."""
    return tuple(map(str, values)) or ("-",)


def _text_key(catalogue: str, part: str, kind: str) -> str:
    own = f"{catalogue}.{part}.{kind}"
    return own if i18n.known(own) else f"{DEFAULT_CATALOGUE}.{part}.{kind}"


def profile_error(diagnostics: Sequence[Diagnostic]) -> ProfileError:
    """Return the error of a profile with these faults."""
    return ProfileError("profiles.refused", **error_params(diagnostics))


def error_params(diagnostics: Sequence[Diagnostic]) -> dict[str, Any]:
    """Return the parameters of a configuration error: those of the first fault, and all ``diagnostics``."""
    first = diagnostics[0]
    everything = Text.per_language(lambda language: "\n".join(diagnostic.text(language) for diagnostic in diagnostics))
    return {
        "file": first.file,
        "line": first.line,
        "key": first.key,
        "found": first.found,
        "expected": first.expected,
        "remedy": first.remedy,
        "count": len(diagnostics),
        "everything": everything,
        "diagnostics": tuple(diagnostics),
    }


def dotted_key(path: Sequence[str | int]) -> str:
    """Return a key path as TOML writes it, with quotes where needed."""
    return ".".join(_quote(str(part)) for part in path)


def _quote(part: str) -> str:
    bare = part.isascii() and part.replace("_", "").replace("-", "").isalnum()
    return part if bare else f'"{part}"'


def format_value(value: Any, language: str) -> str:
    """Return a value as TOML writes it, shortened."""
    if value is None:
        text = "-"
    elif isinstance(value, bool):
        text = str(value).lower()
    elif isinstance(value, Text):
        text = f'"{value.in_language(language)}"'
    elif isinstance(value, str):
        text = f'"{value}"'
    else:
        text = str(value)
    return shorten(text)


def shorten(text: str) -> str:
    """Return at most 60 characters; the middle of a longer text is left out, because a path's name is at its end."""
    return text if len(text) <= 60 else f"{text[:28]}...{text[-29:]}"


_TOML_TYPES = {
    "int_type": "integer",
    "int_from_float": "integer",
    "int_parsing_size": "small_integer",
    "float_type": "number",
    "finite_number": "number",
    "string_type": "string",
    "bool_type": "boolean",
    "list_type": "array",
    "dict_type": "table",
    "model_type": "table",
}
"""pydantic's type faults to the TOML type of the text ``profiles.type.<type>``."""
_RANGE_OPERATORS = {"greater_than": ">", "greater_than_equal": ">=", "less_than": "<", "less_than_equal": "<="}


def issues_from_pydantic(error: ValidationError, root: type[BaseModel], document: Any) -> list[Issue]:
    """Return one issue per fault that pydantic reports in a document of this schema; a union counts once."""
    issues: dict[KeyPath, Issue] = {}
    for fault in error.errors(include_url=False):
        path = fault_path(fault, document)
        issues.setdefault(path, _to_issue(fault, path, root))
    return list(issues.values())


def fault_path(fault: Mapping[str, Any], document: Any) -> KeyPath:
    """Return where pydantic's fault is in a document: without the parts that name a type of a union, or ``[key]``."""
    path: list[str | int] = []
    value = document
    for number, part in enumerate(fault["loc"], 1):
        if (isinstance(value, Mapping) and part in value) or (isinstance(value, list) and isinstance(part, int)):
            value = value[part]
        elif fault["type"] != "missing" or number < len(fault["loc"]):
            continue
        path.append(part)
    return tuple(path)


def _to_issue(fault: Any, path: tuple[str | int, ...], root: type[BaseModel]) -> Issue:
    kind, value, ctx = fault["type"], fault["input"], fault.get("ctx", {})
    if kind == "extra_forbidden":
        return issue("unknown_key", path, path[-1], known=tuple(_known_keys(path, root)))
    if kind == "missing":
        return issue("missing_key", path, None, name=path[-1])
    if kind == "literal_error":
        if path[0] == "commands" and "toggle" in str(value):
            return issue("toggle", path, value)
        return issue("choice", path, value, choices=tuple(ctx["expected"].replace(" or ", ", ").split(", ")))
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
    """Return the keys that the table of an unknown key may have; similar ones only, if there are any."""
    model: Any = root
    for part in path[:-1]:
        model = _child_model(model, part)
        if model is None:
            return []
    fields = [field.alias or name for name, field in model.model_fields.items()]
    return nearest_names(str(path[-1]), fields) or sorted(fields)


def _child_model(model: Any, part: str | int) -> Any:
    """Return the schema of a table's value, through Optional and dict."""
    fields = getattr(model, "model_fields", None)
    if fields is None:
        return None
    field = next((f for name, f in fields.items() if (f.alias or name) == part), None)
    return _find_model(field.annotation) if field else model


def _find_model(annotation: Any) -> Any:
    if hasattr(annotation, "model_fields"):
        return annotation
    inner = (_find_model(argument) for argument in getattr(annotation, "__args__", ()))
    return next((model for model in inner if model is not None), None)


def nearest_names(name: str, choices: Iterable[str]) -> list[str]:
    """Return up to three known names that are similar to ``name``, the most similar first."""
    by_folded = {candidate.lower(): candidate for candidate in choices}
    return [by_folded[folded] for folded in difflib.get_close_matches(name.strip().lower(), by_folded, 3, 0.5)]
