"""Sessions and tokens: secrets stored as hashes; idle, expired, replaced and ended credentials."""

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
    REPLACED_SECRET_LIFETIME_S,
    SESSION_IDLE_TIMEOUT_S,
    SESSION_LIFETIME_S,
    secret_digest,
)
from drivebus.service.auth.users import Token, UserDatabase
from drivebus.testing.virtual_time import run
from drivebus.web.operations.users import UserChangeParams
from drivebus.web.routes.users import _change_user
from fixtures.auth import auth_service, login, restarted
from fixtures.web_app import FAST_HASHER, PASSWORD, SteppedClock


def test_a_session_secret_has_256_random_bits_and_is_stored_as_a_hash(tmp_path: Path) -> None:
    auth, _ = auth_service(tmp_path)
    secrets = {login(auth)[0] for _ in range(8)}
    assert len(secrets) == 8 and all(len(secret) == 43 for secret in secrets)
    stored = repr(auth.sessions.__dict__)
    assert not any(secret in stored for secret in secrets)
    assert all(secret_digest(secret) in stored for secret in secrets)


def test_session_times_are_the_documented_ones() -> None:
    assert (SESSION_IDLE_TIMEOUT_S, SESSION_LIFETIME_S) == (15 * 60, 12 * 3600)
    assert (MAX_SESSIONS_PER_USER, SESSION_SAVE_INTERVAL_S) == (20, 60)


def test_session_id_and_csrf_token_are_random(tmp_path: Path) -> None:
    """At least 128 random bits; an unlocked session gets a new secret."""
    auth, clock = auth_service(tmp_path)
    _, credential = login(auth)
    assert len(credential.session.csrf) == 32 and len(auth.sessions.unlock(credential.session, clock.now)) == 43
    assert re.fullmatch("s-[0-9a-f]{16}", credential.session.id)


@pytest.mark.parametrize("secret", ["", "x", "\ud800", "passwörd"])
def test_an_unknown_cookie_has_no_credential(secret: str, tmp_path: Path) -> None:
    auth, _ = auth_service(tmp_path)
    login(auth)
    assert auth.session_credential(secret) is None and auth.token_credential(secret, "local") is None


def test_after_fifteen_idle_minutes_a_session_may_only_view_and_stop(tmp_path: Path) -> None:
    auth, clock = auth_service(tmp_path)
    secret, credential = login(auth)
    clock.now += SESSION_IDLE_TIMEOUT_S - 1
    assert credential.actor.rights == ROLE_RIGHTS[Role.OPERATOR]
    clock.now += 1
    assert credential.actor.rights == {Right.VIEW, Right.STOP}
    credential.session.record_activity(clock.now)
    assert credential.is_idle, "activity does not unlock it, a password does"
    assert auth.session_credential(secret) is not None
    assert login(auth)[1].actor.may(Right.OPERATE)


def test_activity_in_time_keeps_a_session_active(tmp_path: Path) -> None:
    auth, clock = auth_service(tmp_path)
    _, credential = login(auth)
    for _ in range(10):
        clock.now += SESSION_IDLE_TIMEOUT_S - 1
        credential.session.record_activity(clock.now)
    assert credential.actor.may(Right.OPERATE)


def test_a_password_unlocks_an_idle_session_and_voids_its_old_secret(tmp_path: Path) -> None:
    """For some seconds the old one can still stop, as before: a stop with it may be under way."""
    auth, clock = auth_service(tmp_path)
    old, credential = login(auth)
    other, _ = login(auth)
    clock.now += SESSION_IDLE_TIMEOUT_S
    with pytest.raises(AccessDenied):
        run(auth.unlock(credential.session, "wrong password"))
    assert credential.is_idle
    unlocked = run(auth.unlock(credential.session, PASSWORD))
    assert unlocked.session is credential.session and not credential.is_idle
    clock.now += REPLACED_SECRET_LIFETIME_S - 0.1
    late = auth.session_credential(old)
    assert late is not None and late.is_idle and late.actor.rights == {Right.VIEW, Right.STOP}
    assert restarted(auth, clock).session_credential(old) is None
    clock.now += 0.1
    assert late.end_reason == "replaced" and not late.actor.rights, "an open connection ends too"
    assert credential.end_reason is None
    for service in (auth, restarted(auth, clock)):
        assert [service.session_credential(secret) is not None for secret in (old, unlocked.secret, other)] == [
            False,
            True,
            True,
        ]


