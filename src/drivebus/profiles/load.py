"""TOML → ``DriveProfile``: finds the file, follows ``extends``, and refuses with file, line, key and remedy.

Three places, in this order: the profiles that come with drivebus, the user's own directory
(``$XDG_CONFIG_HOME/drivebus/profiles``), a path. A user's profile may not take the name of one that comes with
drivebus: nobody's ``vc660`` changes silently.
"""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Mapping
from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from drivebus.errors import ProfileError
from drivebus.profiles import build, check, diagnostics, schema_errors, toml_lines
from drivebus.profiles.diagnostics import Issue, issue
from drivebus.profiles.model import DriveProfile
from drivebus.profiles.notation import nearest_names
from drivebus.profiles.schema import NEWEST_FORMAT, ProfileIn

DATA_DIRECTORY = Path(__file__).parent / "data"
MAX_PROFILE_BYTES = 1_000_000
"""A profile is some kilobytes."""


@dataclass(frozen=True, slots=True)
class _TomlSource:
    """One file of a chain: the user's first, then what it extends."""

    path: Path
    text: str
    data: Mapping[str, Any]


def models() -> list[str]:
    """Names that ``load`` knows: those that come with drivebus, then the user's own."""
    own = []
    with suppress(ProfileError):  # a directory that this user may not read
        own = sorted(_user_files())
    return [*_builtin_files(), *own]


def load(model: str | Path) -> DriveProfile:
    """The profile of a model by name, or of a TOML file by path.

    Raises ProfileError; its params carry file, line, key, found, expected, remedy and every fault as ``complaints``.
    """
    path = _find_file(model)
    return _builtin_profile(path) if path.is_relative_to(DATA_DIRECTORY) else _load_profile(path)


@cache
def _builtin_profile(path: Path) -> DriveProfile:
    """One parse a process; profiles are frozen, so they can be shared. A user's file may change, and is read again."""
    return _load_profile(path)


def _load_profile(path: Path) -> DriveProfile:
    sources = _read_chain(path)
    merged = _merge_chain(sources)
    try:
        profile_in = ProfileIn.model_validate(merged)
    except ValidationError as error:
        raise _located_error(sources, schema_errors.issues_from_pydantic(error)) from None
    problems = list(check.check_profile(profile_in))
    if problems:
        raise _located_error(sources, problems)
    return build.build_profile(profile_in, str(path))


@cache
def _builtin_files() -> dict[str, Path]:
    """Files whose name begins with ``_`` are only extended, they are no model."""
    families = [_toml_files(family) for family in sorted(_list_directory(DATA_DIRECTORY)) if family.is_dir()]
    return {path.stem: path for files in families for path in files if not path.name.startswith("_")}


def user_directory() -> Path:
    """Where the user's own profiles are looked for."""
    base = os.environ.get("XDG_CONFIG_HOME")
    return (Path(base) if base else Path.home() / ".config") / "drivebus" / "profiles"


def _user_files() -> dict[str, Path]:
    return {path.stem: path for path in _toml_files(user_directory())}


def _toml_files(folder: Path) -> list[Path]:
    return sorted(path for path in _list_directory(folder) if path.suffix == ".toml")


def _list_directory(folder: Path) -> list[Path]:
    """What is in a folder; nothing where there is none. Raises ProfileError: no file is missing because its folder
    could not be read."""
    try:
        return list(folder.iterdir())
    except FileNotFoundError:
        return []
    except OSError as error:
        raise _single_error(folder, issue("unreadable", (), error.strerror or str(error))) from None


def _find_file(model: str | Path, beside: Path | None = None) -> Path:
    """The file of a model name or path. Raises ProfileError where there is none, or two of one name."""
    name = str(model)
    if isinstance(model, Path) or name.endswith(".toml") or "/" in name or os.sep in name:
        path = (beside or Path()) / Path(name).expanduser()
        if not path.is_file():
            raise _single_error(path, issue("no_file", (), name))
        return path.resolve()
    shipped, own = _builtin_files().get(name), None
    with suppress(ProfileError) if shipped else nullcontext():
        own = _user_files().get(name)
    if shipped and own:
        raise _single_error(own, issue("shadows", (), name))
    found = shipped or own
    if found is None:
        known = models()
        near = ", ".join(nearest_names(name, known) or known)
        raise _single_error(Path(name), issue("no_model", (), name, known=", ".join(known), near=near))
    return found


def _single_error(path: Path, found: Issue, line: int | None = None) -> ProfileError:
    return diagnostics.profile_error([diagnostics.to_diagnostic(found, str(path), line)])


