"""Where a plant keeps its state, from a file that may be full of mistakes: whoever stops everything needs no more."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from drivebus.service.config.build import state_directory
from drivebus.service.config.load import load

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