def test_an_idle_viewer_gains_no_stop(tmp_path: Path) -> None:
    auth, clock = auth_service(tmp_path, Role.VIEWER)
    _, credential = login(auth, "viewer")
    clock.now += SESSION_IDLE_TIMEOUT_S
    assert credential.actor.rights == {Right.VIEW}


def test_a_session_ends_after_twelve_hours_of_activity(tmp_path: Path) -> None:
    auth, clock = auth_service(tmp_path)
    secret, credential = login(auth)
    started = clock.now
    while clock.now - started < SESSION_LIFETIME_S:
        assert auth.session_credential(secret) is not None
        clock.now += 600.0
        credential.session.record_activity(clock.now)
    assert auth.session_credential(secret) is None
    assert credential.session.end_reason == "expired"
    assert credential.actor.rights == frozenset()
    assert secret_digest(secret) not in repr(auth.sessions.__dict__), "its secret is removed"


def test_an_open_connection_loses_all_rights_after_twelve_hours(tmp_path: Path) -> None:
    """The cookie of an open connection is not checked again."""
    auth, clock = auth_service(tmp_path)
    _, credential = login(auth)
    clock.now += SESSION_LIFETIME_S - 1
    assert credential.actor.rights == {Right.VIEW, Right.STOP} and credential.end_reason is None
    clock.now += 1
    assert credential.actor.rights == frozenset() and credential.end_reason == "expired"


def test_the_first_reason_of_an_end_stays_and_wakes_waiting_tasks_at_once(tmp_path: Path) -> None:
    auth, _ = auth_service(tmp_path)
    _, credential = login(auth)

    async def scenario() -> str:
        waiting = asyncio.create_task(credential.wait_ended())
        await asyncio.sleep(0.1)
        await auth.logout(credential.session)
        credential.session.end("rights")
        started = asyncio.get_running_loop().time()
        why = await waiting
        assert asyncio.get_running_loop().time() == started
        return why

    assert run(scenario(), max_s=60.0) == credential.session.end_reason == "logout"


def test_all_sessions_of_a_user_end_at_once(tmp_path: Path) -> None:
    auth, _ = auth_service(tmp_path)
    sessions = [login(auth) for _ in range(3)]
    _, other = login(auth, "administrator")
    assert run(auth.end_sessions("OPERATOR", "logout")) == 3
    assert {credential.session.end_reason for _, credential in sessions} == {"logout"}
    stored = repr(auth.sessions.__dict__)
    assert [secret_digest(secret) in stored for secret, _ in sessions] == [False] * 3 and auth.sessions.of_user(
        "operator"
    ) == []
    assert [auth.session_credential(secret) for secret, _ in sessions] == [None] * 3
    assert [credential.actor.rights for _, credential in sessions] == [frozenset()] * 3
    assert other.end_reason is None


def test_a_further_session_replaces_the_oldest_of_its_user(tmp_path: Path) -> None:
    auth, clock = auth_service(tmp_path)
    found = []
    for _ in range(MAX_SESSIONS_PER_USER + 2):
        clock.now += 1
        found.append(login(auth))
    stored = repr(auth.sessions.__dict__)
    assert [secret_digest(secret) in stored for secret, _ in found] == [False, False] + [True] * MAX_SESSIONS_PER_USER
    assert [credential.session.end_reason for _, credential in found] == ["replaced"] * 2 + [
        None
    ] * MAX_SESSIONS_PER_USER


