"""Table of faults and protocols, with the results of the last committed run of the campaign ``matrix``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from drivebus.values import Text
from generator import terms
from verification.fault_matrix.cell import COVERED, TABLE

REPORT = Path("docs") / "reports" / "campaign-matrix.json"
MODEL_NAMES = {
    "c320": "C320",
    "dzb100": "DZB100",
    "vc660": "VC660 RTU",
    "df800": "DF800 RTU / ASCII",
    "huanyang_hy": "Huanyang HY",
    "fr_e500": "Mitsubishi FR",
}
PASSED, PARTLY, FAILED, NOT_PRESENT = "✔", "◐", "✘", "?"
FAULT = Text("fault", "故障")
SUMMARY = Text(
    "Commit {commit}, seed {seed}: {cells} cells, {cases} cases, {failed} failed.",
    "提交 {commit}，种子 {seed}：{cells} 个单元格，{cases} 个用例，失败 {failed} 个。",
)
OF = Text("{held} of {cases} held", "{cases} 个中 {held} 个成立")
NOT_RUN = Text("not run", "未运行")
MISSING = Text("Missing, or otherwise than expected", "尚缺，或与预期不同")
RUN = Text("Cases", "用例")


def page_parts(root: Path, language: str) -> dict[str, str]:
    """Return the generated parts of the page."""
    report = json.loads((root / REPORT).read_text(encoding="utf-8"))
    found = report["figures"]["cells"]
    return {
        "run": _run_summary(report, found, language),
        "table": _table(found, language),
        "cases": _cases(found, language),
    }


def _run_summary(report: dict[str, Any], found: dict[str, Any], language: str) -> str:
    cases, held = (sum(cell[what] for cell in found.values()) for what in ("cases", "held"))
    text = terms.localized(SUMMARY, language)
    return text.format(commit=report["commit"], seed=report["seed"], cells=len(found), cases=cases, failed=cases - held)


def _table(found: dict[str, Any], language: str) -> str:
    heads = [terms.localized(FAULT, language), *MODEL_NAMES.values()]
    rows = (
        [
            entry["fault"][language],
            *(_cell(row, entry["cells"].get(model), model, found, language) for model in MODEL_NAMES),
        ]
        for row, entry in TABLE.items()
    )
    return terms.table(heads, rows)


def _cell(row: str, entry: dict[str, Any] | None, model: str, found: dict[str, Any], language: str) -> str:
    if entry is None:
        return "–"
    runs = [found.get(f"{row}/{kind.name}") for kind in COVERED if kind.model == model]
    return f"{_mark(runs, entry, language)} {entry[language]}"


def _mark(runs: list[dict[str, int] | None], entry: dict[str, Any], language: str) -> str:
    """Return the mark of a cell: passed only if every variant of the model ran and no case failed."""
    if None in runs or not all(run and run["cases"] for run in runs):
        return f"{NOT_PRESENT} ({terms.localized(NOT_RUN, language)})"
    cases, held = (sum(run[what] for run in runs if run) for what in ("cases", "held"))
    if held < cases:
        return f"{FAILED} ({terms.localized(OF, language).format(held=held, cases=cases)})"
    return PARTLY if entry.get("partly") else PASSED


def _cases(found: dict[str, Any], language: str) -> str:
    return "\n".join(_row(row, entry, found, language) for row, entry in TABLE.items())


def _row(row: str, entry: dict[str, Any], found: dict[str, Any], language: str) -> str:
    colon = terms.colon(language)
    lines = [f"### {entry['fault'][language]}", "", entry["shown"][language]]
    if "missing" in entry:
        lines += ["", f"**{terms.localized(MISSING, language)}**{colon}{entry['missing'][language]}"]
    names = (f"{row}/{kind.name}" for kind in COVERED)
    shown = (f"`{name}` {found[name]['held']}/{found[name]['cases']}" for name in names if name in found)
    return "\n".join([*lines, "", f"{terms.localized(RUN, language)}{colon}{' · '.join(shown)}", ""])
