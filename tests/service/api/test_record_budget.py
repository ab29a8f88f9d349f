"""Record budget: the commands of one user take 4 MB of audit trail at once, then 5,000 octets a second."""

from __future__ import annotations

import pytest

from drivebus.errors import TooManyCommands
from drivebus.service.api.record_budget import MAX_BURST_OCTETS, RECORD_OCTETS_PER_S, RecordBudget
from drivebus.service.auth.actor import Actor, local_actor

EVE, ANN = (Actor(name, frozenset(), f"s-{name}") for name in ("eve", "ann"))


def test_the_size_of_a_budget_is_the_documented_one() -> None:
    assert (MAX_BURST_OCTETS, RECORD_OCTETS_PER_S) == (4_000_000, 5_000)


def test_an_unused_budget_has_no_wait() -> None:
    assert RecordBudget().wait_s(EVE, 7.0) == 0.0


def test_a_budget_that_is_used_up_has_to_be_regained_with_its_excess() -> None:
    budget = RecordBudget()
    budget.spend(EVE, MAX_BURST_OCTETS, 7.0)
    assert budget.wait_s(EVE, 7.0) == 0.0
    budget.spend(EVE, 10_000, 7.0)
    assert budget.wait_s(EVE, 7.0) == pytest.approx(2.0)
    assert budget.wait_s(EVE, 8.5) == pytest.approx(0.5)
    assert budget.wait_s(EVE, 9.1) == 0.0
    assert budget.wait_s(ANN, 7.0) == 0.0, "each user has an own one"


@pytest.mark.parametrize("record_octets", [500, 60_000])
def test_a_day_of_commands_takes_at_most_the_burst_and_five_thousand_octets_a_second(record_octets: int) -> None:
    budget, written, day_s = RecordBudget(), 0, 86_400
    for second in range(day_s):
        for tenth in range(10):
            now = second + tenth / 10
            if budget.wait_s(EVE, now) == 0:
                budget.spend(EVE, record_octets, now)
                written += record_octets
    bound = min(MAX_BURST_OCTETS + day_s * RECORD_OCTETS_PER_S + record_octets, day_s * 10 * record_octets)
    assert 0.99 * bound < written <= bound


def test_a_budget_that_is_whole_again_is_forgotten() -> None:
    budget = RecordBudget()
    for number in range(100):
        budget.spend(Actor(f"user-{number}", frozenset(), "s"), 5_000, 10.0 * number)
    assert len(budget._full_at) == 1


@pytest.mark.parametrize("by_token", [True, False], ids=["tokens", "sessions"])
def test_the_tokens_of_a_user_share_a_budget_and_so_do_the_sessions_and_local_actors_have_no_limit(
    by_token: bool,
) -> None:
    """With a budget of each token, a user who makes tokens again and again would have no limit.

    With one budget of both, a faulty program kept its user from using the page.
    """
    budget = RecordBudget()
    tokens = [Actor(f"eve/{name}", frozenset(), f"token-{name}") for name in ("report", "other")]
    sessions = [Actor("eve", frozenset(), session) for session in ("s-1", "s-2")]
    limited, free = (tokens, sessions) if by_token else (sessions, tokens)
    budget.spend(limited[0], MAX_BURST_OCTETS + 5_001, 7.0)
    for actor in free:
        budget.check(actor, 7.0)
    for actor in limited:
        with pytest.raises(TooManyCommands) as raised:
            budget.check(actor, 7.0)
        assert raised.value.params == {"name": "eve", "retry_s": 1.1}
    budget.check(ANN, 7.0)
    local = local_actor("eve", "local-1")
    budget.check(local, 7.0)
    budget.spend(local, 1_000, 7.0)
    assert budget.wait_s(limited[0], 7.0) == pytest.approx(1.0002)
