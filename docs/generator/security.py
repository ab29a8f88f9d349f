"""Tables of the security page, from ``docs/security/*.tsv``: requirements of two standards, and attacks."""

from __future__ import annotations

import csv
from collections import Counter
from pathlib import Path

from generator.terms import table

FOLDER = Path(__file__).resolve().parents[1] / "security"
STATES = {
    "en": {"met": "met", "na": "not applicable", "missing": "**missing**"},
    "zh": {"met": "满足", "na": "不适用", "missing": "**缺少**"},
}
VERDICTS = {
    "en": {"held": "held", "mended": "mended", "open": "**open**"},
    "zh": {"held": "经受住", "mended": "已修复", "open": "**未解决**"},
}
HEADS = {
    "asvs": {
        "en": ("no.", "level", "subject", "state", "why, how", "test"),
        "zh": ("编号", "级别", "内容", "状态", "原因、方式", "测试"),
    },
    "iec62443": {
        "en": ("no.", "SL", "subject", "state", "why, how", "test"),
        "zh": ("编号", "SL", "内容", "状态", "原因、方式", "测试"),
    },
    "attacks": {
        "en": ("attack", "expected", "observed", "verdict", "test"),
        "zh": ("攻击", "预期", "观察", "结论", "测试"),
    },
}
SUMMARY = {
    "en": "{total} requirements: {met} met, {na} not applicable, {missing} missing.",
    "zh": "共 {total} 项要求：满足 {met}，不适用 {na}，缺少 {missing}。",
}


def rows(name: str) -> list[dict[str, str]]:
    """Return the rows of a data file: ``asvs``, ``iec62443`` or ``attacks``."""
    with (FOLDER / f"{name}.tsv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file, delimiter="\t", quoting=csv.QUOTE_NONE))


def requirements(name: str, language: str) -> str:
    """Return the counts and the table of a standard's requirements."""
    found = rows(name)
    states = Counter(row["state"] for row in found)
    counts = {state: states[state] for state in STATES[language]}
    lines = [
        (
            row["number"],
            row["level"],
            row[f"subject_{language}"],
            STATES[language][row["state"]],
            row[f"reason_{language}"],
            _link(row["evidence"]),
        )
        for row in found
    ]
    return SUMMARY[language].format(total=len(found), **counts) + "\n\n" + table(HEADS[name][language], lines)


def attacks(language: str) -> str:
    """Return the table of attacks."""
    columns = ("attack", "expected", "observed")
    lines = [
        (
            *(row[f"{column}_{language}"] for column in columns),
            VERDICTS[language][row["verdict"]],
            _link(row["evidence"]),
        )
        for row in rows("attacks")
    ]
    return table(HEADS["attacks"][language], lines)


def _link(evidence: str) -> str:
    """Return a link to a test, or to the file that shows how a requirement is met."""
    path, _, name = evidence.partition("::")
    return (
        f"[{(name or path.rpartition('/')[2]).removeprefix('test_').replace('_', ' ')}](../../{path})" if path else ""
    )
