"""Sessions on the server, found by a secret that is kept as a hash; idle, old, replaced, ended."""

from __future__ import annotations

import asyncio
import re
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from drivebus.service.auth.actor import Actor
from drivebus.service.auth.credentials import TokenCredential
from drivebus.service.auth.errors import AccessDenied, NotAuthenticated, TooManyAttempts
from drivebus.service.auth.passwords import PasswordHashing
from drivebus.service.auth.rights import ROLE_RIGHTS, Right, Role
from drivebus.service.auth.service import SESSION_SAVE_INTERVAL_S, AuthService
from drivebus.service.auth.sessions import (
    MAX_SESSIONS_PER_USER,
    SESSION_IDLE_TIMEOUT_S,
    SESSION_LIFETIME_S,
    secret_digest,
)
from drivebus.service.auth.users import Token, UserDatabase
from drivebus.testing.virtual_time import run
from drivebus.web.routes.schemas import UserChangeBody
from drivebus.web.routes.users import _change_user
from fixtures.auth import auth_service, login, restarted
from fixtures.web_app import FAST_HASHER, PASSWORD, SteppedClock


def test_a_session_secret_has_256_random_bits_and_is_stored_as_a_hash(tmp_path: Path) -> None:
    access, _ = auth_service(tmp_path)
    secrets = {login(access)[0] for _ in range(8)}
    assert len(secrets) == 8 and all(len(secret) == 43 for secret in secrets)
    kept = repr(access.sessions.__dict__)
    assert not any(secret in kept for secret in secrets)
    assert all(secret_digest(secret) in kept for secret in secrets)


def test_session_times_are_the_documented_ones() -> None:
    assert (SESSION_IDLE_TIMEOUT_S, SESSION_LIFETIME_S) == (15 * 60, 12 * 3600)
    assert (MAX_SESSIONS_PER_USER, SESSION_SAVE_INTERVAL_S) == (20, 60)


def test_session_id_and_csrf_token_are_random(tmp_path: Path) -> None:
    """A secret has at least 128 bits, and no session is unlocked with an old one."""
    access, clock = auth_service(tmp_path)
    _, visitor = login(access)
    assert len(visitor.session.csrf) == 32 and len(access.sessions.unlock(visitor.session, clock.now)) == 43
    assert re.fullmatch("s-[0-9a-f]{16}", visitor.session.id)


@pytest.mark.parametrize("secret", ["", "x", "\ud800", "passwörd"])
def test_an_unknown_cookie_has_no_credential(secret: str, tmp_path: Path) -> None:
    access, _ = auth_service(tmp_path)
    login(access)
    assert access.session_credential(secret) is None and access.token_credential(secret, "local") is None


def test_after_fifteen_idle_minutes_a_session_may_see_and_stop_and_nothing_else(tmp_path: Path) -> None:
    access, clock = auth_service(tmp_path)
    secret, visitor = login(access)
    clock.now += SESSION_IDLE_TIMEOUT_S - 1
    assert visitor.actor.rights == ROLE_RIGHTS[Role.OPERATOR]
    clock.now += 1
    assert visitor.actor.rights == {Right.VIEW, Right.STOP}
    visitor.session.record_activity(clock.now)
    assert visitor.is_idle, "a touch does not wake it, a password does"
    assert access.session_credential(secret) is not None
    assert login(access)[1].actor.may(Right.OPERATE)


def test_activity_in_time_keeps_a_session_active(tmp_path: Path) -> None:
    access, clock = auth_service(tmp_path)
    _, visitor = login(access)
    for _ in range(10):
        clock.now += SESSION_IDLE_TIMEOUT_S - 1
        visitor.session.record_activity(clock.now)
    assert visitor.actor.may(Right.OPERATE)


def test_a_password_unlocks_an_idle_session_and_voids_its_old_secret(tmp_path: Path) -> None:
    access, clock = auth_service(tmp_path)
    old, visitor = login(access)
    other, _ = login(access)
    clock.now += SESSION_IDLE_TIMEOUT_S
    with pytest.raises(AccessDenied):
        run(access.unlock(visitor.session, "wrong password"))
    assert visitor.is_idle
    woken = run(access.unlock(visitor.session, PASSWORD))
    assert woken.session is visitor.session and not visitor.is_idle
    for lived in (access, restarted(access, clock)):
        assert [lived.session_credential(one) is not None for one in (old, woken.secret, other)] == [False, True, True]


