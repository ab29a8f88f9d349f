"""Password policy, hashing, and the limit of waiting hashes."""

from __future__ import annotations

import asyncio
import time
from contextlib import nullcontext

import pytest
from argon2 import PasswordHasher

from drivebus.service.auth.errors import AuthUnavailable, InvalidInput
from drivebus.service.auth.password_policy import MIN_KNOWN_LENGTH, check_password_policy, common_passwords
from drivebus.service.auth.passwords import PasswordHashing
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
def test_a_guessable_password_is_rejected(password: str) -> None:
    with pytest.raises(InvalidInput):
        check_password_policy(password, "ann smith")


GUESSABLE = (
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


@pytest.mark.parametrize("password", GUESSABLE)
def test_common_words_keyboard_rows_and_digits_are_rejected(password: str) -> None:
    with pytest.raises(InvalidInput) as rejected:
        check_password_policy(password, "another")
    assert rejected.value.key == "auth.password_common"
    assert rejected.value.params == {"different": 5, "own": 4}


ACCEPTED = (
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


@pytest.mark.parametrize("password", ACCEPTED)
def test_a_password_with_enough_uncommon_characters_is_accepted(password: str) -> None:
    assert check_password_policy(password, "operator") == password


@pytest.mark.parametrize(
    ("name", "is_refused"), [("li", False), ("fan", True), ("FAN", True), ("王芳", True), ("anna", False)]
)
def test_a_name_of_two_ascii_characters_may_be_in_a_password_and_a_longer_one_not(name: str, is_refused: bool) -> None:
    """A user "li" could use hardly any password: nearly every one that was made up contained the name."""
    password = "olive fan 王芳 kvt"
    with pytest.raises(InvalidInput) if is_refused else nullcontext():
        check_password_policy(password, name)


@pytest.mark.parametrize(
    ("name", "password"),
    [("li", "li-2026-li!"), ("li", "Li-Li-Li-12"), ("bo", "bo20260712"), ("a1", "a1a1a1-2026"), ("jo", "jo.jo.2026")],
)
def test_a_password_of_a_name_of_two_characters_and_few_other_letters_is_refused(name: str, password: str) -> None:
    with pytest.raises(InvalidInput):
        check_password_policy(password, name)


@pytest.mark.parametrize(
    "password",
    [
        "charlie123",
        "Liverpool1",
        "correcthorse",
        "windowhorse1",
        "trustno1trustno1",
        "abcd1234!@#$",
        "ch@rlie-2026",
        "michaelmichael",
        "absolutely",
        "aisleaisleaisle",
        "volleyabel",
        "abelvolley",
    ],
)
def test_a_frequent_password_is_rejected_also_repeated_joined_or_with_digits(password: str) -> None:
    with pytest.raises(InvalidInput, match="easily guessed"):
        check_password_policy(password, "li")


def test_a_password_of_64_characters_counts_to_its_last_one() -> None:
    password = "boiler tractor window kettle umbra guitar marble cactus ferry 12"
    assert len(password) == 64 and check_password_policy(password, "li") == password
    hashing = PasswordHashing(FAST_HASHER)
    hashed = asyncio.run(hashing.hash(password))
    assert asyncio.run(hashing.verify(hashed, password))
    assert not asyncio.run(hashing.verify(hashed, password[:-1] + "3"))


@pytest.mark.parametrize("password", ["correct horse battery", "boiler-tractor-window", "Zx9-kettle-umbra"])
def test_three_words_are_a_passphrase(password: str) -> None:
    assert check_password_policy(password, "li") == password


def test_more_than_three_thousand_frequent_passwords_are_known() -> None:
    common_passwords.cache_clear()
    assert len(common_passwords()) > 13_000
    assert min(map(len, common_passwords())) == MIN_KNOWN_LENGTH
    assert not any(line.startswith("#") for line in common_passwords())


def test_a_hash_is_argon2id_with_64_mib_and_three_passes() -> None:
    hashed = run(PasswordHashing().hash(PASSWORD))
    assert hashed.startswith("$argon2id$v=19$m=65536,t=3,p=1$")


@pytest.mark.parametrize("end", ["yzx", "90x", "opx", "klx", "nmx", "0px", "jmx"])
def test_characters_beyond_the_end_of_a_keyboard_row_are_no_run(end: str) -> None:
    assert check_password_policy(f"{end}72k{end}96", "operator")


def test_the_default_hasher_uses_64_mib_and_three_passes(monkeypatch: pytest.MonkeyPatch) -> None:
    """RFC 9106, second recommended option, on one lane."""
    options: list[dict[str, int]] = []

    def noted(**arguments: int) -> PasswordHasher:
        options.append(arguments)
        return FAST_HASHER

    monkeypatch.setattr("drivebus.service.auth.passwords.PasswordHasher", noted)
    PasswordHashing()
    assert options == [{"time_cost": 3, "memory_cost": 64 * 1024, "parallelism": 1}]


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
    """A flood of logins fills no memory, and later logins work."""
    passwords, known = PasswordHashing(FAST_HASHER), FAST_HASHER.hash(PASSWORD)

    async def flood() -> list[object]:
        tries = (passwords.verify(known, PASSWORD) for _ in range(9))
        return await asyncio.gather(*tries, return_exceptions=True)

    for _ in range(2):
        *accepted, rejected = asyncio.run(flood())
        assert accepted == [True] * 8
        assert isinstance(rejected, AuthUnavailable) and rejected.key == "auth.busy"


def test_a_user_without_a_password_cannot_log_in() -> None:
    """The password of the hash that is verified instead does not help either."""
    passwords = PasswordHashing(FAST_HASHER)
    passwords._unknown_user_hash = FAST_HASHER.hash(PASSWORD)
    assert run(passwords.verify(None, PASSWORD)) is False
    assert run(passwords.verify(FAST_HASHER.hash(PASSWORD), "wrong password")) is False


def test_a_password_matches_in_each_unicode_form() -> None:
    passwords = PasswordHashing(FAST_HASHER)
    assert run(passwords.verify(run(passwords.hash("caf\u00e9 du port 7")), "cafe\u0301 du port 7"))
