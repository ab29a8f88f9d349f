"""Campaigns whose runs iterate over sets: the hash seed of the interpreter changes nothing."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest


@pytest.mark.parametrize(("campaign", "budget"), [("failures", 1), ("late", 100)])
def test_a_run_does_not_depend_on_the_hash_seed(campaign: str, budget: int) -> None:
    code = (
        "from verification.campaign import CampaignRun, run_campaign\n"
        f"from verification.campaigns.{campaign} import CAMPAIGN\n"
        f"print(run_campaign(CAMPAIGN, CampaignRun(campaign={campaign!r}, seed=5, budget={budget})).digest)"
    )
    digests = {
        subprocess.run(
            [sys.executable, "-c", code], env={**os.environ, "PYTHONHASHSEED": seed}, capture_output=True, check=True
        ).stdout
        for seed in ("1", "2")
    }
    assert len(digests) == 1
