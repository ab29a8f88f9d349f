"""Loading of a ``plant.toml``: its configuration, or an error that names every issue with line, key and remedy.

The state directory can be found even in a faulty file, because a stop of the whole plant needs nothing else.
"""

from __future__ import annotations

import copy
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
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
    unreadable_issue,
)
from drivebus.profiles.toml_file import MAX_TOML_BYTES, TomlFault, decode_toml, format_issue, iter_keys
from drivebus.service.config import build, check, check_buses
from drivebus.service.config.build import ParsedPlant, state_directory
from drivebus.service.config.database import remote_hosts, unverified_sslmode
from drivebus.service.config.gateways import installed_gateways, plant_file_schema
from drivebus.service.config.model import PlantConfig
from drivebus.service.config.redaction import restore_url
from drivebus.service.config.schema import PLANT_FILE_FORMAT, PlantFile
from drivebus.service.ids import ID_PATTERN
from drivebus.user_directories import expand_home

CATALOGUE = "plant_config"
MAX_DIAGNOSTICS = 100
"""Issues reported for one file, so that a hostile file cannot cost more."""
MAX_VALIDATION_ROUNDS = 8
"""Rounds of removing faulty keys: a table without a required key is removed, then the table that held it."""
PLACEHOLDER_PLANT = {"id": "plant"}
"""Stands for a faulty ``[plant]`` or its id, so that the rest can be checked."""


def load(path: str | Path) -> PlantConfig:
    """Load a plant file. Raises ConfigurationError with every issue in its parameter ``diagnostics``."""
    where = Path(path)
    try:
        with where.open("rb") as file:
            raw = file.read(MAX_TOML_BYTES + 1)
    except OSError as error:
        raise config_error([unreadable_file_diagnostic(str(path), error, missing="no_plant_file")]) from None
    return _parse(raw, str(path), where.resolve().parent)


def loads(
    text: str,
    source: str = "plant.toml",
    base: Path | None = None,
    *,
    may_read_model: Callable[[Path], bool] = lambda path: True,
    history_url: str | None = None,
) -> PlantConfig:
    """Load a plant from a text, with relative paths from ``base``, else from here. Raises like ``load``.

    A profile file that ``may_read_model`` refuses is an error of the text; the redacted form of ``history_url``, the
    database in use, stands for it in the text.
    """
    return _parse(text.encode(), source, (base or Path()).resolve(), may_read_model, history_url)


def unreadable_file_diagnostic(path: str, error: OSError, *, missing: str = "no_file") -> Diagnostic:
    """Return the diagnostic of a file that cannot be read; ``missing``: its kind for a file that does not exist."""
    problem = issue(missing, (), None) if isinstance(error, FileNotFoundError) else unreadable_issue(error)
    return to_diagnostic(problem, path, None, CATALOGUE)


def config_error(diagnostics: Sequence[Diagnostic]) -> ConfigurationError:
    return ConfigurationError("plant_config.refused", **error_params(diagnostics))


def _single_error(source: str, fault: Issue, line: int | None) -> ConfigurationError:
    return config_error([to_diagnostic(fault, source, line, CATALOGUE)])


def _parse(
    content: bytes,
    source: str,
    base: Path,
    may_read_model: Callable[[Path], bool] = lambda path: True,
    history_url: str | None = None,
) -> PlantConfig:
    try:
        text, raw = decode_toml(content)
    except TomlFault as fault:
        raise _single_error(source, fault.issue, fault.line) from None
    issues: list[Issue | Diagnostic] = [each for each in (format_issue(raw, PLANT_FILE_FORMAT),) if each is not None]
    parsed = None
    if not issues:
        file, faults = _validate(raw)
        issues += faults
        if file is not None:
            url = restore_url(file.history.url, history_url)
            file = file.model_copy(update={"history": file.history.model_copy(update={"url": url})})
            parsed = ParsedPlant(file=file, raw=raw, base=base, may_read_model=may_read_model)
            issues += check.all_issues(parsed)
    if issues:
        raise config_error(_with_lines(issues, text, source))
    assert parsed is not None
    unsafe = [*check_buses.interval_warnings(parsed), *_database_warnings(parsed.file.history.url)]
    warnings = _with_lines(unsafe, text, source)
    return build.plant_config(parsed, source, warnings)


def _database_warnings(url: str | None) -> Iterator[Issue]:
    """Yield a database elsewhere whose certificate the URL leaves unverified."""
    mode = None if url is None else unverified_sslmode(url)
    if url is not None and mode is not None:
        yield issue("unverified_database", ("history", "url"), f"sslmode={mode}", host=tuple(remote_hosts(url)))


