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
from drivebus.profiles import build, check, complaint, locate, shape
from drivebus.profiles.complaint import Problem, problem
from drivebus.profiles.model import DriveProfile
from drivebus.profiles.notation import nearest
from drivebus.profiles.schema import FORMAT, ProfileIn

DATA = Path(__file__).parent / "data"
MOST_BYTES = 1_000_000
"""A profile is some kilobytes."""


@dataclass(frozen=True, slots=True)
class _Source:
    """One file of a chain: the user's first, then what it extends."""

    path: Path
    text: str
    data: Mapping[str, Any]


def models() -> list[str]:
    """Names that ``load`` knows: those that come with drivebus, then the user's own."""
    own = []
    with suppress(ProfileError):  # a directory that this user may not read
        own = sorted(_own())
    return [*_shipped(), *own]


def load(model: str | Path) -> DriveProfile:
    """The profile of a model by name, or of a TOML file by path.

    Raises ProfileError; its params carry file, line, key, found, expected, remedy and every fault as ``complaints``.
    """
    path = _find(model)
    return _shipped_profile(path) if path.is_relative_to(DATA) else _profile(path)


@cache
def _shipped_profile(path: Path) -> DriveProfile:
    """One parse a process; profiles are frozen, so they can be shared. A user's file may change, and is read again."""
    return _profile(path)


def _profile(path: Path) -> DriveProfile:
    sources = _chain(path)
    merged = _merged(sources)
    try:
        profile_in = ProfileIn.model_validate(merged)
    except ValidationError as error:
        raise _refuse(sources, shape.from_pydantic(error)) from None
    problems = list(check.problems(profile_in))
    if problems:
        raise _refuse(sources, problems)
    return build.profile(profile_in, str(path))


@cache
def _shipped() -> dict[str, Path]:
    """Files whose name begins with ``_`` are only extended, they are no model."""
    families = [_toml_files(family) for family in sorted(_inside(DATA)) if family.is_dir()]
    return {path.stem: path for files in families for path in files if not path.name.startswith("_")}


def own_directory() -> Path:
    """Where the user's own profiles are looked for."""
    base = os.environ.get("XDG_CONFIG_HOME")
    return (Path(base) if base else Path.home() / ".config") / "drivebus" / "profiles"


def _own() -> dict[str, Path]:
    return {path.stem: path for path in _toml_files(own_directory())}


def _toml_files(folder: Path) -> list[Path]:
    return sorted(path for path in _inside(folder) if path.suffix == ".toml")


def _inside(folder: Path) -> list[Path]:
    """What is in a folder; nothing where there is none. Raises ProfileError: no file is missing because its folder
    could not be read."""
    try:
        return list(folder.iterdir())
    except FileNotFoundError:
        return []
    except OSError as error:
        raise _lone(folder, problem("unreadable", (), error.strerror or str(error))) from None


def _find(model: str | Path, beside: Path | None = None) -> Path:
    """The file of a model name or path. Raises ProfileError where there is none, or two of one name."""
    name = str(model)
    if isinstance(model, Path) or name.endswith(".toml") or "/" in name or os.sep in name:
        path = (beside or Path()) / Path(name).expanduser()
        if not path.is_file():
            raise _lone(path, problem("no_file", (), name))
        return path.resolve()
    shipped, own = _shipped().get(name), None
    with suppress(ProfileError) if shipped else nullcontext():
        own = _own().get(name)
    if shipped and own:
        raise _lone(own, problem("shadows", (), name))
    found = shipped or own
    if found is None:
        known = models()
        near = ", ".join(nearest(name, known) or known)
        raise _lone(Path(name), problem("no_model", (), name, known=", ".join(known), near=near))
    return found


def _lone(path: Path, found: Problem, line: int | None = None) -> ProfileError:
    return complaint.refusal([complaint.complain(found, str(path), line)])


def _chain(path: Path) -> list[_Source]:
    """The file and all that it extends. Raises ProfileError for a circle, a missing base or bad TOML."""
    sources = [_read(path)]
    while (base := sources[-1].data.get("extends")) is not None:
        here = sources[-1]
        if not isinstance(base, str):
            raise _refuse([here], [problem("type", ("extends",), base, type=complaint.both("profiles.type.string"))])
        base_path = _base(here, base)
        if any(source.path == base_path for source in sources):
            circle = " -> ".join(source.path.name for source in sources) + f" -> {base_path.name}"
            raise _refuse([here], [problem("circle", ("extends",), base, circle=circle)])
        sources.append(_read(base_path))
    return sources


