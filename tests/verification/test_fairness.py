"""The campaign ``fairness`` finds no violation, is reproducible, and finds planted errors."""

from __future__ import annotations

import pytest

from drivebus.bus import station
from verification.campaign import CampaignRun, load_campaign, run_campaign


def violations(budget: int = 1) -> list[str]:
    return run_campaign(load_campaign("fairness"), CampaignRun(campaign="fairness", seed=1, budget=budget)).violations


def test_the_first_cases_have_no_violation_and_are_reproducible() -> None:
    first, second = (
        run_campaign(load_campaign("fairness"), CampaignRun(campaign="fairness", seed=1, budget=2)) for _ in range(2)
    )
    assert first.violations == [] and first.trials == 2
    assert first.digest == second.digest
    assert (
        run_campaign(load_campaign("fairness"), CampaignRun(campaign="fairness", seed=2, budget=1)).digest
        != first.digest
    )


def test_probes_that_cost_more_than_a_tenth_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(station, "PROBE_BUS_SHARE", 0.3)
    monkeypatch.setattr(station, "MAX_PROBE_INTERVAL_S", 0.01)
    assert any("stretch" in one for one in violations())


def test_a_drive_that_is_probed_too_rarely_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(station, "MAX_PROBE_INTERVAL_S", 60.0)
    assert any("found after" in one for one in violations())


def test_a_user_read_that_waits_for_the_next_probe_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """A sync probe of a silent station is sent only when its probe is due, even for a user's read."""
    from drivebus.bus.scheduler import Scheduler

    first = Scheduler._next_sendable

    def patient(self: Scheduler, lane: object, now: float) -> object:
        head = lane[0]  # type: ignore[index]
        return None if head.station.state.is_unreachable else first(self, lane, now)  # type: ignore[arg-type]

    monkeypatch.setattr(Scheduler, "_next_sendable", patient)
    assert any("found on demand" in one for one in violations(2))