def test_an_expired_session_does_not_count_for_the_limit(tmp_path: Path) -> None:
    """It was active to its end, and the others were idle for hours."""
    auth, clock = auth_service(tmp_path)
    _, oldest = login(auth)
    started = clock.now
    for _ in range(MAX_SESSIONS_PER_USER - 1):
        clock.now += 1
        login(auth)
    while clock.now < started + SESSION_LIFETIME_S:
        oldest.session.record_activity(clock.now)
        clock.now += 600
    clock.now = started + SESSION_LIFETIME_S
    others = auth.sessions.of_user("operator")[1:]
    login(auth)
    assert oldest.session.end_reason == "expired" and [session.end_reason for session in others] == [None] * (
        MAX_SESSIONS_PER_USER - 1
    )


@pytest.mark.parametrize(
    ("reason", "change"),
    [
        ("role", lambda user: replace(user, role=Role.VIEWER)),
        ("disabled", lambda user: replace(user, disabled=True)),
        ("password", lambda user: replace(user, password="another")),
    ],
    ids=["role", "disabled", "password"],
)
def test_a_change_of_the_user_in_the_file_ends_the_session(tmp_path: Path, reason: str, change) -> None:  # type: ignore[no-untyped-def]
    auth, _ = auth_service(tmp_path)
    secret, credential = login(auth)
    auth.user_file.change(lambda database: database.with_changed_user(change(database.user("operator"))))
    assert credential.actor.rights == frozenset()
    assert auth.session_credential(secret) is None
    assert credential.session.end_reason == auth.sessions.end_reason(secret) == reason


def test_the_reasons_of_ended_sessions_are_kept_for_the_newest_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivebus.service.auth.sessions.MAX_ENDED_SESSIONS", 2)
    auth, _ = auth_service(tmp_path)
    secrets = []
    for _ in range(3):
        secret, credential = login(auth)
        assert auth.sessions.end_reason(secret) is None
        credential.session.end("logout")
        secrets.append(secret)
        auth.sessions.end_reason(secret)
    assert [auth.sessions.end_reason(secret) for secret in [*secrets, "another"]] == [None, "logout", "logout", None]


def test_a_waiting_task_is_notified_of_the_end_within_a_second(tmp_path: Path) -> None:
    auth, _ = auth_service(tmp_path)
    _, credential = login(auth)

    async def scenario() -> float:
        loop = asyncio.get_running_loop()
        waiting = asyncio.create_task(credential.wait_ended())
        await asyncio.sleep(10)
        assert not waiting.done()
        auth.user_file.change(lambda database: database.without_user("operator"))
        started = loop.time()
        assert await waiting == "removed"
        return loop.time() - started

    assert run(scenario(), max_s=60.0) <= 1.0


def test_a_new_password_ends_every_other_session_and_gives_a_new_secret(tmp_path: Path) -> None:
    auth, _ = auth_service(tmp_path)
    first, _ = login(auth)
    second, credential = login(auth)
    opened = run(auth.change_password(credential.session, PASSWORD, "a quite new pass phrase"))
    assert auth.sessions.of_user("operator") == [opened.session], "at once, before the next request"
    assert credential.session.end_reason == "password"
    assert auth.session_credential(first) is None and auth.session_credential(second) is None
    assert auth.session_credential(opened.secret) is not None
    with pytest.raises(NotAuthenticated):
        login(auth)
    login(auth, password="a quite new pass phrase")


def change_during_hashing(auth: AuthService, monkeypatch: pytest.MonkeyPatch, **changed: object) -> None:
    """Let an administrator change the operator while the next password is hashed."""
    plain = auth.passwords.hash

    async def slow(password: str) -> str:
        auth.user_file.change(
            lambda database: database.with_changed_user(replace(database.user("operator"), **changed))
        )
        return await plain(password)

    monkeypatch.setattr(auth.passwords, "hash", slow)


