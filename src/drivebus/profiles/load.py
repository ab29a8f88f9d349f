"""Loader of profiles: finds the TOML file, follows ``extends``, checks it and has the ``DriveProfile`` built.

A model name is searched among the profiles that come with drivebus, those of installed protocol families, and the
user's directory (``$XDG_CONFIG_HOME/drivebus/profiles``), in this order, in any case: ``VC660`` is ``vc660``. A user's
profile can't take the name of one of the others, so that no ``vc660`` changes silently.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Collection, Mapping
from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from drivebus.errors import ProfileError
from drivebus.profiles.build import build_profile
from drivebus.profiles.check import check_profile
from drivebus.profiles.diagnostics import (
    Diagnostic,
    Issue,
    control_character_issues,
    issue,
    issues_from_pydantic,
    nearest_names,
    profile_error,
    to_diagnostic,
    unreadable_issue,
)
from drivebus.profiles.model import DriveProfile
from drivebus.profiles.schema import NEWEST_FORMAT, ProfileFile
from drivebus.profiles.toml_file import MAX_TOML_BYTES, TomlFault, decode_toml, format_issue, has_key, line_of
from drivebus.protocols.family import protocol_families
from drivebus.user_directories import expand_home, user_config_directory
from drivebus.values import bilingual_text

DATA_DIRECTORY = Path(__file__).parent / "data"
EVIDENCE_KEYS = ("evidence", "standstill_evidence")
"""Keys whose table of languages is one source: half of it may not stem from an extended file."""


@dataclass(frozen=True, slots=True)
class _TomlSource:
    """File of an ``extends`` chain."""

    path: Path
    text: str
    data: Mapping[str, Any]


def models() -> list[str]:
    """Return the names that ``load`` accepts: built-in models, those of other families, then the user's."""
    own: list[str] = []
    with suppress(ProfileError):  # the directory may be unreadable
        own = sorted(_user_files())
    return [*included_models(), *own]


def included_models() -> list[str]:
    """Return the built-in models and those of other families, without the user's."""
    return [*_builtin_files(), *_family_files()]


def model_name(text: str) -> str:
    """Return the name of a model that a user typed in any case, as ``models`` spells it; an unknown one as it is."""
    return text if text in _builtin_files() else _in_any_case(text, models()) or text


def load(model: str | Path) -> DriveProfile:
    """Return the profile of a model by name, or of a TOML file by path.

    Raises ProfileError; its params carry file, line, key, found, expected, remedy and every fault as ``diagnostics``.
    """
    path = _find_file(model)
    return _builtin_profile(path) if path.is_relative_to(DATA_DIRECTORY) else _load_profile(path)


def profile_files(model: str | Path) -> list[Path]:
    """Return the file of a profile and, in this order, those that it extends. Raises ProfileError."""
    return [source.path for source in _read_chain(_find_file(model))]


def own_files(model: str | Path) -> list[Path]:
    """Return those files of a profile that are not installed with a family. Raises ProfileError."""
    installed = (DATA_DIRECTORY, *(family.profiles for family in protocol_families() if family.profiles is not None))
    files = profile_files(model)
    return [path for path in files if not any(path.is_relative_to(folder) for folder in installed)]


@cache
def _builtin_profile(path: Path) -> DriveProfile:
    """Load a built-in profile once per process; a user's file may change and is read again."""
    return _load_profile(path)


def _load_profile(path: Path) -> DriveProfile:
    sources = _read_chain(path)
    merged = _merge_chain(sources)
    try:
        profile_in = ProfileFile.model_validate(merged)
    except ValidationError as error:
        raise _located_error(sources, issues_from_pydantic(error, ProfileFile, merged)) from None
    issues = list(check_profile(profile_in))
    if issues:
        raise _located_error(sources, issues)
    return build_profile(profile_in, str(path))


@cache
def _builtin_files() -> dict[str, Path]:
    """Return the built-in models; a file whose name begins with ``_`` is only a base of others."""
    makers = [_toml_files(folder) for folder in sorted(_list_directory(DATA_DIRECTORY)) if folder.is_dir()]
    return {path.stem: path for files in makers for path in files if not path.name.startswith("_")}


def _family_files() -> dict[str, Path]:
    folders = [family.profiles for family in protocol_families() if family.profiles is not None]
    return {path.stem: path for folder in folders for path in _toml_files(folder) if not path.name.startswith("_")}


def user_directory() -> Path:
    """Return the directory of the user's profiles."""
    return user_config_directory() / "profiles"


def _user_files() -> dict[str, Path]:
    return {path.stem: path for path in _toml_files(user_directory())}


def _toml_files(folder: Path) -> list[Path]:
    return sorted(path for path in _list_directory(folder) if path.suffix == ".toml")


def _list_directory(folder: Path) -> list[Path]:
    """Return the entries of a folder; none where it does not exist. Raises ProfileError where it can't be read."""
    try:
        return list(folder.iterdir())
    except FileNotFoundError:
        return []
    except OSError as error:
        raise _single_error(folder, unreadable_issue(error)) from None


