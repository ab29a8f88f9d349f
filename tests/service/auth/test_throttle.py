"""Throttle of logins: guessing is slow from any address, and no user is locked out."""

from __future__ import annotations

import asyncio
import random
from pathlib import Path

import pytest

from drivebus.service.auth import throttle as throttle_module
from drivebus.service.auth.errors import NotAuthenticated, TooManyAttempts
from drivebus.service.auth.throttle import (
    FREE_ATTEMPTS,
    MAX_LOGIN_DELAY_S,
    MIN_LOGIN_DELAY_S,
    THROTTLE_WINDOW_S,
    AttemptKeys,
    LoginThrottle,
    unknown_browser_keys,
)
from drivebus.testing.virtual_time import run
from fixtures.auth import auth_service, login

HOUR_S = 3600.0


def keys(*own: str) -> AttemptKeys:
    return AttemptKeys(own)


def guesses(throttle: LoginThrottle, tried: list[AttemptKeys], hours: float, step_s: float) -> int:
    """Return how many passwords are checked when each attempt follows as soon as permitted."""
    now, done, at = 0.0, 0, 0
    while now < hours * HOUR_S:
        at += 1
        if throttle.wait_s(tried[at % len(tried)], now) == 0.0:
            throttle.record_attempt(tried[at % len(tried)], now)
            done += 1
        now += step_s
    return done


def test_throttle_numbers_are_the_documented_ones() -> None:
    assert (FREE_ATTEMPTS, THROTTLE_WINDOW_S) == (10, 15 * 60)


def test_ten_failures_cost_nothing_and_the_next_waits() -> None:
    throttle = LoginThrottle()
    for n in range(FREE_ATTEMPTS):
        assert throttle.wait_s(keys("user:li"), float(n)) == 0.0
        throttle.record_attempt(keys("user:li"), float(n))
    assert throttle.wait_s(keys("user:li"), FREE_ATTEMPTS - 1.0) == MIN_LOGIN_DELAY_S
    assert throttle.wait_s(keys("user:wang"), FREE_ATTEMPTS - 1.0) == 0.0


def test_a_login_waits_for_the_slowest_of_its_keys() -> None:
    """A user tried from many addresses, and an address that tries many users."""
    throttle = LoginThrottle()
    for n in range(FREE_ATTEMPTS):
        throttle.record_attempt(keys("user:li", f"address:{n}"), 0.0)
        throttle.record_attempt(keys(f"user:{n}", "address:9"), 0.0)
    throttle.record_attempt(keys("user:li", "address:new"), 0.0)
    for names in (("user:li", "address:new"), ("address:new", "user:li"), ("user:new", "address:9")):
        assert throttle.wait_s(keys(*names), 0.0) >= MIN_LOGIN_DELAY_S
        assert throttle.wait_s(keys(*names), 2 * MIN_LOGIN_DELAY_S) == 0.0


def test_each_further_failure_doubles_the_wait_up_to_two_minutes() -> None:
    throttle, now, waits = LoginThrottle(), 0.0, []
    for _ in range(FREE_ATTEMPTS + 8):
        wait = throttle.wait_s(keys("a"), now)
        waits.append(wait)
        now += wait
        throttle.record_attempt(keys("a"), now)
    assert waits[FREE_ATTEMPTS:] == [2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 120.0, 120.0]
    assert max(waits) == MAX_LOGIN_DELAY_S


@pytest.mark.parametrize("step_s", [0.36, 1.0, 7.0])
def test_one_user_is_guessed_at_most_a_hundred_times_an_hour(step_s: float) -> None:
    """From ten thousand addresses: only the count of the user limits them."""
    throttle = LoginThrottle()
    tried = [unknown_browser_keys("li", f"10.0.{n // 100}.{n % 100}") for n in range(10_000)]
    assert FREE_ATTEMPTS < guesses(throttle, tried, 1, step_s) <= 100
    assert guesses(LoginThrottle(), tried, 6, 3.0) <= 600


def test_one_address_guesses_at_most_a_hundred_times_an_hour() -> None:
    tried = [unknown_browser_keys(f"user{n}", "10.0.0.9") for n in range(10_000)]
    assert FREE_ATTEMPTS < guesses(LoginThrottle(), tried, 1, 0.36) <= 100


def test_a_user_waits_at_most_two_minutes() -> None:
    """A whole night of guesses makes the wait no longer."""
    throttle = LoginThrottle()
    guesses(throttle, [keys("user:li")], 8, 1.0)
    assert throttle.wait_s(keys("user:li"), 8 * HOUR_S) <= MAX_LOGIN_DELAY_S
    assert throttle.wait_s(keys("user:li"), 8 * HOUR_S + THROTTLE_WINDOW_S) == 0.0


def test_a_failure_counts_for_a_quarter_of_an_hour() -> None:
    throttle = LoginThrottle()
    for _ in range(FREE_ATTEMPTS):
        throttle.record_attempt(keys("a"), 100.0)
    throttle.record_attempt(keys("a"), 999.0)
    assert throttle.wait_s(keys("a"), 999.5) > 0.0
    assert throttle.wait_s(keys("a"), 100.0 + THROTTLE_WINDOW_S) == 0.0


