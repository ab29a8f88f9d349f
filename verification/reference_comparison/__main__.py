"""The whole comparison: ``python -m verification.reference_comparison --seed 1 --messages 1000000 --write``.

Writes docs/reports/reference-codec-comparison.json; the pages beside it quote ``rows``.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter
from pathlib import Path
from random import Random
from typing import Any

from verification.reference_comparison.compare import ComparisonTally, compare, sides
from verification.report import current_commit

ROOT = Path(__file__).resolve().parents[2]
REPORT = ROOT / "docs" / "reports" / "reference-codec-comparison.json"
COMPARED_SOURCES = ("src/drivebus/protocols", "verification/reference", "verification/reference_comparison")


def main() -> int:
    options = argparse.ArgumentParser(prog="python -m verification.reference_comparison", description=__doc__)
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--messages", type=int, default=1_000_000, help="replies judged for each codec")
    options.add_argument("--write", action="store_true", help=f"write {REPORT.relative_to(ROOT)}")
    chosen = options.parse_args()
    found = document(chosen.seed, chosen.messages)
    text = json.dumps(found, indent=1) + "\n"
    print(text)
    if chosen.write:
        REPORT.write_text(text, encoding="utf-8")
    return int(any(codec["disagreements"] for codec in found["codecs"].values()))


def document(seed: int, messages: int) -> dict[str, Any]:
    """Return the report. The same seed, messages and commit give the same report, except the seconds."""
    found: dict[str, Any] = {
        "commit": current_commit(ROOT, *COMPARED_SOURCES),
        "seed": seed,
        "messages": messages,
        "codecs": {},
    }
    for side in sides():
        began = time.perf_counter()
        tally = compare(side, Random(f"{seed}/{side.name}"), messages)
        found["codecs"][side.name] = tally_document(tally, messages) | {
            "seconds": round(time.perf_counter() - began, 1)
        }
        print(side.name, tally.disagreed, "disagreements", file=sys.stderr, flush=True)
    return found


def tally_document(tally: ComparisonTally, judged: int) -> dict[str, Any]:
    """Return one codec's figures; without a disagreement in n replies their rate is below 3/n with 95 % confidence."""
    return {
        "replies_judged": judged,
        "totals": dict(sorted(totals(tally).items())),
        "upper_bound_95": None if tally.disagreed else 3 / judged,
        "disagreements": tally.disagreed,
        "choices": dict(sorted(tally.choices.items())),
        "kinds": nested(tally.kinds),
        "replies": nested(tally.mutations),
        "disagreed": tally.disagreements,
    }


def totals(tally: ComparisonTally) -> Counter[str]:
    found: Counter[str] = Counter()
    for (_, what), count in tally.kinds.items():
        found[what] += count
    return found


def nested(counts: Counter[tuple[str, str]]) -> dict[str, dict[str, int]]:
    found: dict[str, dict[str, int]] = {}
    for (name, what), count in sorted(counts.items()):
        found.setdefault(name, {})[what] = count
    return found


def rows(found: dict[str, Any]) -> list[str]:
    """Return the rows of the pages' table: codec, requests, replies, accepted, rejected, choices, disagreements."""
    return [
        f"| {name} | {figures['totals']['built']:,} | {figures['replies_judged']:,} "
        f"| {figures['totals']['accepted']:,} | {figures['totals']['refused']:,} "
        f"| {figures['totals'].get('chosen', 0):,} | {figures['disagreements']} | {figures['upper_bound_95']} |"
        for name, figures in found["codecs"].items()
    ]


if __name__ == "__main__":
    sys.exit(main())