def _base(here: _Source, base: str) -> Path:
    try:
        return _find(base, here.path.parent)
    except ProfileError as error:
        if error.params["file"] == str(here.path):
            raise
        known = ", ".join(models())
        raise _refuse([here], [problem("no_base", ("extends",), base, known=known)]) from None


def _read(path: Path) -> _Source:
    """One file as text and data. Only its format and encoding are judged here."""
    raw = _bytes(path)
    if raw.startswith(b"\xef\xbb\xbf"):
        raise _lone(path, problem("bom", (), "EF BB BF"), 1)
    try:
        text = raw.decode("utf-8").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise _lone(path, problem("encoding", (), f"{raw[error.start]:02X}H"), line) from None
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise _lone(path, problem("toml", (), str(error).split(" (at ")[0]), _toml_line(error, text)) from None
    source = _Source(path, text, data)
    version = data.get("format")
    if type(version) is not int or not 1 <= version <= FORMAT:
        kind = "newer" if type(version) is int and version > FORMAT else "format"
        raise _refuse([source], [problem(kind, ("format",), version, newest=FORMAT)])
    return source


def _bytes(path: Path) -> bytes:
    """What claims to be empty is not read: a path may come from afar, and /proc has files without an end."""
    try:
        size = path.stat().st_size
        if size > MOST_BYTES:
            raise _lone(path, problem("too_large", (), size, most=MOST_BYTES), 1)
        with path.open("rb") as file:
            return file.read(MOST_BYTES) if size else b""
    except OSError as error:
        raise _lone(path, problem("unreadable", (), error.strerror or str(error))) from None


def _toml_line(error: tomllib.TOMLDecodeError, text: str) -> int:
    at = re.search(r"line (\d+)", str(error))
    return int(at[1]) if at else text.rstrip("\n").count("\n") + 1


def _merged(sources: list[_Source]) -> dict[str, Any]:
    """The last base first, each file over it; ``extends`` itself is gone."""
    result: dict[str, Any] = {}
    for source in reversed(sources):
        data = {key: value for key, value in source.data.items() if key != "extends"}
        result = _over(
            result, data | {name: _vouched(data[name]) for name in ("signals", "parameters") if name in data}
        )
    return result


def _vouched(table: Any) -> Any:
    """Whoever writes a ``factor`` knows the step, whatever the file below says; ``scale_published`` overrules."""
    if not isinstance(table, Mapping):
        return table
    return {
        name: {"scale_published": True, **entry} if isinstance(entry, Mapping) and "factor" in entry else entry
        for name, entry in table.items()
    }


def _over(base: Mapping[str, Any], top: Mapping[str, Any]) -> dict[str, Any]:
    """Tables merge key by key; everything else, lists too, is replaced."""
    merged = dict(base)
    for key, value in top.items():
        below = merged.get(key)
        merged[key] = _over(below, value) if isinstance(value, Mapping) and isinstance(below, Mapping) else value
    return merged


def _refuse(sources: list[_Source], problems: list[Problem]) -> ProfileError:
    """Every problem at the line where its key stands: in the nearest file that has it."""
    placed = sorted((_placed(sources, found) for found in problems), key=lambda c: (c.file, c.line or 0))
    return complaint.refusal(placed)


def _placed(sources: list[_Source], found: Problem) -> complaint.Complaint:
    for source in sources:
        for path in (found.path, *found.also):
            if locate.has(source.text, path):
                return _at(source, replace(found, path=path))
    return _at(max(sources, key=lambda source: _depth(source, found)), found)


def _at(source: _Source, found: Problem) -> complaint.Complaint:
    return complaint.complain(found, str(source.path), locate.line_of(source.text, found.path) or 1)


def _depth(source: _Source, found: Problem) -> int:
    """How many parts of the path stand in this file."""
    return max((n for n in range(len(found.path) + 1) if locate.has(source.text, found.path[:n])), default=0)