def test_an_idle_viewer_gains_no_stop(tmp_path: Path) -> None:
    access, clock = auth_service(tmp_path, Role.VIEWER)
    _, visitor = login(access, "viewer")
    clock.now += SESSION_IDLE_TIMEOUT_S
    assert visitor.actor.rights == {Right.VIEW}


def test_a_session_ends_after_twelve_hours_whatever_is_done(tmp_path: Path) -> None:
    access, clock = auth_service(tmp_path)
    secret, visitor = login(access)
    begun = clock.now
    while clock.now - begun < SESSION_LIFETIME_S:
        assert access.session_credential(secret) is not None
        clock.now += 600.0
        visitor.session.record_activity(clock.now)
    assert access.session_credential(secret) is None
    assert visitor.session.end_reason == "expired"
    assert visitor.actor.rights == frozenset()
    assert secret_digest(secret) not in repr(access.sessions.__dict__), "nothing of it is left"


def test_an_open_connection_loses_all_rights_after_twelve_hours(tmp_path: Path) -> None:
    """Its cookie is never sent again."""
    access, clock = auth_service(tmp_path)
    _, visitor = login(access)
    clock.now += SESSION_LIFETIME_S - 1
    assert visitor.actor.rights == {Right.VIEW, Right.STOP} and visitor.end_reason is None
    clock.now += 1
    assert visitor.actor.rights == frozenset() and visitor.end_reason == "expired"


def test_the_first_reason_of_an_end_stays_and_wakes_waiting_tasks_at_once(tmp_path: Path) -> None:
    access, _ = auth_service(tmp_path)
    _, visitor = login(access)

    async def scenario() -> str:
        waiting = asyncio.create_task(visitor.wait_ended())
        await asyncio.sleep(0.1)
        await access.logout(visitor.session)
        visitor.session.end("rights")
        begun = asyncio.get_running_loop().time()
        why = await waiting
        assert asyncio.get_running_loop().time() == begun
        return why

    assert run(scenario(), max_s=60.0) == visitor.session.end_reason == "logout"


def test_ended_for_all_is_ended_at_once(tmp_path: Path) -> None:
    access, _ = auth_service(tmp_path)
    mine = [login(access) for _ in range(3)]
    _, other = login(access, "administrator")
    assert run(access.end_sessions("OPERATOR", "logout")) == 3
    assert {visitor.session.end_reason for _, visitor in mine} == {"logout"}
    kept = repr(access.sessions.__dict__)
    assert [secret_digest(secret) in kept for secret, _ in mine] == [False] * 3 and access.sessions.of_user(
        "operator"
    ) == []
    assert [access.session_credential(secret) for secret, _ in mine] == [None] * 3
    assert [visitor.actor.rights for _, visitor in mine] == [frozenset()] * 3
    assert other.end_reason is None


def test_a_users_oldest_session_makes_room(tmp_path: Path) -> None:
    access, clock = auth_service(tmp_path)
    found = []
    for _ in range(MAX_SESSIONS_PER_USER + 2):
        clock.now += 1
        found.append(login(access))
    kept = repr(access.sessions.__dict__)
    assert [secret_digest(secret) in kept for secret, _ in found] == [False, False] + [True] * MAX_SESSIONS_PER_USER
    assert [visitor.session.end_reason for _, visitor in found] == ["replaced"] * 2 + [None] * MAX_SESSIONS_PER_USER


def test_a_session_that_is_too_old_takes_no_room(tmp_path: Path) -> None:
    """An expired session is removed first, even if others were used longer ago."""
    access, clock = auth_service(tmp_path)
    _, oldest = login(access)
    begun = clock.now
    for _ in range(MAX_SESSIONS_PER_USER - 1):
        clock.now += 1
        login(access)
    while clock.now < begun + SESSION_LIFETIME_S:
        oldest.session.record_activity(clock.now)
        clock.now += 600
    clock.now = begun + SESSION_LIFETIME_S
    others = access.sessions.of_user("operator")[1:]
    login(access)
    assert oldest.session.end_reason == "expired" and [one.end_reason for one in others] == [None] * (
        MAX_SESSIONS_PER_USER - 1
    )


