"""The golden frames of ``vectors/*.jsonl`` as test cases."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2] / "vectors"


@dataclass(frozen=True)
class Vector:
    """One line of a file."""

    line: dict[str, Any]

    def __getattr__(self, name: str) -> Any:
        return self.line.get(name)

    def __repr__(self) -> str:
        return str(self.line["id"])

    @property
    def bytes(self) -> bytes:
        return bytes.fromhex(self.line["hex"])

    @property
    def canonical(self) -> bytes:
        """What a correct sender emits."""
        return bytes.fromhex(self.line.get("canonical_hex", self.line["hex"]))


def load(family: str) -> dict[str, Vector]:
    lines = (ROOT / f"{family}.jsonl").read_text(encoding="utf-8").splitlines()
    return {vector.id: vector for vector in map(Vector, map(json.loads, lines))}
