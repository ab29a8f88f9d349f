"""The first administrator, by a secret; and codes that let in once."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path

import pytest

from drivebus.service.auth.errors import Conflict, InvalidInput, NotAuthenticated, TooManyAttempts
from drivebus.service.auth.rights import Role
from drivebus.testing.virtual_time import run
from fixtures.auth import auth_service, new_auth_service
from fixtures.web_app import PASSWORD


def test_the_secret_makes_the_first_administrator_once(tmp_path: Path) -> None:
    access, _ = new_auth_service(tmp_path)
    assert access.needs_setup
    assert access.setup_secret.verify("") is False
    with pytest.raises(NotAuthenticated):
        run(access.create_first_administrator("", "ann", PASSWORD, "127.0.0.1"))
    secret = access.setup_secret.issue()
    assert secret == access.setup_secret.issue() and len(secret) == 22, "128 bits of chance"
    assert access.setup_secret.path == tmp_path / "setup-secret"
    assert (
        access.setup_secret.path.read_text() == secret + "\n"
        and access.setup_secret.path.stat().st_mode & 0o777 == 0o600
    )
    for wrong in (secret + "x", "\ud800"):
        with pytest.raises(NotAuthenticated) as rejected:
            run(access.create_first_administrator(wrong, "ann", PASSWORD, "127.0.0.1"))
        assert rejected.value.key == "auth.wrong_secret"
    with pytest.raises(InvalidInput):
        run(access.create_first_administrator(secret, "ann", "short", "127.0.0.1"))
    opened = run(access.create_first_administrator(secret, "ann", PASSWORD, "127.0.0.1"))
    assert access.session_credential(opened.secret) is not None
    assert access.database.user("ann").role is Role.ADMINISTRATOR
    assert not access.setup_secret.path.exists() and not access.setup_secret.verify(secret)
    with pytest.raises(Conflict) as conflict:
        run(access.create_first_administrator(secret, "eve", PASSWORD, "127.0.0.1"))
    assert conflict.value.key == "auth.is_set_up"


def test_the_secret_is_put_where_only_the_plants_user_reads_it(tmp_path: Path) -> None:
    access, _ = new_auth_service(tmp_path / "a" / "state")
    access.setup_secret.issue()
    assert (tmp_path / "a" / "state").stat().st_mode & 0o777 == 0o700
    access.setup_secret.path.unlink()
    access.setup_secret.consume()
    assert not access.setup_secret.path.exists()
    new_auth_service(tmp_path / "a" / "state")[0].setup_secret.issue()


def test_of_two_that_set_up_at_once_one_is_administrator(tmp_path: Path) -> None:
    access, _ = new_auth_service(tmp_path)
    secret = access.setup_secret.issue()

    async def both() -> list[object]:
        tries = (access.create_first_administrator(secret, name, PASSWORD, "127.0.0.1") for name in ("ann", "eve"))
        return await asyncio.gather(*tries, return_exceptions=True)

    found = asyncio.run(both())
    assert sorted(type(one).__name__ for one in found) == ["Conflict", "LoginResult"]
    assert [one.key for one in found if isinstance(one, Conflict)] == ["auth.is_set_up"]
    assert len(access.database.users) == 1


def test_guessing_the_secret_is_throttled(tmp_path: Path) -> None:
    access, _ = new_auth_service(tmp_path)
    secret = access.setup_secret.issue()
    for _ in range(10):
        with pytest.raises(NotAuthenticated):
            run(access.create_first_administrator("guess", "eve", PASSWORD, "10.0.0.9"))
    with pytest.raises(TooManyAttempts):
        run(access.create_first_administrator(secret, "eve", PASSWORD, "10.0.0.9"))


def test_a_code_logs_in_once_and_not_too_late(tmp_path: Path) -> None:
    access, clock = auth_service(tmp_path)
    code = run(access.issue_code("operator", 60))
    assert code not in access.user_file.path.read_text()
    opened = run(access.login_with_code(code, "127.0.0.1"))
    assert opened.session.user == "operator"
    assert len(code) == 22, "128 bits of chance"
    in_time, late = (run(access.issue_code("operator", 60)) for _ in range(2))
    for spent in (code, "guess", "\ud800"):
        with pytest.raises(NotAuthenticated) as rejected:
            run(access.login_with_code(spent, "127.0.0.1"))
        assert rejected.value.key == "auth.wrong_code"
    clock.now += 59.999
    run(access.login_with_code(in_time, "127.0.0.1"))
    clock.now += 0.001
    with pytest.raises(NotAuthenticated):
        run(access.login_with_code(late, "127.0.0.1"))


def test_of_two_who_come_with_one_code_at_once_one_is_let_in(tmp_path: Path) -> None:
    access, _ = auth_service(tmp_path)
    code = run(access.issue_code("operator", 60))

    async def both() -> list[object]:
        return await asyncio.gather(*(access.login_with_code(code, "local") for _ in range(2)), return_exceptions=True)

    found = asyncio.run(both())
    assert sorted(type(one).__name__ for one in found) == ["LoginResult", "NotAuthenticated"]
    assert [one.key for one in found if isinstance(one, NotAuthenticated)] == ["auth.wrong_code"]


def test_a_code_of_a_disabled_user_does_not_log_in(tmp_path: Path) -> None:
    access, _ = auth_service(tmp_path)
    code = run(access.issue_code("operator", 60))
    access.user_file.change(
        lambda register: register.with_changed_user(replace(register.user("operator"), disabled=True))
    )
    with pytest.raises(NotAuthenticated) as rejected:
        run(access.login_with_code(code, "local"))
    assert rejected.value.key == "auth.wrong_code" and access.sessions.of_user("operator") == []


def test_codes_that_are_right_do_not_count_and_wrong_ones_do(tmp_path: Path) -> None:
    access, _ = auth_service(tmp_path)
    for _ in range(11):
        run(access.login_with_code(run(access.issue_code("operator", 60)), "10.0.0.9"))
    for _ in range(10):
        with pytest.raises(NotAuthenticated):
            run(access.login_with_code("guess", "10.0.0.9"))
    with pytest.raises(TooManyAttempts):
        run(access.login_with_code(run(access.issue_code("operator", 60)), "10.0.0.9"))
