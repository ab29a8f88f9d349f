"""The campaign ``fairness`` finds no violation, follows its seed, and finds planted errors."""

from __future__ import annotations

import pytest

from drivebus.bus import station
from verification.campaign import CampaignRun, load_campaign, run_campaign


def violations(budget: int = 1) -> list[str]:
    return run_campaign(load_campaign("fairness"), CampaignRun(campaign="fairness", seed=1, budget=budget)).violations


def test_another_seed_loses_other_replies() -> None:
    first, second = (
        run_campaign(load_campaign("fairness"), CampaignRun(campaign="fairness", seed=seed, budget=1))
        for seed in (1, 2)
    )
    assert first.violations == second.violations == [] and first.trials == second.trials == 1
    assert first.digest != second.digest


def test_probes_that_cost_more_than_a_tenth_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(station, "PROBE_BUS_SHARE", 0.3)
    monkeypatch.setattr(station, "MAX_PROBE_INTERVAL_S", 0.01)
    assert any("stretch" in violation for violation in violations())


def test_a_drive_that_is_probed_too_rarely_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(station, "MAX_PROBE_INTERVAL_S", 60.0)
    assert any("found after" in violation for violation in violations())


def test_a_user_read_that_waits_for_the_next_probe_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """A sync probe of a silent station is sent only when its probe is due, even for a user's read."""
    from drivebus.bus.scheduler import Scheduler

    first = Scheduler._next_sendable

    def patient(self: Scheduler, lane: object, now: float) -> object:
        head = lane[0]  # type: ignore[index]
        return None if head.station.state.is_unreachable else first(self, lane, now)  # type: ignore[arg-type]

    monkeypatch.setattr(Scheduler, "_next_sendable", patient)
    assert any("found on demand" in violation for violation in violations(2))
