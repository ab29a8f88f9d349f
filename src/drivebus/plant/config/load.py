"""TOML → ``PlantSetting``, or a refusal that names every mistake: file, line, key, found, expected, remedy."""

from __future__ import annotations

import copy
import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from drivebus.errors import ConfigurationError
from drivebus.plant.config import build, check
from drivebus.plant.config.draft import Draft
from drivebus.plant.config.schema import FORMAT, PlantFile
from drivebus.plant.model import PlantSetting
from drivebus.profiles import locate, shape
from drivebus.profiles.complaint import Complaint, Problem, complain, facts, problem

ROOM = "plant_config"
MOST = 100
"""So many complaints of one file are told: nobody reads more, and a file from afar must not cost more."""
MOST_BYTES = 1_000_000
ROUNDS = 8
"""A table without the key it needs is put aside, then what held it: a file is no deeper."""
STAND_IN = {"id": "plant"}
"""For a ``[plant]`` or its id that is put aside: no file is without them, and the rest can still be checked."""


def load(path: str | Path) -> PlantSetting:
    """The plant of a file. Raises ConfigurationError; its params carry every fault as ``complaints``."""
    where = Path(path)
    try:
        with where.open("rb") as file:
            raw = file.read(MOST_BYTES + 1)
    except OSError as error:
        raise refusal([unread(str(path), error)]) from None
    return _parsed(_text(raw, str(path)), str(path), where.resolve().parent)


def loads(text: str, source: str = "plant.toml", base: Path | None = None) -> PlantSetting:
    """The plant of a text; relative paths count from ``base`` (else from here). Raises as ``load`` does."""
    return _parsed(_text(text.encode(), source), source, (base or Path()).resolve())


def unread(path: str, error: OSError) -> Complaint:
    """Of a file that the system does not give."""
    missing = isinstance(error, FileNotFoundError)
    found = problem("no_file", (), path) if missing else problem("unreadable", (), error.strerror or str(error))
    return complain(found, path, None, ROOM)


def refusal(complaints: Sequence[Complaint]) -> ConfigurationError:
    return ConfigurationError("plant_config.refused", **facts(complaints))


def _text(raw: bytes, source: str) -> str:
    """Judges size and encoding only."""
    if len(raw) > MOST_BYTES:
        raise _lone(source, problem("too_large", (), len(raw), most=MOST_BYTES), 1)
    if raw.startswith(b"\xef\xbb\xbf"):
        raise _lone(source, problem("bom", (), "EF BB BF"), 1)
    try:
        return raw.decode("utf-8").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise _lone(source, problem("encoding", (), f"{raw[error.start]:02X}H"), line) from None


def _lone(source: str, found: Problem, line: int | None) -> ConfigurationError:
    return refusal([complain(found, source, line, ROOM)])


def _parsed(text: str, source: str, base: Path) -> PlantSetting:
    try:
        raw = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise refusal([no_toml(source, error, text)]) from None
    except RecursionError:
        raise _lone(source, problem("toml", (), "[[[["), 1) from None
    found: list[Problem | Complaint] = list(_version(raw))
    draft = None
    if not found:
        file, faults = _shaped(raw)
        found += faults
        if file is not None:
            draft = Draft(file, raw, base)
            found += check.problems(draft)
    if found:
        raise refusal(_placed(found, text, source))
    assert draft is not None
    return build.plant(draft, source)


def no_toml(source: str, error: tomllib.TOMLDecodeError, text: str) -> Complaint:
    """With the line that the reader stumbled over; the last one where it does not tell."""
    at = re.search(r"line (\d+)", str(error))
    line = int(at[1]) if at else text.rstrip("\n").count("\n") + 1
    return complain(problem("toml", (), str(error).split(" (at ")[0]), source, line, ROOM)


def _version(raw: Mapping[str, Any]) -> list[Problem]:
    version = raw.get("format")
    if type(version) is int and 1 <= version <= FORMAT:
        return []
    kind = "newer" if type(version) is int and version > FORMAT else "format"
    return [problem(kind, ("format",), version, newest=FORMAT)]


def _shaped(raw: Mapping[str, Any]) -> tuple[PlantFile | None, list[Problem]]:
    """What is well-formed, and all that is not: faulty keys are put aside, so that the rest can still be checked."""
    rest: dict[str, Any] = copy.deepcopy(dict(raw))
    faults: list[Problem] = []
    for _ in range(ROUNDS):
        try:
            return PlantFile.model_validate(rest), faults
        except ValidationError as error:
            found = shape.from_pydantic(error, PlantFile)
        faults += [one for one in found if not _follows(one, faults)]
        for one in found:
            if one.path in (("plant",), ("plant", "id")):
                plant = rest.get("plant")
                rest["plant"] = (plant if isinstance(plant, dict) else {}) | STAND_IN
            else:
                _drop(rest, one.path[:-1] if one.kind == "missing_key" else one.path)
    return None, faults


def _follows(one: Problem, faults: Sequence[Problem]) -> bool:
    """A key is missing now because a faulty one of its table was put aside before."""
    table = one.path[:-1]
    return one.kind == "missing_key" and any(told.path[: len(table)] == table for told in tuple(faults))


def _drop(data: Any, path: Sequence[str | int]) -> None:
    """Take a key away; an entry of a list takes its whole list with it, so that no index shifts."""
    for depth, part in enumerate(path):
        inner = data.get(part) if isinstance(data, dict) else None
        if depth == len(path) - 1 or not isinstance(inner, dict):
            if isinstance(data, dict):
                data.pop(part, None)
            return
        data = inner


def _placed(found: Sequence[Problem | Complaint], text: str, source: str) -> list[Complaint]:
    """Each with the line of its key, or of the nearest table above it."""
    lines: dict[tuple[str, ...], int] = {}
    for path, line in locate.keys(text):
        for depth in range(1, len(path) + 1):
            lines.setdefault(path[:depth], line)
    told = [one if isinstance(one, Complaint) else _at(one, lines, source) for one in found]
    return sorted(told, key=lambda one: (one.file != source, one.line or 0))[:MOST]


def _at(found: Problem, lines: Mapping[tuple[str, ...], int], source: str) -> Complaint:
    path = tuple(str(part) for part in found.path)
    line = next((lines[path[:n]] for n in range(len(path), 0, -1) if path[:n] in lines), 1)
    return complain(found, source, line, ROOM)
