"""What a campaign leaves behind: one JSON file a campaign under ``docs/reports/``, and its summary as a line."""

from __future__ import annotations

import json
import subprocess
from math import log
from pathlib import Path
from typing import Any

import drivebus
from verification.campaign import Campaign, CampaignRun

PACKAGE_FOLDER = Path(drivebus.__file__).parent


def report_document(campaign: Campaign, session: CampaignRun) -> dict[str, Any]:
    """All that the run found. The same seed, budget and commit give the same, but for ``machine``."""
    return {
        "campaign": campaign.name,
        "evidence_for": list(campaign.evidence_for),
        "commit": session.commit or current_commit(),
        "seed": session.seed,
        "budget": session.budget,
        "unit": campaign.unit,
        "trials": session.trials,
        "violations": session.violation_count,
        "upper_bound_95": upper_bound_95(session.violation_count, session.trials),
        "counts": dict(sorted(session.counts.items())),
        "figures": session.figures,
        "machine": session.machine,
        "trace_sha256": session.digest,
        "violated": session.violations,
    }


def upper_bound_95(violations: int, trials: int) -> float | None:
    """With no violation in n trials its rate is below this with 95 % confidence: 1 - 0.05^(1/n), about 3/n.

    None where there was one (then the count itself is the finding), or nothing was tried.
    """
    if violations or not trials:
        return None
    return float(f"{-log(0.05) / trials:.2g}")


def write_report(folder: Path, campaign: Campaign, session: CampaignRun) -> Path:
    """``lab-<campaign>.json`` in ``folder``, or what the campaign calls it."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{campaign.stem}.json"
    text = json.dumps(report_document(campaign, session), indent=1, ensure_ascii=False, default=str)
    path.write_text(text + "\n", encoding="utf-8")
    return path


def current_commit(root: Path = PACKAGE_FOLDER, *paths: str) -> str:
    """The commit that was tried, "-dirty" where a file under ``paths`` (all of ``root``) was changed since.

    "" without a repository.
    """
    try:
        found = _git(root, "rev-parse", "--short=12", "HEAD")
        changed = _git(root, "status", "--porcelain", "--untracked-files=no", "--", *(paths or (".",)))
    except (OSError, subprocess.CalledProcessError):
        return ""
    return found + ("-dirty" if changed else "")


def _git(root: Path, *arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=root, capture_output=True, text=True, check=True)
    return done.stdout.strip()
