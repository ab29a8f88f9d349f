"""The committed figures of ``make coverage``: no branch of protocols, transaction, scheduler and gate is left out."""

from __future__ import annotations

import json
from pathlib import Path

from coverage_report import COVERED_PATHS, REPORT, ROOT


def test_every_branch_of_the_covered_files_was_run() -> None:
    found = json.loads(REPORT.read_text(encoding="utf-8"))
    assert (found["total"]["missing_statements"], found["total"]["missing_branches"]) == (0, 0)
    assert not found["commit"].endswith("-dirty")
    modules = {str(path.relative_to(ROOT)) for place in COVERED_PATHS for path in _files(place)}
    assert {name for name in modules if name not in found["files"]} <= {"src/drivebus/protocols/__init__.py"}


def _files(place: str) -> list[Path]:
    return list((ROOT / place.removesuffix("*")).rglob("*.py")) if place.endswith("*") else [ROOT / place]