@pytest.mark.parametrize(
    "change",
    [
        lambda user: replace(user, role=Role.VIEWER),
        lambda user: replace(user, disabled=True),
        lambda user: replace(user, password="another"),
    ],
    ids=["role", "disabled", "password"],
)
def test_a_change_of_the_user_in_the_file_ends_the_session(tmp_path: Path, change) -> None:  # type: ignore[no-untyped-def]
    access, _ = auth_service(tmp_path)
    secret, visitor = login(access)
    access.user_file.change(lambda register: register.with_changed_user(change(register.user("operator"))))
    assert visitor.actor.rights == frozenset()
    assert access.session_credential(secret) is None
    assert visitor.session.end_reason == "rights"


def test_a_waiting_task_learns_of_the_end_within_a_second(tmp_path: Path) -> None:
    access, _ = auth_service(tmp_path)
    _, visitor = login(access)

    async def scenario() -> float:
        loop = asyncio.get_running_loop()
        waiting = asyncio.create_task(visitor.wait_ended())
        await asyncio.sleep(10)
        assert not waiting.done()
        access.user_file.change(lambda register: register.without_user("operator"))
        begun = loop.time()
        assert await waiting == "rights"
        return loop.time() - begun

    assert run(scenario(), max_s=60.0) <= 1.0


def test_a_new_password_ends_every_other_session_and_gives_a_new_secret(tmp_path: Path) -> None:
    access, _ = auth_service(tmp_path)
    first, _ = login(access)
    second, visitor = login(access)
    opened = run(access.change_password(visitor.session, PASSWORD, "a quite new pass phrase"))
    assert access.sessions.of_user("operator") == [opened.session], "at once, before anybody looks for them"
    assert visitor.session.end_reason == "rights"
    assert access.session_credential(first) is None and access.session_credential(second) is None
    assert access.session_credential(opened.secret) is not None
    with pytest.raises(NotAuthenticated):
        login(access)
    login(access, password="a quite new pass phrase")


def meanwhile(access: AuthService, monkeypatch: pytest.MonkeyPatch, **changed: object) -> None:
    """While the next password is hashed an administrator changes the operator."""
    plain = access.passwords.hash

    async def slow(password: str) -> str:
        access.user_file.change(
            lambda register: register.with_changed_user(replace(register.user("operator"), **changed))
        )
        return await plain(password)

    monkeypatch.setattr(access.passwords, "hash", slow)


@pytest.mark.parametrize("changed", [{"role": Role.VIEWER}, {"disabled": True}], ids=["demoted", "disabled"])
def test_a_password_change_restores_no_right_that_was_withdrawn_meanwhile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changed: dict[str, object]
) -> None:
    access, _ = auth_service(tmp_path)
    _, visitor = login(access)
    meanwhile(access, monkeypatch, **changed)
    with pytest.raises(NotAuthenticated) as rejected:
        run(access.change_password(visitor.session, PASSWORD, "a quite new pass phrase"))
    assert rejected.value.key == "auth.wrong_password"
    found = access.database.user("operator")
    assert {name: getattr(found, name) for name in changed} == changed
    assert access.sessions.of_user("operator") == [visitor.session] and visitor.end_reason == "rights"


