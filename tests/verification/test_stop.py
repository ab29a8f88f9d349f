"""The campaign ``stop`` finds no violation, follows its seed, and finds planted errors (I3)."""

from __future__ import annotations

from typing import Any

import pytest

from drivebus.bus import load
from drivebus.bus.core import BusCore
from drivebus.bus.messages import RequestPriority
from drivebus.bus.scheduler import Scheduler
from drivebus.bus.transaction import Transaction
from drivebus.drives import outcome as outcome_module
from drivebus.drives.operations import stop as stopping
from drivebus.drives.outcome import raise_for_status
from drivebus.drives.stop_supervisor import StopSupervisor
from fixtures.campaigns import finds
from verification.campaign import CampaignRun, load_campaign, run_campaign


def test_another_seed_stops_at_other_instants() -> None:
    first, second = (
        run_campaign(load_campaign("stop"), CampaignRun(campaign="stop", seed=seed, budget=50)) for seed in (1, 2)
    )
    assert first.violations == second.violations == [] and first.trials == second.trials == 50
    assert first.digest != second.digest


def test_a_stop_queued_like_other_requests_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    put = Scheduler.enqueue

    def politely(self: Scheduler, job: Any) -> None:
        job.priority = RequestPriority.PARAMETER if job.priority is RequestPriority.STOP else job.priority
        put(self, job)

    monkeypatch.setattr(Scheduler, "enqueue", politely)
    assert finds("stop", "was sent before it", 300)


def test_repeated_stops_of_others_before_a_stop_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Scheduler, "_stop_order", lambda self, job: 0)
    assert finds("stop", "before it repeatedly", 600)


def test_a_frame_with_a_longer_timeout_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """A longer reply timeout delays the stop."""
    begin = Transaction.__init__

    def patient(self: Transaction, *arguments: Any, **named: Any) -> None:
        begin(self, *arguments, **named)
        self.deadline = self.ends_at = self.deadline + 0.005

    monkeypatch.setattr(Transaction, "__init__", patient)
    assert finds("stop", "later than a stop may be", 300)


def test_an_incomplete_stop_bound_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(load, "_stop_frame_bytes", lambda link: 8)
    assert finds("stop", "the bus reports a bound", 1)


def test_an_alarm_that_comes_late_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stopping, "STOP_PROGRESS_TIMEOUT_S", 6.0)
    assert finds("stop", "was unknown after", 300)


def test_a_stop_that_is_not_repeated_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(StopSupervisor, "start_repetition", lambda self, how: None)
    assert finds("stop", "it is not repeated", 300)


def test_an_unconfirmed_stop_without_an_alarm_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "drivebus.drives.stop_supervisor.raise_for_status",
        lambda outcome, stop=False: outcome if stop else raise_for_status(outcome),
    )
    assert outcome_module.raise_for_status is raise_for_status
    assert finds("stop", "without an alarm", 300)


def test_a_withdrawn_stop_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """The stop is removed from the queue with its cancelled caller."""

    def drop(self: BusCore, token: Any) -> None:
        self.scheduler.remove_if(lambda job: job.token is token)

    monkeypatch.setattr(BusCore, "_withdraw", drop)
    monkeypatch.setattr(StopSupervisor, "start_repetition", lambda self, how: None)
    assert finds("stop", "", 300)