def _read_chain(path: Path) -> list[_TomlSource]:
    """The file and all that it extends. Raises ProfileError for a circle, a missing base or bad TOML."""
    sources = [_read_source(path)]
    while (base := sources[-1].data.get("extends")) is not None:
        here = sources[-1]
        if not isinstance(base, str):
            raise _located_error(
                [here], [issue("type", ("extends",), base, type=diagnostics.bilingual_text("profiles.type.string"))]
            )
        base_path = _base_path(here, base)
        if any(source.path == base_path for source in sources):
            circle = " -> ".join(source.path.name for source in sources) + f" -> {base_path.name}"
            raise _located_error([here], [issue("circle", ("extends",), base, circle=circle)])
        sources.append(_read_source(base_path))
    return sources


def _base_path(here: _TomlSource, base: str) -> Path:
    try:
        return _find_file(base, here.path.parent)
    except ProfileError as error:
        if error.params["file"] == str(here.path):
            raise
        known = ", ".join(models())
        raise _located_error([here], [issue("no_base", ("extends",), base, known=known)]) from None


def _read_source(path: Path) -> _TomlSource:
    """One file as text and data. Only its format and encoding are judged here."""
    raw = _read_bytes(path)
    if raw.startswith(b"\xef\xbb\xbf"):
        raise _single_error(path, issue("bom", (), "EF BB BF"), 1)
    try:
        text = raw.decode("utf-8").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise _single_error(path, issue("encoding", (), f"{raw[error.start]:02X}H"), line) from None
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise _single_error(path, issue("toml", (), str(error).split(" (at ")[0]), _error_line(error, text)) from None
    source = _TomlSource(path, text, data)
    version = data.get("format")
    if type(version) is not int or not 1 <= version <= NEWEST_FORMAT:
        kind = "newer" if type(version) is int and version > NEWEST_FORMAT else "format"
        raise _located_error([source], [issue(kind, ("format",), version, newest=NEWEST_FORMAT)])
    return source


def _read_bytes(path: Path) -> bytes:
    """What claims to be empty is not read: a path may come from afar, and /proc has files without an end."""
    try:
        size = path.stat().st_size
        if size > MAX_PROFILE_BYTES:
            raise _single_error(path, issue("too_large", (), size, most=MAX_PROFILE_BYTES), 1)
        with path.open("rb") as file:
            return file.read(MAX_PROFILE_BYTES) if size else b""
    except OSError as error:
        raise _single_error(path, issue("unreadable", (), error.strerror or str(error))) from None


def _error_line(error: tomllib.TOMLDecodeError, text: str) -> int:
    at = re.search(r"line (\d+)", str(error))
    return int(at[1]) if at else text.rstrip("\n").count("\n") + 1


def _merge_chain(sources: list[_TomlSource]) -> dict[str, Any]:
    """The last base first, each file over it; ``extends`` itself is gone."""
    result: dict[str, Any] = {}
    for source in reversed(sources):
        data = {key: value for key, value in source.data.items() if key != "extends"}
        result = _merge(
            result, data | {name: _inherit_scale(data[name]) for name in ("signals", "parameters") if name in data}
        )
    return result


def _inherit_scale(table: Any) -> Any:
    """Whoever writes a ``factor`` knows the step, whatever the file below says; ``scale_published`` overrules."""
    if not isinstance(table, Mapping):
        return table
    return {
        name: {"scale_published": True, **entry} if isinstance(entry, Mapping) and "factor" in entry else entry
        for name, entry in table.items()
    }


def _merge(base: Mapping[str, Any], top: Mapping[str, Any]) -> dict[str, Any]:
    """Tables merge key by key; everything else, lists too, is replaced."""
    merged = dict(base)
    for key, value in top.items():
        below = merged.get(key)
        merged[key] = _merge(below, value) if isinstance(value, Mapping) and isinstance(below, Mapping) else value
    return merged


def _located_error(sources: list[_TomlSource], problems: list[Issue]) -> ProfileError:
    """Every problem at the line where its key stands: in the nearest file that has it."""
    placed = sorted((_locate_issue(sources, found) for found in problems), key=lambda c: (c.file, c.line or 0))
    return diagnostics.profile_error(placed)


def _locate_issue(sources: list[_TomlSource], found: Issue) -> diagnostics.Diagnostic:
    for source in sources:
        for path in (found.path, *found.related):
            if toml_lines.has_key(source.text, path):
                return _diagnostic_in(source, replace(found, path=path))
    return _diagnostic_in(max(sources, key=lambda source: _matching_depth(source, found)), found)


def _diagnostic_in(source: _TomlSource, found: Issue) -> diagnostics.Diagnostic:
    return diagnostics.to_diagnostic(found, str(source.path), toml_lines.line_of(source.text, found.path) or 1)


def _matching_depth(source: _TomlSource, found: Issue) -> int:
    """How many parts of the path stand in this file."""
    return max((n for n in range(len(found.path) + 1) if toml_lines.has_key(source.text, found.path[:n])), default=0)
