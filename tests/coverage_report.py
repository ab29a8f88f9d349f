"""Branch coverage of the critical modules from the last ``coverage run``: ``make coverage``.

Prints missing branches and writes docs/reports/coverage.json; fails where a branch of these modules is not run.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import coverage

from verification.report import current_commit

ROOT = Path(__file__).resolve().parents[1]
REPORT = ROOT / "docs" / "reports" / "coverage.json"
COVERED_PATHS = (
    "src/drivebus/protocols/*",
    "src/drivebus/bus/prepared_request.py",
    "src/drivebus/bus/scheduler.py",
    "src/drivebus/bus/transaction.py",
    "src/drivebus/drives/permissives.py",
)


def main() -> int:
    measured = coverage.Coverage(config_file=str(ROOT / "pyproject.toml"))
    measured.load()
    measured.json_report(include=list(COVERED_PATHS), outfile=str(REPORT))
    found = json.loads(REPORT.read_text(encoding="utf-8"))
    head = {
        "commit": current_commit(ROOT, "src", "tests"),
        "tool": f"coverage {coverage.__version__}",
        "python": sys.version.split()[0],
    }
    files = {name: summary(file) for name, file in sorted(found["files"].items()) if file["summary"]["num_statements"]}
    document = head | {"total": summary(found | {"summary": found["totals"]}), "files": files}
    REPORT.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    missing = {name: figures for name, figures in files.items() if "missing" in figures}
    print(
        json.dumps(document["total"]), *(f"{name}: {figures['missing']}" for name, figures in missing.items()), sep="\n"
    )
    return int(bool(missing))


def summary(document: dict[str, Any]) -> dict[str, Any]:
    counted = document["summary"]
    made = {
        "statements": counted["num_statements"],
        "branches": counted["num_branches"],
        "missing_statements": counted["missing_lines"],
        "missing_branches": counted["missing_branches"],
    }
    missing = [*document.get("missing_lines", ()), *document.get("missing_branches", ())]
    return made | ({"missing": missing} if missing else {})


if __name__ == "__main__":
    sys.exit(main())
