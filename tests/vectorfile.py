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

    def __repr__(self) -> str:
        return self.id

    @property
    def canonical(self) -> bytes | None:
        """What a correct sender emits, where the line says that it is something else than printed."""
        text = self.line.get("canonical_hex")
        return None if text is None else bytes.fromhex(text)

    @property
    def correct(self) -> bytes:
        """What a correct sender emits."""
        return self.canonical or self.data

    @property
    def misprinted(self) -> bool:
        return "erratum" in self.line

    @property
    def hazardous(self) -> bool:
        return "hazard" in self.line

    @property
    def ambiguous(self) -> bool:
        return "ambiguous" in self.line

    @property
    def plain(self) -> bool:
        """Neither misprinted nor doing something else than it says."""
        return not self.misprinted and not self.hazardous

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


def by_id(family: str) -> dict[str, Vector]:
    """All vectors of a family by their names."""
    return {vector.id: vector for vector in load(family)}


def _vector(line: dict[str, Any]) -> Vector:
    names = ("id", "family", "encoding", "direction")
    return Vector(*(line[name] for name in names), bytes.fromhex(line["hex"]), line["fields"], line)


def everything() -> tuple[Vector, ...]:
    """All vectors of all families."""
    return tuple(each for family in FAMILIES for each in load(family))
