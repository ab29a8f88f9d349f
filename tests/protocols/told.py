"""What ``describe`` tells of many frames, in full: told.jsonl, one line each.

A line is a frame with the options of ``describe``, and what it said when the line was written. After a change that is
meant, ``PYTHONPATH=tests python -m protocols.told`` writes them again; the difference is to be read line by line.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from drivebus.protocols import dzb, modbus, sifang
from drivebus.protocols.describe import Candidate, Description, Words

LINES = Path(__file__).with_suffix(".jsonl")
DESCRIBE: dict[str, Any] = {"c320": sifang.describe, "dzb100": dzb.describe, "modbus": modbus.describe}


def told(line: dict[str, Any]) -> dict[str, Any]:
    """What is said of the line's frame now, as JSON has it."""
    options = {name: line[name] for name in ("encoding", "direction", "error_form") if name in line}
    if "request" in line:
        options["request"] = bytes.fromhex(line["request"])
    found: Description = DESCRIBE[line["family"]](bytes.fromhex(line["hex"]), **options)
    said = {name: getattr(found, name) for name in Description.__slots__}
    kept = {
        name: value for name, value in said.items() if value not in ((), {}) and (name, value) != ("canonical", None)
    }
    return json.loads(json.dumps(kept, default=plain))  # type: ignore[no-any-return]


def plain(value: object) -> object:
    if isinstance(value, bytes):
        return value.hex(" ")
    if isinstance(value, Words):
        return [value.en, value.zh]
    assert isinstance(value, Candidate)
    return {"note": value.note, "fields": dict(value.fields)}


def lines() -> list[dict[str, Any]]:
    return [json.loads(line) for line in LINES.read_text(encoding="utf-8").splitlines()]


if __name__ == "__main__":
    again = [line | {"told": told(line)} for line in lines()]
    LINES.write_text("".join(json.dumps(line, ensure_ascii=False) + "\n" for line in again), encoding="utf-8")
