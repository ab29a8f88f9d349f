"""Record budget: the commands of one actor take 4 MB of audit trail at once, then 5,000 octets a second."""

from __future__ import annotations

import pytest

from drivebus.service.api.record_budget import MAX_BURST_OCTETS, RECORD_OCTETS_PER_S, RecordBudget


def test_the_size_of_a_budget_is_the_documented_one() -> None:
    assert (MAX_BURST_OCTETS, RECORD_OCTETS_PER_S) == (4_000_000, 5_000)


def test_an_unused_budget_has_no_wait() -> None:
    assert RecordBudget().wait_s("eve", 7.0) == 0.0


def test_a_budget_that_is_used_up_has_to_be_regained_with_its_excess() -> None:
    budget = RecordBudget()
    budget.spend("eve", MAX_BURST_OCTETS, 7.0)
    assert budget.wait_s("eve", 7.0) == 0.0
    budget.spend("eve", 10_000, 7.0)
    assert budget.wait_s("eve", 7.0) == pytest.approx(2.0)
    assert budget.wait_s("eve", 8.5) == pytest.approx(0.5)
    assert budget.wait_s("eve", 9.1) == 0.0
    assert budget.wait_s("ann", 7.0) == 0.0, "each key has its own"


@pytest.mark.parametrize("record_octets", [500, 60_000])
def test_a_day_of_commands_takes_at_most_the_burst_and_five_thousand_octets_a_second(record_octets: int) -> None:
    budget, written, day_s = RecordBudget(), 0, 86_400
    for second in range(day_s):
        for tenth in range(10):
            now = second + tenth / 10
            if budget.wait_s("eve", now) == 0:
                budget.spend("eve", record_octets, now)
                written += record_octets
    bound = min(MAX_BURST_OCTETS + day_s * RECORD_OCTETS_PER_S + record_octets, day_s * 10 * record_octets)
    assert 0.99 * bound < written <= bound


def test_a_budget_that_is_whole_again_is_forgotten() -> None:
    budget = RecordBudget()
    for number in range(100):
        budget.spend(f"user-{number}", 5_000, 10.0 * number)
    assert len(budget._full_at) == 1
