"""Which passwords are taken, how they are hashed, and how many may wait for that."""

from __future__ import annotations

import asyncio
import time

import pytest
from argon2 import PasswordHasher

from drivebus.service.auth.errors import AuthUnavailable, InvalidInput
from drivebus.service.auth.passwords import PasswordHashing, check_password_policy
from drivebus.testing.virtual_time import run
from fixtures.web_app import FAST_HASHER, PASSWORD


@pytest.mark.parametrize(
    "password",
    [
        "",
        "short pass"[:9],
        "7#kQ9!2x&4" * 20 + "x",
        "aaaaaaaaaaaa",
        "kvtwkvtwkvtw",
        "Password123",
        "ann smith-01x",
        "1234567890",
    ],
)
def test_a_password_that_is_easily_guessed_is_refused(password: str) -> None:
    with pytest.raises(InvalidInput):
        check_password_policy(password, "ann smith")


GUESSED = (
    "password123456",
    "PASSWORD!!!2026",
    "p@ssw0rd2024",
    "adminadmin",
    "admin-12345",
    "operator123",
    "drivebus123",
    "qwertyuiop",
    "poiuytrewq",
    "1q2w3e4r5t",
    "1qaz2wsx3edc",
    "zxcvbnm123",
    "abcd123456",
    "a123456789",
    "woaini1314",
    "5201314520",
    "13800138000",
    "Summer2026!",
    "welcome pump 1",
    "iloveyou123",
    "asdfghjkl12",
    "password#kv",
    "abc1abc2abc3",
    "fgh1fgh2fgh3",
    "xyz1xyz2xyz3",
    "asd7dsa7sdf7",
)


@pytest.mark.parametrize("password", GUESSED)
def test_common_words_rows_and_digits_are_no_password(password: str) -> None:
    with pytest.raises(InvalidInput) as rejected:
        check_password_policy(password, "somebody else")
    assert rejected.value.key == "auth.password_common"
    assert rejected.value.params == {"different": 5, "own": 4}


KEPT = (
    PASSWORD,
    "seven pumps sing",
    "7#kQ9!2x&4",
    "3fa94b01c7d2",
    "pumpenhaus nord 7",
    "password of the old quay",
    "锅炉房的门朝北开着呢",
    "7#kQ9!2x&4" * 20,
    "password#kvt",
    "kvtw#kvtw#",
    "ab7ba2ab9q",
    "xk7pt7xkpt",
)


@pytest.mark.parametrize("password", KEPT)
def test_what_has_something_of_its_own_is_a_password(password: str) -> None:
    assert check_password_policy(password, "operator") == password


def test_the_hashes_that_are_really_used_are_argon2id_with_64_mib() -> None:
    hashed = run(PasswordHashing().hash(PASSWORD))
    assert hashed.startswith("$argon2id$v=19$m=65536,t=3,p=1$")


@pytest.mark.parametrize("end", ["yzx", "90x", "opx", "klx", "nmx", "0px", "jmx"])
def test_what_goes_on_after_the_end_of_a_row_is_no_run(end: str) -> None:
    assert check_password_policy(f"{end}72k{end}96", "operator")


def test_an_argon2_of_64_mib_and_three_passes_is_what_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """RFC 9106, second choice, on one lane."""
    asked: list[dict[str, int]] = []

    def noted(**given: int) -> PasswordHasher:
        asked.append(given)
        return FAST_HASHER

    monkeypatch.setattr("drivebus.service.auth.passwords.PasswordHasher", noted)
    PasswordHashing()
    assert asked == [{"time_cost": 3, "memory_cost": 64 * 1024, "parallelism": 1}]


def test_one_password_is_hashed_at_a_time() -> None:
    """Each takes 64 MiB."""
    now, most = 0, 0

    class Slow(PasswordHasher):
        def hash(self, password: str | bytes, *, salt: bytes | None = None) -> str:
            nonlocal now, most
            now += 1
            most = max(most, now)
            time.sleep(0.002)
            now -= 1
            return ""

    async def four() -> None:
        passwords = PasswordHashing(Slow())
        await asyncio.gather(*(passwords.hash(PASSWORD) for _ in range(4)))

    asyncio.run(four())
    assert most == 1


def test_the_number_of_waiting_passwords_is_limited() -> None:
    """A flood of logins does not fill the memory; when it is over there is room again."""
    passwords, known = PasswordHashing(FAST_HASHER), FAST_HASHER.hash(PASSWORD)

    async def flood() -> list[object]:
        tries = (passwords.verify(known, PASSWORD) for _ in range(9))
        return await asyncio.gather(*tries, return_exceptions=True)

    for _ in range(2):
        *taken, one_more = asyncio.run(flood())
        assert taken == [True] * 8
        assert isinstance(one_more, AuthUnavailable) and one_more.key == "auth.busy"


def test_a_user_without_a_password_cannot_log_in() -> None:
    """Not even with the password of the hash that is used for unknown users."""
    passwords = PasswordHashing(FAST_HASHER)
    passwords._unknown_user_hash = FAST_HASHER.hash(PASSWORD)
    assert run(passwords.verify(None, PASSWORD)) is False
    assert run(passwords.verify(FAST_HASHER.hash(PASSWORD), "wrong password")) is False


def test_a_password_is_the_same_however_its_accents_are_typed() -> None:
    passwords = PasswordHashing(FAST_HASHER)
    assert run(passwords.verify(run(passwords.hash("caf\u00e9 du port 7")), "cafe\u0301 du port 7"))
