"""Committed reports of the campaigns as a table."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from drivebus import i18n
from generator.terms import phrase, table
from verification.campaign import CAMPAIGN_NAMES, load_campaign

TABLE_HEADS = {
    "en": ("campaign", "what it tries", "evidence for", "trials", "violations", "rate below (95 %)", "seed, commit"),
    "zh": ("试验", "试什么", "证据", "次数", "违反", "比率上限（95 %）", "种子、提交"),
}
MISSING = {"en": "no report yet", "zh": "尚无报告"}


def campaign_table(reports: Path, language: str) -> str:
    """Return one row per campaign, in the order of ``python -m verification all``."""
    rows = (_row(name, reports / load_campaign(name).report_name, language) for name in CAMPAIGN_NAMES)
    return table(TABLE_HEADS[language], rows)


def _row(name: str, path: Path, language: str) -> tuple[str, ...]:
    summary = load_campaign(name).summary[language]
    if not path.exists():
        return (f"`{name}`", summary, "", MISSING[language], "", "", "")
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    bound = "–" if found["upper_bound_95"] is None else f"{found['upper_bound_95']:g}"
    return (
        f"[`{name}`](../reports/{path.name})",
        summary,
        i18n.join(found["evidence_for"], "items", language),
        f"{found['trials']:,} {phrase(found['unit'], language)}",
        str(found["violations"]),
        bound,
        i18n.join((str(found["seed"]), f"`{found['commit']}`"), "items", language),
    )
