"""The campaign of stops: clean on the product, the same twice, and it finds what it is there to find (I3)."""

from __future__ import annotations

from typing import Any

import pytest

from drivebus.bus import load
from drivebus.bus.core import BusCore
from drivebus.bus.messages import RequestPriority
from drivebus.bus.scheduler import Scheduler
from drivebus.bus.transaction import Transaction
from drivebus.drives import outcome as settle
from drivebus.drives.operations import stop as stopping
from drivebus.drives.outcome import raise_for_status
from drivebus.drives.stop_supervisor import StopSupervisor
from verification.campaign import CampaignRun, load_campaign, run_campaign


def violations(budget: int = 100) -> list[str]:
    return run_campaign(load_campaign("stop"), CampaignRun("stop", 1, budget)).violations


def test_the_first_lines_are_clean_and_the_same_twice() -> None:
    first, second = (run_campaign(load_campaign("stop"), CampaignRun("stop", 1, 300)) for _ in range(2))
    assert first.violations == [] and first.trials == 300
    assert first.digest == second.digest
    assert run_campaign(load_campaign("stop"), CampaignRun("stop", 2, 50)).digest != first.digest


def test_a_stop_that_queues_like_everything_else_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    put = Scheduler.enqueue

    def politely(self: Scheduler, job: Any) -> None:
        job.priority = RequestPriority.PARAMETER if job.priority is RequestPriority.STOP else job.priority
        put(self, job)

    monkeypatch.setattr(Scheduler, "enqueue", politely)
    assert any("I3" in one and "went before it" in one for one in violations(300))


def test_stops_of_others_that_go_first_again_and_again_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Scheduler, "_stop_order", lambda self, job: 0)
    assert any("again and again" in one for one in violations(600))


def test_a_frame_that_waits_longer_than_it_may_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """The timeout is the stop's latency."""
    begin = Transaction.__init__

    def patient(self: Transaction, *given: Any, **named: Any) -> None:
        begin(self, *given, **named)
        self.deadline = self.ends_at = self.deadline + 0.005

    monkeypatch.setattr(Transaction, "__init__", patient)
    assert any("later than a stop may" in one for one in violations(300))


def test_a_bound_that_leaves_something_out_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(load, "_stop_frame_bytes", lambda link: 8)
    assert any("G06 the bus tells a bound" in one for one in violations(1))


def test_an_alarm_that_comes_late_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stopping, "STOP_PROGRESS_TIMEOUT_S", 6.0)
    assert any("G07" in one and "unknown after" in one for one in violations(300))


def test_a_stop_that_is_not_repeated_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(StopSupervisor, "start_retry", lambda self, how: None)
    assert any("it is not repeated" in one for one in violations(300))


def test_an_unconfirmed_stop_of_which_nobody_is_told_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "drivebus.drives.stop_supervisor.raise_for_status",
        lambda outcome, stop=False: outcome if stop else raise_for_status(outcome),
    )
    assert settle.raise_for_status is raise_for_status
    assert any("nobody was alarmed" in one for one in violations(300))


def test_a_stop_that_is_taken_back_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Dropped from the queue with whoever asked for it."""

    def drop(self: BusCore, token: Any) -> None:
        self.scheduler.remove_if(lambda job: job.token is token)

    monkeypatch.setattr(BusCore, "_withdraw", drop)
    monkeypatch.setattr(StopSupervisor, "start_retry", lambda self, how: None)
    assert violations(300)
