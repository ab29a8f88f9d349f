"""The golden frames of ``vectors/`` as Python values."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parent.parent / "vectors"
FAMILIES = ("c320", "dzb100", "vc660", "df800")


@dataclass(frozen=True)
class Vector:
    """One worked frame."""

    id: str
    family: str
    encoding: str
    direction: str
    data: bytes
    fields: dict[str, Any]
    line: dict[str, Any]

    @property
    def canonical(self) -> bytes | None:
        text = self.line.get("canonical_hex")
        return None if text is None else bytes.fromhex(text)

    @property
    def plain(self) -> bool:
        """Neither misprinted nor doing something else than it says."""
        return "erratum" not in self.line and "hazard" not in self.line

    @property
    def request(self) -> Vector | None:
        """The request that this reply answers."""
        name = self.line.get("reply_to")
        return None if name is None else next(each for each in load(self.family) if each.id == name)


@cache
def load(family: str) -> tuple[Vector, ...]:
    """All vectors of a family."""
    lines = (FOLDER / f"{family}.jsonl").read_text(encoding="utf-8").splitlines()
    return tuple(_vector(json.loads(line)) for line in lines)


def _vector(line: dict[str, Any]) -> Vector:
    names = ("id", "family", "encoding", "direction")
    return Vector(*(line[name] for name in names), bytes.fromhex(line["hex"]), line["fields"], line)


def everything() -> tuple[Vector, ...]:
    """All vectors of all families."""
    return tuple(each for family in FAMILIES for each in load(family))
