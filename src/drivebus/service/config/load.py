"""TOML → ``PlantConfig``, or a refusal that names every mistake: file, line, key, found, expected, remedy.

Where a plant keeps its state, from a file that may be full of mistakes: whoever stops everything needs no more.
"""

from __future__ import annotations

import copy
import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from drivebus.errors import ConfigurationError
from drivebus.profiles.diagnostics import (
    Diagnostic,
    Issue,
    error_params,
    issue,
    issues_from_pydantic,
    to_diagnostic,
)
from drivebus.profiles.toml_file import MAX_TOML_BYTES, TomlFault, decode_toml, format_issue, iter_keys, syntax_fault
from drivebus.service.config import build, check
from drivebus.service.config.build import ParsedPlant, state_directory
from drivebus.service.config.model import PlantConfig
from drivebus.service.config.schema import PLANT_FILE_FORMAT, PlantFile

CATALOGUE = "plant_config"
MAX_COMPLAINTS = 100
"""So many complaints of one file are told: nobody reads more, and a file from afar must not cost more."""
MAX_VALIDATION_ROUNDS = 8
"""A table without the key it needs is put aside, then what held it: a file is no deeper."""
PLACEHOLDER_PLANT = {"id": "plant"}
"""For a ``[plant]`` or its id that is put aside: no file is without them, and the rest can still be checked."""


def load(path: str | Path) -> PlantConfig:
    """The plant of a file. Raises ConfigurationError; its params carry every fault as ``complaints``."""
    where = Path(path)
    try:
        with where.open("rb") as file:
            raw = file.read(MAX_TOML_BYTES + 1)
    except OSError as error:
        raise config_error([unreadable_complaint(str(path), error)]) from None
    return _parse(raw, str(path), where.resolve().parent)


def loads(text: str, source: str = "plant.toml", base: Path | None = None) -> PlantConfig:
    """The plant of a text; relative paths count from ``base`` (else from here). Raises as ``load`` does."""
    return _parse(text.encode(), source, (base or Path()).resolve())


def unreadable_complaint(path: str, error: OSError) -> Diagnostic:
    """Of a file that the system does not give."""
    missing = isinstance(error, FileNotFoundError)
    found = issue("no_file", (), path) if missing else issue("unreadable", (), error.strerror or str(error))
    return to_diagnostic(found, path, None, CATALOGUE)


def config_error(complaints: Sequence[Diagnostic]) -> ConfigurationError:
    return ConfigurationError("plant_config.refused", **error_params(complaints))


def _single_error(source: str, found: Issue, line: int | None) -> ConfigurationError:
    return config_error([to_diagnostic(found, source, line, CATALOGUE)])


def _parse(content: bytes, source: str, base: Path) -> PlantConfig:
    try:
        text, raw = decode_toml(content)
    except TomlFault as fault:
        raise _single_error(source, fault.issue, fault.line) from None
    found: list[Issue | Diagnostic] = [one for one in (format_issue(raw, PLANT_FILE_FORMAT),) if one is not None]
    draft = None
    if not found:
        file, faults = _validate(raw)
        found += faults
        if file is not None:
            draft = ParsedPlant(file, raw, base)
            found += check.all_problems(draft)
    if found:
        raise config_error(_with_lines(found, text, source))
    assert draft is not None
    return build.plant_config(draft, source)


def toml_complaint(source: str, error: tomllib.TOMLDecodeError, text: str) -> Diagnostic:
    """Return the diagnostic of a TOML syntax error."""
    fault = syntax_fault(error, text)
    return to_diagnostic(fault.issue, source, fault.line, CATALOGUE)


def _validate(raw: Mapping[str, Any]) -> tuple[PlantFile | None, list[Issue]]:
    """What is well-formed, and all that is not: faulty keys are put aside, so that the rest can still be checked."""
    rest: dict[str, Any] = copy.deepcopy(dict(raw))
    faults: list[Issue] = []
    for _ in range(MAX_VALIDATION_ROUNDS):
        try:
            return PlantFile.model_validate(rest), faults
        except ValidationError as error:
            found = issues_from_pydantic(error, PlantFile)
        faults += [one for one in found if not _is_consequence(one, faults)]
        for one in found:
            if one.path in (("plant",), ("plant", "id")):
                plant = rest.get("plant")
                rest["plant"] = (plant if isinstance(plant, dict) else {}) | PLACEHOLDER_PLANT
            else:
                _remove_key(rest, one.path[:-1] if one.kind == "missing_key" else one.path)
    return None, faults


def _is_consequence(one: Issue, faults: Sequence[Issue]) -> bool:
    """A key is missing now because a faulty one of its table was put aside before."""
    table = one.path[:-1]
    return one.kind == "missing_key" and any(told.path[: len(table)] == table for told in tuple(faults))


def _remove_key(data: Any, path: Sequence[str | int]) -> None:
    """Take a key away; an entry of a list takes its whole list with it, so that no index shifts."""
    for depth, part in enumerate(path):
        inner = data.get(part) if isinstance(data, dict) else None
        if depth == len(path) - 1 or not isinstance(inner, dict):
            if isinstance(data, dict):
                data.pop(part, None)
            return
        data = inner


def _with_lines(found: Sequence[Issue | Diagnostic], text: str, source: str) -> list[Diagnostic]:
    """Each with the line of its key, or of the nearest table above it."""
    lines: dict[tuple[str, ...], int] = {}
    for path, line in iter_keys(text):
        for depth in range(1, len(path) + 1):
            lines.setdefault(path[:depth], line)
    told = [one if isinstance(one, Diagnostic) else _complaint_at(one, lines, source) for one in found]
    return sorted(told, key=lambda one: (one.file != source, one.line or 0))[:MAX_COMPLAINTS]


def _complaint_at(found: Issue, lines: Mapping[tuple[str, ...], int], source: str) -> Diagnostic:
    path = tuple(str(part) for part in found.path)
    line = next((lines[path[:n]] for n in range(len(path), 0, -1) if path[:n] in lines), 1)
    return to_diagnostic(found, source, line, CATALOGUE)


_PLANT_TABLE = re.compile(r"^[ \t]*\[[ \t]*plant[ \t]*\][^\n]*\n(.*?)(?=^[ \t]*\[|\Z)", re.MULTILINE | re.DOTALL)
"""The table, in a file whose rest may be no TOML."""
_PLANT_ID = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}")


def state_directory_of(plant: str) -> Path:
    """The state directory that ``[plant]`` names, whatever else is wrong (ruling 5: no check drops a stop).

    Raises ConfigurationError, with every mistake, where not even that can be read.
    """
    table = _plant_table(Path(plant))
    directory, id = table.get("directory"), table.get("id")
    if isinstance(directory, str) and directory:
        return (Path(plant).resolve().parent / Path(directory).expanduser()).resolve()
    if directory is None and isinstance(id, str) and _PLANT_ID.fullmatch(id):
        return state_directory(id)
    return load(plant).directory


def _plant_table(file: Path) -> dict[str, Any]:
    """``[plant]``; empty where it can't be read."""
    try:
        found = _PLANT_TABLE.search(file.read_text(encoding="utf-8", errors="replace"))
        return {} if found is None else tomllib.loads(found[1])
    except (OSError, tomllib.TOMLDecodeError):
        return {}