def test_a_right_password_does_not_reset_other_failures() -> None:
    throttle = LoginThrottle()
    for n in range(FREE_ATTEMPTS):
        throttle.record_attempt(keys("a"), float(n))
    throttle.record_attempt(keys("a"), 20.0)
    for _ in range(2):
        throttle.record_success(keys("a", "unknown"), 20.0)
    assert throttle.wait_s(keys("a"), 20.0 - 11.0) == MIN_LOGIN_DELAY_S


@pytest.fixture
def max_keys(monkeypatch: pytest.MonkeyPatch) -> int:
    """Let a throttle keep few keys: filling the 30,000 of a service takes seconds."""
    monkeypatch.setattr(throttle_module, "MAX_THROTTLED_KEYS", 300)
    monkeypatch.setattr(throttle_module, "_EVICTED_AT_ONCE", 15)
    return 300


def test_names_that_were_tried_once_never_push_out_a_name_that_is_guessed(max_keys: int) -> None:
    throttle, chance = LoginThrottle(), random.Random(1)
    for _ in range(FREE_ATTEMPTS):
        throttle.record_attempt(keys("user:li"), 0.0)
    for n in range(3 * max_keys):
        throttle.record_attempt(keys(f"user:{chance.random()}"), n / max_keys)
    assert throttle.wait_s(keys("user:li"), 0.0) > 0.0 and len(throttle._attempts) <= max_keys


def test_keys_whose_attempts_have_expired_are_dropped_before_any_other(max_keys: int) -> None:
    throttle = LoginThrottle()
    for n in range(max_keys):
        throttle.record_attempt(keys(f"user:{n}"), 0.0)
        throttle.record_attempt(keys(f"user:{n}"), 0.0)
    throttle.record_attempt(keys("user:li"), THROTTLE_WINDOW_S)
    assert list(throttle._attempts) == ["user:li"]


def test_of_two_addresses_the_one_that_asks_less_often_gets_the_next_turn() -> None:
    """Otherwise an endless series of attempts at one name would keep its user out for good."""
    throttle = LoginThrottle()
    intruder, person = unknown_browser_keys("li", "10.0.0.9"), unknown_browser_keys("li", "10.0.0.7")
    now, turns = 0.0, 0
    while turns < FREE_ATTEMPTS + 7:
        now += 0.05
        if throttle.wait_s(intruder, now) == 0.0:
            throttle.record_attempt(intruder, now)
            turns += 1
    assert throttle.wait_s(person, now) <= MAX_LOGIN_DELAY_S < throttle.wait_s(intruder, now)
    throttle.record_attempt(person, now := now + MAX_LOGIN_DELAY_S)
    assert throttle.wait_s(person, now) < throttle.wait_s(intruder, now), "also after a mistake"


def test_log_ins_that_are_turned_away_as_too_many_are_not_counted(tmp_path: Path) -> None:
    auth, _ = auth_service(tmp_path)

    async def flood() -> list[str]:
        tries = (auth.login(f"user{n}", "wrong password", f"10.0.{n}.1") for n in range(200))
        return [getattr(error, "key", "") for error in await asyncio.gather(*tries, return_exceptions=True)]

    found = asyncio.run(flood())
    assert found.count("auth.busy") > 100 and set(found) == {"auth.busy", "auth.wrong_password"}
    assert len(auth.throttle._attempts) == 3 * found.count("auth.wrong_password")


HOSTS = [
    ("10.0.0.1", "10.0.0.2", False),
    ("2001:db8::1", "2001:db8::ffff:1:2:3", True),
    ("2001:db8::1", "2001:db8:0:0:8000::1", True),
    ("2001:db8::1", "2001:db8:0:1::1", False),
    ("::ffff:10.0.0.1", "::ffff:10.0.0.2", False),
    ("::ffff:10.0.0.1", "::1", False),
    ("::ffff:10.0.0.1", "10.0.0.1", True),
    ("fe80::1%eth0", "fe80::2%eth1", True),
    ("unknown", "10.0.0.1", False),
    ("fe80::1%eth0", "fe80::2%eth1", True),
    ("local", "elsewhere", False),
]


@pytest.mark.parametrize(("first", "second", "same"), HOSTS)
def test_addresses_of_one_ipv6_network_share_a_count(first: str, second: str, same: bool, tmp_path: Path) -> None:
    """A host chooses freely among the 2**64 addresses of its network."""
    auth, clock = auth_service(tmp_path)
    for n in range(FREE_ATTEMPTS):
        with pytest.raises(NotAuthenticated):
            run(auth.login(f"user{n}", "wrong password", first))
    clock.now += 0.25
    with pytest.raises(TooManyAttempts) as rejected:
        run(auth.login("user", "wrong password", first))
    assert (rejected.value.key, rejected.value.params) == ("auth.too_many", {"retry_s": 1.8})
    clock.now += 1.25
    with pytest.raises(TooManyAttempts if same else NotAuthenticated):
        run(auth.login("operator", "wrong password", second))


def test_a_right_password_does_not_count(tmp_path: Path) -> None:
    auth, _ = auth_service(tmp_path)
    for _ in range(FREE_ATTEMPTS + 2):
        login(auth)