@pytest.mark.parametrize(
    ("changed", "reason"),
    [({"role": Role.VIEWER}, "role"), ({"disabled": True}, "disabled")],
    ids=["demoted", "disabled"],
)
def test_a_password_change_restores_no_right_that_was_withdrawn_meanwhile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changed: dict[str, object], reason: str
) -> None:
    auth, _ = auth_service(tmp_path)
    _, credential = login(auth)
    change_during_hashing(auth, monkeypatch, **changed)
    with pytest.raises(NotAuthenticated) as rejected:
        run(auth.change_password(credential.session, PASSWORD, "a quite new pass phrase"))
    assert rejected.value.key == "auth.wrong_password"
    found = auth.database.user("operator")
    assert {name: getattr(found, name) for name in changed} == changed
    assert auth.sessions.of_user("operator") == [credential.session] and credential.end_reason == reason


@pytest.mark.parametrize(
    "change",
    [
        lambda database: database.without_user("operator"),
        lambda database: database.with_changed_user(replace(database.user("operator"), role=Role.VIEWER)),
        lambda database: database.with_changed_user(replace(database.user("operator"), disabled=True)),
    ],
    ids=["removed", "demoted", "disabled"],
)
def test_a_user_changed_during_the_password_check_is_not_logged_in(
    change: Callable[[UserDatabase], UserDatabase], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    auth, _ = auth_service(tmp_path)
    plain = auth.passwords.verify

    async def slow(encoded: str | None, password: str, **more: bool) -> bool:
        auth.user_file.change(change)
        return await plain(encoded, password)

    monkeypatch.setattr(auth.passwords, "verify", slow)
    with pytest.raises(NotAuthenticated) as rejected:
        run(auth.login("operator", PASSWORD, "local"))
    assert rejected.value.key == "auth.wrong_password" and auth.sessions.of_user("operator") == []


@pytest.mark.parametrize("changed", [{"role": Role.VIEWER}, {"disabled": True}], ids=["demoted", "disabled"])
def test_a_new_password_by_an_administrator_restores_no_withdrawn_right(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changed: dict[str, object]
) -> None:
    """Of two concurrent changes each applies to its own fields only."""
    auth, _ = auth_service(tmp_path)
    secret, _ = login(auth)
    change_during_hashing(auth, monkeypatch, **changed)
    params = UserChangeParams(user="operator", password="a quite new pass phrase")
    changed_user = run(_change_user(auth, params, "administrator"))
    found = auth.database.user("operator")
    assert changed_user == found and {name: getattr(found, name) for name in changed} == changed
    assert run(auth.passwords.verify(found.password, "a quite new pass phrase"))
    assert auth.session_credential(secret) is None


def test_a_wrong_old_password_changes_nothing_and_counts(tmp_path: Path) -> None:
    auth, _ = auth_service(tmp_path)
    _, credential = login(auth)
    for _ in range(10):
        with pytest.raises(AccessDenied):
            run(auth.change_password(credential.session, "wrong password", "a quite new pass phrase"))
    with pytest.raises(TooManyAttempts):
        run(auth.change_password(credential.session, PASSWORD, "a quite new pass phrase"))
    assert credential.end_reason is None


def test_a_login_of_an_unknown_or_disabled_user_takes_as_long_as_a_wrong_password(tmp_path: Path) -> None:
    """The reply and its time do not disclose which names exist: each login verifies one hash."""
    auth, _ = auth_service(tmp_path)
    auth.user_file.change(
        lambda database: database.with_changed_user(replace(database.user("operator"), disabled=True))
    )
    checked: list[str] = []
    verify = auth.passwords._verify
    auth.passwords._verify = lambda known, text: checked.append(known) or verify(known, text)  # type: ignore[method-assign,func-returns-value]
    errors = set()
    for name in ("operator", "unknown", "administrator"):
        with pytest.raises(NotAuthenticated) as raised:
            run(auth.login(name, "wrong password", "127.0.0.1"))
        errors.add((raised.value.key, str(raised.value.params)))
    assert len(checked) == 3 and errors == {("auth.wrong_password", "{}")}
    with pytest.raises(NotAuthenticated):
        run(auth.login("operator", PASSWORD, "127.0.0.1"))


def test_a_session_survives_a_crash_of_the_web_process(tmp_path: Path) -> None:
    """A killed process must not demand a password before a stop."""
    auth, clock = auth_service(tmp_path)
    secret, credential = login(auth)
    clock.now += SESSION_IDLE_TIMEOUT_S - 1
    run(auth.record_activity(credential.session))
    again = restarted(auth, clock).session_credential(secret)
    assert again is not None and again.actor == credential.actor and again.session.csrf == credential.session.csrf
    clock.now += SESSION_IDLE_TIMEOUT_S - 1
    assert again.actor.may(Right.OPERATE), "the activity was saved"
    clock.now += SESSION_LIFETIME_S
    assert restarted(auth, clock).session_credential(secret) is None
    assert auth.session_store.path == tmp_path / "sessions.json"
    assert auth.session_store.path.stat().st_mode & 0o777 == 0o600 and secret not in auth.session_store.path.read_text()


def test_activity_is_saved_once_a_minute(tmp_path: Path) -> None:
    auth, clock = auth_service(tmp_path)
    _, credential = login(auth)
    started = clock.now
    for passed_s, saved_s in (
        (SESSION_SAVE_INTERVAL_S - 1, 0.0),
        (SESSION_SAVE_INTERVAL_S, SESSION_SAVE_INTERVAL_S),
        (2 * SESSION_SAVE_INTERVAL_S - 1, SESSION_SAVE_INTERVAL_S),
        (2 * SESSION_SAVE_INTERVAL_S, 2 * SESSION_SAVE_INTERVAL_S),
    ):
        clock.now = started + passed_s
        run(auth.record_activity(credential.session))
        assert auth.session_store.read()[0].active == started + saved_s


def test_activity_of_a_restored_session_is_saved(tmp_path: Path) -> None:
    auth, clock = auth_service(tmp_path)
    secret, _ = login(auth)
    fresh = restarted(auth, clock)
    credential = fresh.session_credential(secret)
    assert credential is not None
    for passed_s, saved_s in ((SESSION_SAVE_INTERVAL_S - 1, 0.0), (1, SESSION_SAVE_INTERVAL_S)):
        clock.now += passed_s
        run(fresh.record_activity(credential.session))
        assert fresh.session_store.read()[0].active == 1000.0 + saved_s


def test_a_request_does_not_wait_for_a_disk_that_hangs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It may be a stop."""
    auth, clock = auth_service(tmp_path)
    _, credential = login(auth)
    clock.now += SESSION_SAVE_INTERVAL_S
    hangs = threading.Event()
    monkeypatch.setattr(auth.session_store, "write", lambda sessions: hangs.wait(20.0))

    async def scenario() -> None:
        await asyncio.wait_for(auth.record_activity(credential.session), 5.0)
        assert not hangs.is_set()
        hangs.set()

    asyncio.run(scenario())


def test_an_ended_session_stays_ended_after_a_crash(tmp_path: Path) -> None:
    auth, clock = auth_service(tmp_path)
    ended, other = login(auth), login(auth, "administrator")
    run(auth.logout(ended[1].session))
    assert restarted(auth, clock).session_credential(ended[0]) is None
    assert restarted(auth, clock).session_credential(other[0]) is not None
    auth.user_file.change(
        lambda database: database.with_changed_user(replace(database.user("administrator"), password="new"))
    )
    assert restarted(auth, clock).session_credential(other[0]) is None
    again, _ = login(auth)
    run(auth.end_sessions("OPERATOR", "logout"))
    assert restarted(auth, clock).session_credential(again) is None


def test_no_session_survives_a_reboot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The monotonic clock restarts at boot, so that ages would be wrong."""
    auth, clock = auth_service(tmp_path)
    secret, _ = login(auth)
    monkeypatch.setattr("drivebus.service.auth.sessions._BOOT_ID_FILE", tmp_path / "another")
    assert restarted(auth, clock).session_credential(secret) is None
    (tmp_path / "another").write_text("another boot")
    assert restarted(auth, clock).session_credential(secret) is None
    (tmp_path / "another").unlink()
    secret, _ = login(auth)
    assert restarted(auth, clock).session_credential(secret) is None, "the boot is unknown"


@pytest.mark.parametrize("content", [b"{ oops", b"[]", b'{"boot": "b", "sessions": [{"id": 5}]}', b"\xff\xfe", None])
def test_saved_sessions_that_cannot_be_read_are_logged(
    content: bytes | None, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Every user had to log in again, without a reason in the log. A missing file and an emptied one are no fault."""
    auth, clock = auth_service(tmp_path)
    secret, _ = login(auth)
    path = auth.session_store.path
    path.write_bytes(b"")
    restarted(auth, clock)
    path.unlink()
    restarted(auth, clock)
    assert not caplog.records
    if content is None:
        path.mkdir()
    else:
        path.write_bytes(content)
    assert restarted(auth, clock).session_credential(secret) is None
    (record,) = caplog.records
    assert str(path) in record.message and "log in again" in record.message and record.levelname == "ERROR"


@pytest.mark.parametrize("time", ["NaN", "1e999", '"noon"'])
def test_a_saved_session_without_a_time_requires_a_new_login(tmp_path: Path, time: str) -> None:
    """Compared with no number it never became idle, and never ended."""
    auth, clock = auth_service(tmp_path)
    secret, _ = login(auth)
    text, replaced = re.subn(r'"(opened|active)":[^,}]+', rf'"\1":{time}', auth.session_store.path.read_text())
    assert replaced == 2
    auth.session_store.path.write_text(text)
    assert restarted(auth, clock).session_credential(secret) is None


@pytest.mark.parametrize("content", ["", "{", "[]", '{"boot": "x", "sessions": [{}]}'])
def test_an_unreadable_session_file_requires_a_new_login(tmp_path: Path, content: str) -> None:
    auth, clock = auth_service(tmp_path)
    secret, _ = login(auth)
    auth.session_store.path.write_text(content)
    fresh = restarted(auth, clock)
    assert fresh.session_credential(secret) is None
    login(fresh)


def test_a_session_that_ended_on_a_full_disk_stays_ended_after_a_crash(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The saved file still has it. A login or a session's activity alone does not empty that file."""
    auth, clock = auth_service(tmp_path)
    ended, other = login(auth), login(auth, "administrator")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("drivebus.service.auth.sessions.atomic_write_private", full)
    login(auth)
    assert restarted(auth, clock).session_credential(other[0]) is not None
    run(auth.logout(ended[1].session))
    assert restarted(auth, clock).session_credential(ended[0]) is None
    assert auth.session_store.exists, "the sign of a plant that had users"


def test_a_full_disk_prevents_no_login(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    auth, _ = auth_service(tmp_path)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("drivebus.service.auth.sessions.atomic_write_private", full)
    secret, credential = login(auth)
    assert auth.session_credential(secret) is not None
    run(auth.logout(credential.session))
    assert auth.session_credential(secret) is None


def test_a_hanging_disk_has_one_pending_write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Further requests do not add writes."""
    auth, clock = auth_service(tmp_path)
    _, credential = login(auth)

    async def scenario() -> int:
        hung = asyncio.Event()
        monkeypatch.setattr(auth, "save_sessions", hung.wait)
        for _ in range(3):
            clock.now += SESSION_SAVE_INTERVAL_S
            await auth.record_activity(credential.session)
        return len(asyncio.all_tasks())

    assert run(scenario()) == 2, "the test and the write"


def test_the_user_file_is_at_its_configured_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivebus.service.auth.service.PasswordHashing", lambda: "default")
    assert AuthService(tmp_path).passwords == "default"  # type: ignore[comparison-overlap]
    assert AuthService(tmp_path, passwords=PasswordHashing(FAST_HASHER)).user_file.path == tmp_path / "users.json"
    elsewhere = tmp_path / "users.json"
    assert AuthService(tmp_path, elsewhere, passwords=PasswordHashing(FAST_HASHER)).user_file.path == elsewhere


def token_of(auth: AuthService, clock: SteppedClock, *rights: Right) -> TokenCredential:
    token = Token(
        id="t1",
        name="scada",
        user="operator",
        rights=rights,
        digest=secret_digest("secret"),
        created_ms=0,
        expires_ms=clock.wall_ms() + 1000,
    )
    auth.user_file.change(lambda database: database.with_token(token))
    credential = auth.token_credential("secret", "10.0.0.9")
    assert credential is not None
    return credential


def test_a_token_is_a_remote_actor_with_its_own_rights(tmp_path: Path) -> None:
    auth, clock = auth_service(tmp_path)
    actor = token_of(auth, clock, Right.VIEW, Right.STOP).actor
    assert actor == Actor("operator/scada", frozenset({Right.VIEW, Right.STOP}), "token-t1", True, "10.0.0.9")
    _, credential = login(auth)
    assert credential.actor.remote, "two steps to a start"
    assert credential.actor == Actor("operator", ROLE_RIGHTS[Role.OPERATOR], credential.session.id, True, "127.0.0.1")


def test_a_forged_token_has_no_credential(tmp_path: Path) -> None:
    auth, clock = auth_service(tmp_path)
    credential = token_of(auth, clock, Right.VIEW)
    assert auth.token_credential("guess", "10.0.0.9") is None and auth.token_credential("", "10.0.0.9") is None
    assert not credential.is_idle


def test_a_connection_of_a_token_ends_at_its_expiry(tmp_path: Path) -> None:
    auth, clock = auth_service(tmp_path)
    credential = token_of(auth, clock, Right.VIEW)

    async def scenario() -> str:
        waiting = asyncio.create_task(credential.wait_ended())
        await asyncio.sleep(5)
        clock.now += 1.0
        return await waiting

    assert run(scenario(), max_s=60.0) == "expired"


def test_a_token_ends_at_its_expiry_and_with_its_user(tmp_path: Path) -> None:
    auth, clock = auth_service(tmp_path)
    credential = token_of(auth, clock, Right.VIEW, Right.STOP)
    clock.now += 0.999
    assert credential.end_reason is None
    clock.now += 0.001
    assert (credential.end_reason, credential.actor.rights) == ("expired", frozenset())
    assert auth.token_credential("secret", "local") is None
    clock.now -= 1.0
    auth.user_file.change(lambda database: database.without_user("operator"))
    assert (credential.end_reason, credential.actor.rights) == ("rights", frozenset())
    assert run(credential.wait_ended(), max_s=60.0) == "rights"


def test_a_token_of_a_disabled_user_has_no_rights(tmp_path: Path) -> None:
    auth, clock = auth_service(tmp_path)
    credential = token_of(auth, clock, Right.VIEW)
    auth.user_file.change(
        lambda database: database.with_changed_user(replace(database.user("operator"), disabled=True))
    )
    assert credential.actor.rights == frozenset()


def test_a_connection_of_a_token_ends_when_its_user_loses_rights(tmp_path: Path) -> None:
    auth, clock = auth_service(tmp_path)
    credential = token_of(auth, clock, Right.VIEW, Right.STOP)

    async def scenario() -> float:
        waiting = asyncio.create_task(credential.wait_ended())
        await asyncio.sleep(10)
        assert not waiting.done()
        auth.user_file.change(
            lambda database: database.with_changed_user(replace(database.user("operator"), role=Role.VIEWER))
        )
        started = asyncio.get_running_loop().time()
        assert await waiting == "rights"
        return asyncio.get_running_loop().time() - started

    assert run(scenario(), max_s=60.0) <= 1.0
