"""Set-up secret of the first administrator, and one-time codes."""

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


def test_the_setup_secret_creates_the_first_administrator_once(tmp_path: Path) -> None:
    auth, _ = new_auth_service(tmp_path)
    assert auth.needs_setup
    assert auth.setup_secret.verify("") is False
    with pytest.raises(NotAuthenticated):
        run(auth.create_first_administrator("", "ann", PASSWORD, "127.0.0.1"))
    secret = auth.setup_secret.issue()
    assert secret == auth.setup_secret.issue() and len(secret) == 22, "128 random bits"
    assert auth.setup_secret.path == tmp_path / "setup-secret"
    assert (
        auth.setup_secret.path.read_text() == secret + "\n" and auth.setup_secret.path.stat().st_mode & 0o777 == 0o600
    )
    for wrong in (secret + "x", "\ud800"):
        with pytest.raises(NotAuthenticated) as rejected:
            run(auth.create_first_administrator(wrong, "ann", PASSWORD, "127.0.0.1"))
        assert rejected.value.key == "auth.wrong_secret"
    with pytest.raises(InvalidInput):
        run(auth.create_first_administrator(secret, "ann", "short", "127.0.0.1"))
    opened = run(auth.create_first_administrator(secret, "ann", PASSWORD, "127.0.0.1"))
    assert auth.session_credential(opened.secret) is not None
    assert auth.database.user("ann").role is Role.ADMINISTRATOR
    assert not auth.setup_secret.path.exists() and not auth.setup_secret.verify(secret)
    with pytest.raises(Conflict) as conflict:
        run(auth.create_first_administrator(secret, "eve", PASSWORD, "127.0.0.1"))
    assert conflict.value.key == "auth.is_set_up"


def test_the_setup_secret_is_readable_by_the_service_user_only(tmp_path: Path) -> None:
    auth, _ = new_auth_service(tmp_path / "a" / "state")
    auth.setup_secret.issue()
    assert (tmp_path / "a" / "state").stat().st_mode & 0o777 == 0o700
    auth.setup_secret.path.unlink()
    auth.setup_secret.consume()
    assert not auth.setup_secret.path.exists()
    new_auth_service(tmp_path / "a" / "state")[0].setup_secret.issue()


def test_only_one_of_two_concurrent_setups_succeeds(tmp_path: Path) -> None:
    auth, _ = new_auth_service(tmp_path)
    secret = auth.setup_secret.issue()

    async def both() -> list[object]:
        tries = (auth.create_first_administrator(secret, name, PASSWORD, "127.0.0.1") for name in ("ann", "eve"))
        return await asyncio.gather(*tries, return_exceptions=True)

    found = asyncio.run(both())
    assert sorted(type(result).__name__ for result in found) == ["Conflict", "LoginResult"]
    assert [result.key for result in found if isinstance(result, Conflict)] == ["auth.is_set_up"]
    assert len(auth.database.users) == 1


def test_guessing_the_secret_is_throttled(tmp_path: Path) -> None:
    auth, _ = new_auth_service(tmp_path)
    secret = auth.setup_secret.issue()
    for _ in range(10):
        with pytest.raises(NotAuthenticated):
            run(auth.create_first_administrator("guess", "eve", PASSWORD, "10.0.0.9"))
    with pytest.raises(TooManyAttempts):
        run(auth.create_first_administrator(secret, "eve", PASSWORD, "10.0.0.9"))


def test_a_code_logs_in_once_and_only_before_its_expiry(tmp_path: Path) -> None:
    auth, clock = auth_service(tmp_path)
    code = run(auth.issue_code("operator", 60))
    assert code not in auth.user_file.path.read_text()
    opened = run(auth.login_with_code(code, "127.0.0.1"))
    assert opened.session.user == "operator"
    assert len(code) == 22, "128 random bits"
    in_time, late = (run(auth.issue_code("operator", 60)) for _ in range(2))
    for spent in (code, "guess", "\ud800"):
        with pytest.raises(NotAuthenticated) as rejected:
            run(auth.login_with_code(spent, "127.0.0.1"))
        assert rejected.value.key == "auth.wrong_code"
    clock.now += 59.999
    run(auth.login_with_code(in_time, "127.0.0.1"))
    clock.now += 0.001
    with pytest.raises(NotAuthenticated):
        run(auth.login_with_code(late, "127.0.0.1"))


def test_only_one_of_two_concurrent_logins_with_a_code_succeeds(tmp_path: Path) -> None:
    auth, _ = auth_service(tmp_path)
    code = run(auth.issue_code("operator", 60))

    async def both() -> list[object]:
        return await asyncio.gather(*(auth.login_with_code(code, "local") for _ in range(2)), return_exceptions=True)

    found = asyncio.run(both())
    assert sorted(type(result).__name__ for result in found) == ["LoginResult", "NotAuthenticated"]
    assert [result.key for result in found if isinstance(result, NotAuthenticated)] == ["auth.wrong_code"]


def test_a_code_of_a_disabled_user_does_not_log_in(tmp_path: Path) -> None:
    auth, _ = auth_service(tmp_path)
    code = run(auth.issue_code("operator", 60))
    auth.user_file.change(
        lambda database: database.with_changed_user(replace(database.user("operator"), disabled=True))
    )
    with pytest.raises(NotAuthenticated) as rejected:
        run(auth.login_with_code(code, "local"))
    assert rejected.value.key == "auth.wrong_code" and auth.sessions.of_user("operator") == []


def test_only_wrong_codes_count_for_the_throttle(tmp_path: Path) -> None:
    auth, _ = auth_service(tmp_path)
    for _ in range(11):
        run(auth.login_with_code(run(auth.issue_code("operator", 60)), "10.0.0.9"))
    for _ in range(10):
        with pytest.raises(NotAuthenticated):
            run(auth.login_with_code("guess", "10.0.0.9"))
    with pytest.raises(TooManyAttempts):
        run(auth.login_with_code(run(auth.issue_code("operator", 60)), "10.0.0.9"))