def _find_file(model: str | Path, beside: Path | None = None) -> Path:
    """Return the file of a model name or path. Raises ProfileError where there is none, or two of one name."""
    name = str(model)
    if isinstance(model, Path) or name.endswith(".toml") or "/" in name or os.sep in name:
        path = (beside or Path()) / expand_home(name)
        if path.is_dir():
            raise _single_error(path, unreadable_issue(IsADirectoryError(errno.EISDIR, "")))
        if not path.is_file():
            raise _single_error(path, issue("no_file", (), None))
        return path.resolve()
    shipped = _file_in_any_case(name, _builtin_files()) or _file_in_any_case(name, _family_files())
    own: Path | None = None
    with suppress(ProfileError) if shipped else nullcontext():  # an unreadable directory hides no shipped model
        own = _file_in_any_case(name, _user_files())
    if shipped and own and (own.stem == name or shipped.stem != name):
        raise _single_error(own, issue("shadows", (), name))
    file = shipped or own
    if file is None:
        raise _single_error(Path(name), issue("no_model", (), name, near=tuple(similar_models(name)) or "-"))
    return file


def _file_in_any_case(name: str, files: Mapping[str, Path]) -> Path | None:
    return files.get(_in_any_case(name, files) or "")


def _in_any_case(name: str, known: Collection[str]) -> str | None:
    """Return the one of the known names that equals ``name``, else the only one that differs in case alone."""
    if name in known:
        return name
    alike = [model for model in known if model.casefold() == name.casefold()]
    return alike[0] if len(alike) == 1 else None


def similar_models(name: str) -> list[str]:
    """Return the models whose names are nearest to a name."""
    return nearest_names(name, models())


def _single_error(path: Path, fault: Issue, line: int | None = None) -> ProfileError:
    return profile_error([to_diagnostic(fault, str(path), line)])


def _read_chain(path: Path) -> list[_TomlSource]:
    """Read a file and all that it extends, in this order. Raises ProfileError for a circle or a missing base."""
    sources = [_read_source(path)]
    while (base := sources[-1].data.get("extends")) is not None:
        here = sources[-1]
        if not isinstance(base, str):
            raise _located_error(
                [here], [issue("type", ("extends",), base, type=bilingual_text("profiles.type.string"))]
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
        near = tuple(similar_models(base)) or "-"
        raise _located_error([here], [issue("no_base", ("extends",), base, near=near)]) from None


def _read_source(path: Path) -> _TomlSource:
    """Read one file; only size, encoding, syntax and format are checked."""
    try:
        text, data = decode_toml(_read_bytes(path))
    except TomlFault as fault:
        raise _single_error(path, fault.issue, fault.line) from None
    source = _TomlSource(path, text, data)
    wrong_format = format_issue(data, NEWEST_FORMAT)
    if wrong_format is not None:
        raise _located_error([source], [wrong_format])
    unprintable = list(control_character_issues(data))
    if unprintable:
        raise _located_error([source], unprintable)
    return source


def _read_bytes(path: Path) -> bytes:
    """Read a file; one of size 0 is not opened, because a remote caller may name an endless file of /proc."""
    try:
        size = path.stat().st_size
        if size > MAX_TOML_BYTES:
            raise _single_error(path, issue("too_large", (), size, most=MAX_TOML_BYTES), 1)
        with path.open("rb") as file:
            return file.read(MAX_TOML_BYTES) if size else b""
    except OSError as error:
        raise _single_error(path, unreadable_issue(error)) from None


def _merge_chain(sources: list[_TomlSource]) -> dict[str, Any]:
    """Merge a chain, the last base first, without the key ``extends``."""
    merged: dict[str, Any] = {}
    for source in reversed(sources):
        data = {key: value for key, value in source.data.items() if key != "extends"}
        merged = _merge(
            merged,
            data | {name: _mark_scales_published(data[name]) for name in ("signals", "parameters") if name in data},
        )
    return merged


def _mark_scales_published(table: Any) -> Any:
    """Mark the scale of each entry with a ``factor`` as published, unless the entry itself states otherwise."""
    if not isinstance(table, Mapping):
        return table
    return {
        name: {"scale_published": True, **entry} if isinstance(entry, Mapping) and "factor" in entry else entry
        for name, entry in table.items()
    }


def _merge(base: Mapping[str, Any], top: Mapping[str, Any]) -> dict[str, Any]:
    """Merge tables key by key; other values, lists and evidence too, are replaced."""
    merged = dict(base)
    for key, value in top.items():
        below = merged.get(key)
        if isinstance(value, Mapping) and isinstance(below, Mapping) and key not in EVIDENCE_KEYS:
            merged[key] = _merge(below, value)
        else:
            merged[key] = value
    return merged


def _located_error(sources: list[_TomlSource], issues: list[Issue]) -> ProfileError:
    """Return the error with each issue at the line of its key, in the nearest file that has it."""
    located = [_locate_issue(sources, fault) for fault in issues]
    located.sort(key=lambda diagnostic: (diagnostic.file, diagnostic.line or 0))
    return profile_error(located)


def _locate_issue(sources: list[_TomlSource], fault: Issue) -> Diagnostic:
    for source in sources:
        for path in (fault.path, *fault.related):
            if has_key(source.text, path):
                return _diagnostic_in(source, replace(fault, path=path))
    return _diagnostic_in(max(sources, key=lambda source: _matching_depth(source, fault)), fault)


def _diagnostic_in(source: _TomlSource, fault: Issue) -> Diagnostic:
    return to_diagnostic(fault, str(source.path), line_of(source.text, fault.path) or 1)


def _matching_depth(source: _TomlSource, fault: Issue) -> int:
    """Return how many parts of the key path are in this file."""
    return max((n for n in range(len(fault.path) + 1) if has_key(source.text, fault.path[:n])), default=0)
