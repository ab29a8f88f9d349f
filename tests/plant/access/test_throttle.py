"""S05: guessing is slow, whoever guesses and from wherever; nobody is locked out for ever."""

from __future__ import annotations

import random

import pytest

from drivebus.plant.access.throttle import FREE, KEYS, LONGEST_S, SHORTEST_S, WINDOW_S, Throttle

HOUR_S = 3600.0


def guesses(throttle: Throttle, keys: list[tuple[str, ...]], hours: float, step_s: float) -> int:
    """How many passwords are looked at when somebody tries again as soon as possible."""
    now, done, at = 0.0, 0, 0
    while now < hours * HOUR_S:
        at += 1
        if throttle.wait_s(keys[at % len(keys)], now) == 0.0:
            throttle.tried(keys[at % len(keys)], now)
            done += 1
        now += step_s
    return done


def test_s05_ten_failures_cost_nothing_and_the_next_waits() -> None:
    throttle = Throttle()
    for n in range(FREE):
        assert throttle.wait_s(("user:li",), float(n)) == 0.0
        throttle.tried(("user:li",), float(n))
    assert throttle.wait_s(("user:li",), FREE - 1.0) == SHORTEST_S
    assert throttle.wait_s(("user:wang",), FREE - 1.0) == 0.0


def test_s05_each_further_failure_doubles_the_wait_up_to_two_minutes() -> None:
    throttle, now, waits = Throttle(), 0.0, []
    for _ in range(FREE + 8):
        wait = throttle.wait_s(("a",), now)
        waits.append(wait)
        now += wait
        throttle.tried(("a",), now)
    assert waits[FREE:] == [2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 120.0, 120.0]
    assert max(waits) == LONGEST_S


@pytest.mark.parametrize("step_s", [0.36, 1.0, 7.0])
def test_s05_ten_thousand_tries_at_one_user_are_under_a_hundred_guesses_an_hour(step_s: float) -> None:
    """From ten thousand addresses: only the user's own count holds them."""
    throttle = Throttle()
    keys = [("user:li", f"address:{n}") for n in range(10_000)]
    assert FREE < guesses(throttle, keys, 1, step_s) <= 100
    assert guesses(Throttle(), keys, 6, 3.0) <= 600


def test_s05_ten_thousand_users_from_one_address_are_under_a_hundred_guesses_an_hour() -> None:
    keys = [(f"user:{n}", "address:10.0.0.9") for n in range(10_000)]
    assert FREE < guesses(Throttle(), keys, 1, 0.36) <= 100


def test_s05_nobody_is_locked_out_for_ever() -> None:
    """After a whole night of guesses the right user waits two minutes at most."""
    throttle = Throttle()
    guesses(throttle, [("user:li",)], 8, 1.0)
    assert throttle.wait_s(("user:li",), 8 * HOUR_S) <= LONGEST_S
    assert throttle.wait_s(("user:li",), 8 * HOUR_S + WINDOW_S) == 0.0


def test_s05_a_failure_counts_for_a_quarter_of_an_hour() -> None:
    throttle = Throttle()
    for _ in range(FREE):
        throttle.tried(("a",), 100.0)
    throttle.tried(("a",), 999.0)
    assert throttle.wait_s(("a",), 999.5) > 0.0
    assert throttle.wait_s(("a",), 100.0 + WINDOW_S) == 0.0


def test_s05_a_right_password_does_not_wipe_the_guesses_of_others() -> None:
    throttle = Throttle()
    for n in range(FREE):
        throttle.tried(("a",), float(n))
    throttle.tried(("a",), 20.0)
    throttle.succeeded(("a", "never heard of"), 20.0)
    assert throttle.wait_s(("a",), 20.0 - 11.0) == SHORTEST_S


def test_s14_what_is_remembered_has_an_end() -> None:
    throttle, chance = Throttle(), random.Random(1)
    for _ in range(FREE):
        throttle.tried(("user:li",), 0.0)
    for n in range(KEYS - 1):
        throttle.tried((f"address:{chance.random()}",), float(n) / KEYS)
    assert throttle.wait_s(("user:li",), 1.0) > 0.0
    throttle.tried(("one more",), 1.0)
    assert throttle.wait_s(("user:li",), 1.0) == 0.0, "the one that was heard of longest ago"