@pytest.mark.parametrize(
    "change",
    [
        lambda register: register.without_user("operator"),
        lambda register: register.with_changed_user(replace(register.user("operator"), role=Role.VIEWER)),
        lambda register: register.with_changed_user(replace(register.user("operator"), disabled=True)),
    ],
    ids=["removed", "demoted", "disabled"],
)
def test_a_user_changed_during_the_password_check_is_not_logged_in(
    change: Callable[[UserDatabase], UserDatabase], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    access, _ = auth_service(tmp_path)
    plain = access.passwords.verify

    async def slow(known: str | None, password: str) -> bool:
        access.user_file.change(change)
        return await plain(known, password)

    monkeypatch.setattr(access.passwords, "verify", slow)
    with pytest.raises(NotAuthenticated) as rejected:
        run(access.login("operator", PASSWORD, "local"))
    assert rejected.value.key == "auth.wrong_password" and access.sessions.of_user("operator") == []


@pytest.mark.parametrize("changed", [{"role": Role.VIEWER}, {"disabled": True}], ids=["demoted", "disabled"])
def test_a_new_password_by_an_administrator_does_not_either(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changed: dict[str, object]
) -> None:
    """Each of two administrators changes what that one names, and nothing else."""
    access, _ = auth_service(tmp_path)
    secret, _ = login(access)
    meanwhile(access, monkeypatch, **changed)
    body = UserChangeBody(password="a quite new pass phrase")
    message = run(_change_user(access, "operator", body, "administrator"))
    found = access.database.user("operator")
    assert message == found and {name: getattr(found, name) for name in changed} == changed
    assert run(access.passwords.verify(found.password, "a quite new pass phrase"))
    assert access.session_credential(secret) is None


def test_a_wrong_old_password_changes_nothing_and_counts(tmp_path: Path) -> None:
    access, _ = auth_service(tmp_path)
    _, visitor = login(access)
    for _ in range(10):
        with pytest.raises(AccessDenied):
            run(access.change_password(visitor.session, "wrong password", "a quite new pass phrase"))
    with pytest.raises(TooManyAttempts):
        run(access.change_password(visitor.session, PASSWORD, "a quite new pass phrase"))
    assert visitor.end_reason is None


def test_a_user_who_is_unknown_or_disabled_takes_as_long_as_a_wrong_password(tmp_path: Path) -> None:
    """Neither the response nor its time shows which names exist: each login computes one hash."""
    access, _ = auth_service(tmp_path)
    access.user_file.change(
        lambda register: register.with_changed_user(replace(register.user("operator"), disabled=True))
    )
    checked: list[str] = []
    verify = access.passwords._verify
    access.passwords._verify = lambda known, text: checked.append(known) or verify(known, text)  # type: ignore[method-assign,func-returns-value]
    message = set()
    for name in ("operator", "unknown", "administrator"):
        with pytest.raises(NotAuthenticated) as raised:
            run(access.login(name, "wrong password", "127.0.0.1"))
        message.add((raised.value.key, str(raised.value.params)))
    assert len(checked) == 3 and message == {("auth.wrong_password", "{}")}
    with pytest.raises(NotAuthenticated):
        run(access.login("operator", PASSWORD, "127.0.0.1"))


def test_a_session_outlives_a_crash_of_the_web_process(tmp_path: Path) -> None:
    """No password stands between a person and a stop because a process was killed."""
    access, clock = auth_service(tmp_path)
    secret, visitor = login(access)
    clock.now += SESSION_IDLE_TIMEOUT_S - 1
    run(access.record_activity(visitor.session))
    again = restarted(access, clock).session_credential(secret)
    assert again is not None and again.actor == visitor.actor and again.session.csrf == visitor.session.csrf
    clock.now += SESSION_IDLE_TIMEOUT_S - 1
    assert again.actor.may(Right.OPERATE), "the touch was kept"
    clock.now += SESSION_LIFETIME_S
    assert restarted(access, clock).session_credential(secret) is None
    assert access.session_store.path == tmp_path / "sessions.json"
    assert (
        access.session_store.path.stat().st_mode & 0o777 == 0o600
        and secret not in access.session_store.path.read_text()
    )


def test_a_touch_is_written_down_once_a_minute(tmp_path: Path) -> None:
    access, clock = auth_service(tmp_path)
    _, visitor = login(access)
    begun = clock.now
    for passed_s, kept_s in (
        (SESSION_SAVE_INTERVAL_S - 1, 0.0),
        (SESSION_SAVE_INTERVAL_S, SESSION_SAVE_INTERVAL_S),
        (2 * SESSION_SAVE_INTERVAL_S - 1, SESSION_SAVE_INTERVAL_S),
        (2 * SESSION_SAVE_INTERVAL_S, 2 * SESSION_SAVE_INTERVAL_S),
    ):
        clock.now = begun + passed_s
        run(access.record_activity(visitor.session))
        assert access.session_store.read()[0].active == begun + kept_s


def test_a_touch_of_a_session_that_outlived_a_crash_is_written_down_too(tmp_path: Path) -> None:
    access, clock = auth_service(tmp_path)
    secret, _ = login(access)
    fresh = restarted(access, clock)
    visitor = fresh.session_credential(secret)
    assert visitor is not None
    for passed_s, kept in ((SESSION_SAVE_INTERVAL_S - 1, 0.0), (1, SESSION_SAVE_INTERVAL_S)):
        clock.now += passed_s
        run(fresh.record_activity(visitor.session))
        assert fresh.session_store.read()[0].active == 1000.0 + kept


def test_a_request_does_not_wait_for_a_disk_that_hangs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It may be a stop."""
    access, clock = auth_service(tmp_path)
    _, visitor = login(access)
    clock.now += SESSION_SAVE_INTERVAL_S
    hangs = threading.Event()
    monkeypatch.setattr(access.session_store, "write", lambda kept: hangs.wait(20.0))

    async def scenario() -> None:
        await asyncio.wait_for(access.record_activity(visitor.session), 5.0)
        assert not hangs.is_set()
        hangs.set()

    asyncio.run(scenario())


def test_what_was_ended_stays_ended_after_a_crash(tmp_path: Path) -> None:
    access, clock = auth_service(tmp_path)
    one, other = login(access), login(access, "administrator")
    run(access.logout(one[1].session))
    assert restarted(access, clock).session_credential(one[0]) is None
    assert restarted(access, clock).session_credential(other[0]) is not None
    access.user_file.change(
        lambda register: register.with_changed_user(replace(register.user("administrator"), password="new"))
    )
    assert restarted(access, clock).session_credential(other[0]) is None
    again, _ = login(access)
    run(access.end_sessions("OPERATOR", "logout"))
    assert restarted(access, clock).session_credential(again) is None


def test_no_session_outlives_the_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The monotonic clock restarts with the machine: ages would be wrong."""
    access, clock = auth_service(tmp_path)
    secret, _ = login(access)
    monkeypatch.setattr("drivebus.service.auth.sessions._BOOT_ID_FILE", tmp_path / "another")
    assert restarted(access, clock).session_credential(secret) is None
    (tmp_path / "another").write_text("another boot")
    assert restarted(access, clock).session_credential(secret) is None
    (tmp_path / "another").unlink()
    secret, _ = login(access)
    assert restarted(access, clock).session_credential(secret) is None, "the boot of the session is unknown"


@pytest.mark.parametrize("content", ["", "{", "[]", '{"boot": "x", "sessions": [{}]}'])
def test_a_file_of_sessions_that_can_not_be_read_costs_a_login(tmp_path: Path, content: str) -> None:
    access, clock = auth_service(tmp_path)
    secret, _ = login(access)
    access.session_store.path.write_text(content)
    fresh = restarted(access, clock)
    assert fresh.session_credential(secret) is None
    login(fresh)


def test_a_full_disk_prevents_no_login(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    access, _ = auth_service(tmp_path)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("drivebus.service.auth.sessions.atomic_write_private", full)
    secret, visitor = login(access)
    assert access.session_credential(secret) is not None
    run(access.logout(visitor.session))
    assert access.session_credential(secret) is None


def test_a_hanging_disk_is_written_to_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not once for each request that comes meanwhile."""
    access, clock = auth_service(tmp_path)
    _, visitor = login(access)

    async def scenario() -> int:
        hung = asyncio.Event()
        monkeypatch.setattr(access, "keep", hung.wait)
        for _ in range(3):
            clock.now += SESSION_SAVE_INTERVAL_S
            await access.record_activity(visitor.session)
        return len(asyncio.all_tasks())

    assert run(scenario()) == 2, "this one, and the one that writes"


def test_the_user_file_is_where_the_plant_file_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivebus.service.auth.service.PasswordHashing", lambda: "as they are in earnest")
    assert AuthService(tmp_path).passwords == "as they are in earnest"  # type: ignore[comparison-overlap]
    assert AuthService(tmp_path, passwords=PasswordHashing(FAST_HASHER)).user_file.path == tmp_path / "users.json"
    elsewhere = tmp_path / "users.json"
    assert AuthService(tmp_path, elsewhere, passwords=PasswordHashing(FAST_HASHER)).user_file.path == elsewhere


def token_of(access: AuthService, clock: SteppedClock, *rights: Right) -> TokenCredential:
    token = Token("t1", "scada", "operator", rights, secret_digest("secret"), 0, clock.wall_ms() + 1000)
    access.user_file.change(lambda register: register.with_token(token))
    visitor = access.token_credential("secret", "10.0.0.9")
    assert visitor is not None
    return visitor


def test_a_token_acts_in_its_users_name_from_afar_with_its_scope(tmp_path: Path) -> None:
    access, clock = auth_service(tmp_path)
    actor = token_of(access, clock, Right.VIEW, Right.STOP).actor
    assert actor == Actor("operator/scada", frozenset({Right.VIEW, Right.STOP}), "token-t1", True, "10.0.0.9")
    _, visitor = login(access)
    assert visitor.actor.remote, "two steps to a start"
    assert visitor.actor == Actor("operator", ROLE_RIGHTS[Role.OPERATOR], visitor.session.id, True, "127.0.0.1")


def test_a_forged_token_has_no_credential(tmp_path: Path) -> None:
    access, clock = auth_service(tmp_path)
    visitor = token_of(access, clock, Right.VIEW)
    assert access.token_credential("guess", "10.0.0.9") is None and access.token_credential("", "10.0.0.9") is None
    assert not visitor.is_idle


def test_a_connection_of_a_token_ends_with_its_date(tmp_path: Path) -> None:
    access, clock = auth_service(tmp_path)
    visitor = token_of(access, clock, Right.VIEW)

    async def scenario() -> str:
        waiting = asyncio.create_task(visitor.wait_ended())
        await asyncio.sleep(5)
        clock.now += 1.0
        return await waiting

    assert run(scenario(), max_s=60.0) == "expired"


def test_a_token_ends_with_its_date_its_withdrawal_and_its_user(tmp_path: Path) -> None:
    access, clock = auth_service(tmp_path)
    visitor = token_of(access, clock, Right.VIEW, Right.STOP)
    clock.now += 0.999
    assert visitor.end_reason is None
    clock.now += 0.001
    assert (visitor.end_reason, visitor.actor.rights) == ("expired", frozenset())
    assert access.token_credential("secret", "local") is None
    clock.now -= 1.0
    access.user_file.change(lambda register: register.without_user("operator"))
    assert (visitor.end_reason, visitor.actor.rights) == ("rights", frozenset())
    assert run(visitor.wait_ended(), max_s=60.0) == "rights"


def test_a_token_of_a_disabled_user_may_nothing(tmp_path: Path) -> None:
    access, clock = auth_service(tmp_path)
    visitor = token_of(access, clock, Right.VIEW)
    access.user_file.change(
        lambda register: register.with_changed_user(replace(register.user("operator"), disabled=True))
    )
    assert visitor.actor.rights == frozenset()


def test_a_connection_of_a_token_ends_when_its_user_may_less(tmp_path: Path) -> None:
    access, clock = auth_service(tmp_path)
    visitor = token_of(access, clock, Right.VIEW, Right.STOP)

    async def scenario() -> float:
        waiting = asyncio.create_task(visitor.wait_ended())
        await asyncio.sleep(10)
        assert not waiting.done()
        access.user_file.change(
            lambda register: register.with_changed_user(replace(register.user("operator"), role=Role.VIEWER))
        )
        begun = asyncio.get_running_loop().time()
        assert await waiting == "rights"
        return asyncio.get_running_loop().time() - begun

    assert run(scenario(), max_s=60.0) <= 1.0