def _validate(raw: Mapping[str, Any]) -> tuple[PlantFile | None, list[Issue]]:
    """Validate a file and return its model and the issues. Faulty keys are removed, so that the rest can be checked."""
    rest: dict[str, Any] = copy.deepcopy(dict(raw))
    faults: list[Issue] = []
    schema = plant_file_schema()
    for _ in range(MAX_VALIDATION_ROUNDS):
        try:
            return schema.model_validate(rest), faults
        except ValidationError as error:
            issues = [_name_gateways(each) for each in issues_from_pydantic(error, schema, rest)]
        faults += [each for each in issues if not _is_consequence(each, faults)]
        for fault in issues:
            if fault.path in (("plant",), ("plant", "id")):
                plant = rest.get("plant")
                rest["plant"] = (plant if isinstance(plant, dict) else {}) | PLACEHOLDER_PLANT
            else:
                _remove_key(rest, fault.path[:-1] if fault.kind == "missing_key" else fault.path)
    return None, faults


def _name_gateways(fault: Issue) -> Issue:
    """Return the issue of an unknown table ``[gateway.<name>]`` with the installed gateways, any other as it is."""
    if fault.kind == "unknown_key" and fault.path[0] == "gateway" and len(fault.path) == 2:
        return issue("unknown_gateway", fault.path, fault.found, known=tuple(installed_gateways()))
    return fault


def _is_consequence(missing: Issue, faults: Sequence[Issue]) -> bool:
    """Return whether a missing key is the consequence of a faulty key of its table that was removed."""
    table = missing.path[:-1]
    return missing.kind == "missing_key" and any(fault.path[: len(table)] == table for fault in faults)


def _remove_key(data: Any, path: Sequence[str | int]) -> None:
    """Remove a key. An entry of a list removes its whole list, so that no index shifts."""
    for depth, part in enumerate(path):
        inner = data.get(part) if isinstance(data, dict) else None
        if depth == len(path) - 1 or not isinstance(inner, dict):
            if isinstance(data, dict):
                data.pop(part, None)
            return
        data = inner


def _with_lines(unlocated: Sequence[Issue | Diagnostic], text: str, source: str) -> list[Diagnostic]:
    """Return diagnostics with the line of their key, or of the nearest table above it."""
    lines: dict[tuple[str, ...], int] = {}
    for path, line in iter_keys(text):
        for depth in range(1, len(path) + 1):
            lines.setdefault(path[:depth], line)
    diagnostics = [
        fault if isinstance(fault, Diagnostic) else _diagnostic_at(fault, lines, source) for fault in unlocated
    ]
    return sorted(diagnostics, key=lambda fault: (fault.file != source, fault.line or 0))[:MAX_DIAGNOSTICS]


def _diagnostic_at(fault: Issue, lines: Mapping[tuple[str, ...], int], source: str) -> Diagnostic:
    path = tuple(str(part) for part in fault.path)
    line = next((lines[path[:n]] for n in range(len(path), 0, -1) if path[:n] in lines), 1)
    return to_diagnostic(fault, source, line, CATALOGUE)


_PLANT_TABLE = re.compile(r"^[ \t]*\[[ \t]*plant[ \t]*\][^\n]*\n(.*?)(?=^[ \t]*\[|\Z)", re.MULTILINE | re.DOTALL)
"""Finds the table in a file whose rest may be invalid TOML."""


def state_directory_of(plant: str) -> Path:
    """Return the state directory named in ``[plant]``, whatever else is wrong: no faulty file may prevent a stop.

    Raises ConfigurationError with every issue if not even that can be read.
    """
    table = _plant_table(Path(plant))
    directory, id = table.get("directory"), table.get("id")
    if isinstance(directory, str) and directory:
        return (Path(plant).resolve().parent / expand_home(directory)).resolve()
    if directory is None and isinstance(id, str) and re.fullmatch(ID_PATTERN, id):
        return state_directory(id)
    return load(plant).directory


def _plant_table(file: Path) -> dict[str, Any]:
    """Return the table ``[plant]``; empty if it cannot be read."""
    try:
        match = _PLANT_TABLE.search(file.read_text(encoding="utf-8-sig", errors="replace"))
        return {} if match is None else tomllib.loads(match[1])
    except (OSError, ValueError, RecursionError):  # ValueError also for a number with too many digits for Python
        return {}
