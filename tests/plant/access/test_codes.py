"""S06: the first administrator, by a secret; and codes that let in once."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path

import pytest

from accesskit import empty, made
from doorkit import PASSWORD
from drivebus.plant.access.refusals import Conflict, NotLoggedIn, TooManyAttempts, Unfit
from drivebus.plant.access.rights import Role
from drivebus.testing.virtual import run


def test_s06_the_secret_makes_the_first_administrator_once(tmp_path: Path) -> None:
    access, _ = empty(tmp_path)
    assert access.needs_setup
    assert access.setup.fits("") is False
    with pytest.raises(NotLoggedIn):
        run(access.set_up("", "ann", PASSWORD, "127.0.0.1"))
    secret = access.setup.offer()
    assert secret == access.setup.offer() and len(secret) == 22, "128 bits of chance"
    assert access.setup.path == tmp_path / "setup-secret"
    assert access.setup.path.read_text() == secret + "\n" and access.setup.path.stat().st_mode & 0o777 == 0o600
    for wrong in (secret + "x", "\ud800"):
        with pytest.raises(NotLoggedIn) as refused:
            run(access.set_up(wrong, "ann", PASSWORD, "127.0.0.1"))
        assert refused.value.key == "access.wrong_secret"
    with pytest.raises(Unfit):
        run(access.set_up(secret, "ann", "short", "127.0.0.1"))
    opened = run(access.set_up(secret, "ann", PASSWORD, "127.0.0.1"))
    assert access.by_cookie(opened.secret) is not None
    assert access.register.user("ann").role is Role.ADMINISTRATOR
    assert not access.setup.path.exists() and not access.setup.fits(secret)
    with pytest.raises(Conflict) as conflict:
        run(access.set_up(secret, "eve", PASSWORD, "127.0.0.1"))
    assert conflict.value.key == "access.is_set_up"


def test_s06_the_secret_is_put_where_only_the_plants_user_reads_it(tmp_path: Path) -> None:
    access, _ = empty(tmp_path / "a" / "state")
    access.setup.offer()
    assert (tmp_path / "a" / "state").stat().st_mode & 0o777 == 0o700
    access.setup.path.unlink()
    access.setup.used()
    assert not access.setup.path.exists()
    empty(tmp_path / "a" / "state")[0].setup.offer()


def test_s06_of_two_that_set_up_at_once_one_is_administrator(tmp_path: Path) -> None:
    access, _ = empty(tmp_path)
    secret = access.setup.offer()

    async def both() -> list[object]:
        tries = (access.set_up(secret, name, PASSWORD, "127.0.0.1") for name in ("ann", "eve"))
        return await asyncio.gather(*tries, return_exceptions=True)

    found = asyncio.run(both())
    assert sorted(type(one).__name__ for one in found) == ["Conflict", "Opened"]
    assert [one.key for one in found if isinstance(one, Conflict)] == ["access.is_set_up"]
    assert len(access.register.users) == 1


def test_s06_guessing_the_secret_is_throttled(tmp_path: Path) -> None:
    access, _ = empty(tmp_path)
    secret = access.setup.offer()
    for _ in range(10):
        with pytest.raises(NotLoggedIn):
            run(access.set_up("guess", "eve", PASSWORD, "10.0.0.9"))
    with pytest.raises(TooManyAttempts):
        run(access.set_up(secret, "eve", PASSWORD, "10.0.0.9"))


def test_a_code_logs_in_once_and_not_too_late(tmp_path: Path) -> None:
    access, clock = made(tmp_path)
    code = run(access.issue_code("operator", 60))
    assert code not in access.file.path.read_text()
    opened = run(access.login_once(code, "127.0.0.1"))
    assert opened.session.user == "operator"
    assert len(code) == 22, "128 bits of chance"
    in_time, late = (run(access.issue_code("operator", 60)) for _ in range(2))
    for spent in (code, "guess", "\ud800"):
        with pytest.raises(NotLoggedIn) as refused:
            run(access.login_once(spent, "127.0.0.1"))
        assert refused.value.key == "access.wrong_code"
    clock.now += 59.999
    run(access.login_once(in_time, "127.0.0.1"))
    clock.now += 0.001
    with pytest.raises(NotLoggedIn):
        run(access.login_once(late, "127.0.0.1"))


def test_of_two_who_come_with_one_code_at_once_one_is_let_in(tmp_path: Path) -> None:
    access, _ = made(tmp_path)
    code = run(access.issue_code("operator", 60))

    async def both() -> list[object]:
        return await asyncio.gather(*(access.login_once(code, "local") for _ in range(2)), return_exceptions=True)

    found = asyncio.run(both())
    assert sorted(type(one).__name__ for one in found) == ["NotLoggedIn", "Opened"]
    assert [one.key for one in found if isinstance(one, NotLoggedIn)] == ["access.wrong_code"]


def test_s04_a_code_of_somebody_who_was_disabled_lets_nobody_in(tmp_path: Path) -> None:
    access, _ = made(tmp_path)
    code = run(access.issue_code("operator", 60))
    access.file.change(lambda register: register.changed(replace(register.user("operator"), disabled=True)))
    with pytest.raises(NotLoggedIn) as refused:
        run(access.login_once(code, "local"))
    assert refused.value.key == "access.wrong_code" and access.sessions.of("operator") == []


def test_s05_codes_that_are_right_do_not_count_and_wrong_ones_do(tmp_path: Path) -> None:
    access, _ = made(tmp_path)
    for _ in range(11):
        run(access.login_once(run(access.issue_code("operator", 60)), "10.0.0.9"))
    for _ in range(10):
        with pytest.raises(NotLoggedIn):
            run(access.login_once("guess", "10.0.0.9"))
    with pytest.raises(TooManyAttempts):
        run(access.login_once(run(access.issue_code("operator", 60)), "10.0.0.9"))
