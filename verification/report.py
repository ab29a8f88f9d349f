"""Report of a campaign: one JSON file under ``docs/reports/``."""

from __future__ import annotations

import json
import platform
import subprocess
from math import log
from pathlib import Path
from typing import Any

import drivebus
from verification.campaign import Campaign, CampaignRun

PACKAGE_FOLDER = Path(drivebus.__file__).parent


def report_document(campaign: Campaign, campaign_run: CampaignRun) -> dict[str, Any]:
    """Return the report. The same seed, budget and commit give the same report, except ``machine``."""
    return {
        "campaign": campaign.name,
        "evidence_for": list(campaign.evidence_for),
        "commit": campaign_run.commit or current_commit(),
        "seed": campaign_run.seed,
        "budget": campaign_run.budget,
        **({"only": sorted(campaign_run.only)} if campaign_run.only else {}),
        "unit": campaign.unit,
        "trials": campaign_run.trials,
        "violations": campaign_run.violation_count,
        "upper_bound_95": upper_bound_95(campaign_run.violation_count, campaign_run.trials),
        "counts": dict(sorted(campaign_run.counts.items())),
        "figures": campaign_run.figures,
        "machine": {
            "python": f"{platform.python_implementation()} {platform.python_version()}",
            **campaign_run.machine,
        },
        "trace_sha256": campaign_run.digest,
        "violated": campaign_run.violations,
    }


def upper_bound_95(violations: int, trials: int) -> float | None:
    """Return the rate below which violations lie with 95 % confidence when n trials had none: 1 - 0.05^(1/n), about
    3/n.

    None where a violation was found or nothing was tried.
    """
    if violations or not trials:
        return None
    return float(f"{-log(0.05) / trials:.2g}")


def write_report(folder: Path, campaign: Campaign, campaign_run: CampaignRun) -> Path:
    """Write ``campaign-<name>.json`` into ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / campaign.report_name
    text = json.dumps(report_document(campaign, campaign_run), indent=1, ensure_ascii=False, default=str)
    path.write_text(text + "\n", encoding="utf-8")
    return path


def current_commit(root: Path = PACKAGE_FOLDER, *paths: str) -> str:
    """Return the current commit, with "-dirty" where a file under ``paths`` (default: ``root``) differs from it.

    Return "" without a repository.
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
