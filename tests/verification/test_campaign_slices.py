"""Every campaign's slice finds no violation, and the same seed gives the same trace."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys

import pytest

from verification.campaign import CAMPAIGN_NAMES, CampaignRun, load_campaign, run_campaign
from verification.campaigns import soak

DONE = [name for name in CAMPAIGN_NAMES if importlib.util.find_spec(f"verification.campaigns.{name}")]
SHORT = {
    "fuzz": 4_000,
    "flips": 2_000,
    "late": 400,
    "commands": 60,
    "stop": 60,
    "fairness": 1,
    "replug": 8,
    "clock": 20,
    "audit": 60,
    "statements": 60,
    "failures": 1,
    "matrix": 24,
}
"""Budgets that show whether unseeded randomness, hashes or addresses influence a run."""


def test_every_campaign_has_a_module() -> None:
    assert [*CAMPAIGN_NAMES] == DONE


@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", DONE)
def test_a_slice_finds_no_violation(name: str) -> None:
    campaign = load_campaign(name)
    campaign_run = run_campaign(campaign, CampaignRun(campaign=name, seed=1, budget=campaign.ci_budget))
    assert campaign_run.violations == []
    assert campaign_run.trials > 0


@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", sorted(SHORT))
def test_the_same_seed_gives_the_same_trace_in_another_process(name: str) -> None:
    """Another process with another hash seed gives the same SHA-256."""
    here = run_campaign(load_campaign(name), CampaignRun(campaign=name, seed=7, budget=SHORT[name])).digest
    message = (
        "from verification.campaign import *; "
        f"run = CampaignRun(campaign={name!r}, seed=7, budget={SHORT[name]}); "
        f"print(run_campaign(load_campaign({name!r}), run).digest)"
    )
    environment = {**os.environ, "PYTHONHASHSEED": "4711"}
    done = subprocess.run([sys.executable, "-c", message], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.split() == [here]


@pytest.mark.parametrize(
    ("pages", "since_first", "since_noon"), [((100, 120, 125, 126), 26.0, 5.0), ((100,), 0.0, 0.0)]
)
def test_memory_growth_is_reported_since_the_first_hour_and_since_noon(
    pages: tuple[int, ...], since_first: float, since_noon: float
) -> None:
    found = soak._memory_growth([*pages])
    assert found == {"rss_growth_percent": since_first, "rss_growth_since_noon_percent": since_noon}
