"""S07: sessions on the server, found by a secret that is kept as a hash; idle, old, replaced, ended."""

from __future__ import annotations

import asyncio
import threading
from dataclasses import replace
from pathlib import Path

import pytest

from doorkit import PASSWORD, QUICK, Clock
from drivebus.plant.access.access import KEEP_S, Access
from drivebus.plant.access.passwords import Passwords, check_new
from drivebus.plant.access.refusals import Conflict, Forbidden, NotLoggedIn, TooManyAttempts, Unfit
from drivebus.plant.access.register import Token, User
from drivebus.plant.access.rights import RIGHTS, Right, Role
from drivebus.plant.access.sessions import ABSOLUTE_S, IDLE_S, PER_USER, digest
from drivebus.plant.access.visitor import BySession, ByToken
from drivebus.plant.actor import Actor
from drivebus.testing.virtual import run
from drivebus.web.given import ChangedUser
from drivebus.web.people import _change


def made(directory: Path, *roles: Role) -> tuple[Access, Clock]:
    clock = Clock()
    access = Access(directory, passwords=Passwords(QUICK), clock=clock, wall=clock.wall_ms)
    hashed = QUICK.hash(PASSWORD)
    for role in roles or (Role.ADMINISTRATOR, Role.OPERATOR):
        access.file.change(lambda register, role=role: register.added(User(str(role), role, hashed, 0)))
    return access, clock


def login(access: Access, name: str = "operator", password: str = PASSWORD) -> tuple[str, BySession]:
    opened = run(access.login(name, password, "127.0.0.1"))
    visitor = access.by_cookie(opened.secret)
    assert visitor is not None
    return opened.secret, visitor


def test_s07_a_secret_has_256_bits_of_chance_and_is_kept_as_a_hash(tmp_path: Path) -> None:
    access, _ = made(tmp_path)
    secrets = {login(access)[0] for _ in range(8)}
    assert len(secrets) == 8 and all(len(secret) == 43 for secret in secrets)
    kept = repr(access.sessions.__dict__)
    assert not any(secret in kept for secret in secrets)
    assert all(digest(secret) in kept for secret in secrets)


def test_s07_after_fifteen_idle_minutes_a_session_may_see_and_stop_and_nothing_else(tmp_path: Path) -> None:
    access, clock = made(tmp_path)
    secret, visitor = login(access)
    clock.now += IDLE_S - 1
    assert visitor.actor.rights == RIGHTS[Role.OPERATOR]
    clock.now += 1
    assert visitor.actor.rights == {Right.VIEW, Right.STOP}
    visitor.session.touch(clock.now)
    assert visitor.is_idle, "a touch does not wake it, a password does"
    assert access.by_cookie(secret) is not None
    assert login(access)[1].actor.may(Right.OPERATE)


def test_s07_a_touch_in_time_keeps_a_session_awake(tmp_path: Path) -> None:
    access, clock = made(tmp_path)
    _, visitor = login(access)
    for _ in range(10):
        clock.now += IDLE_S - 1
        visitor.session.touch(clock.now)
    assert visitor.actor.may(Right.OPERATE)


def test_s07_an_idle_viewer_gains_no_stop(tmp_path: Path) -> None:
    access, clock = made(tmp_path, Role.VIEWER)
    _, visitor = login(access, "viewer")
    clock.now += IDLE_S
    assert visitor.actor.rights == {Right.VIEW}


def test_s07_a_session_ends_after_twelve_hours_whatever_is_done(tmp_path: Path) -> None:
    access, clock = made(tmp_path)
    secret, visitor = login(access)
    begun = clock.now
    while clock.now - begun < ABSOLUTE_S:
        assert access.by_cookie(secret) is not None
        clock.now += 600.0
        visitor.session.touch(clock.now)
    assert access.by_cookie(secret) is None
    assert visitor.session.why == "expired"
    assert visitor.actor.rights == frozenset()


def test_s07_ended_for_all_is_ended_at_once(tmp_path: Path) -> None:
    access, _ = made(tmp_path)
    mine = [login(access) for _ in range(3)]
    _, other = login(access, "administrator")
    assert access.sessions.end_all("operator", "logout") == 3
    assert [access.by_cookie(secret) for secret, _ in mine] == [None] * 3
    assert [visitor.actor.rights for _, visitor in mine] == [frozenset()] * 3
    assert other.why_over is None


def test_s14_a_users_oldest_session_makes_room(tmp_path: Path) -> None:
    access, clock = made(tmp_path)
    secrets = []
    for _ in range(PER_USER + 2):
        clock.now += 1
        secrets.append(login(access)[0])
    open_now = [access.by_cookie(secret) is not None for secret in secrets]
    assert open_now == [False, False] + [True] * PER_USER


@pytest.mark.parametrize(
    "change",
    [
        lambda user: replace(user, role=Role.VIEWER),
        lambda user: replace(user, disabled=True),
        lambda user: replace(user, password="another"),
    ],
    ids=["role", "disabled", "password"],
)
def test_s04_a_change_of_the_user_in_the_file_ends_the_session(tmp_path: Path, change) -> None:  # type: ignore[no-untyped-def]
    access, _ = made(tmp_path)
    secret, visitor = login(access)
    access.file.change(lambda register: register.changed(change(register.user("operator"))))
    assert visitor.actor.rights == frozenset()
    assert access.by_cookie(secret) is None
    assert visitor.session.why == "rights"


def test_s04_whoever_waits_for_the_end_is_told_within_a_second(tmp_path: Path) -> None:
    import asyncio

    access, _ = made(tmp_path)
    _, visitor = login(access)

    async def story() -> float:
        loop = asyncio.get_running_loop()
        waiting = asyncio.create_task(visitor.ended())
        await asyncio.sleep(10)
        assert not waiting.done()
        access.file.change(lambda register: register.removed("operator"))
        begun = loop.time()
        assert await waiting == "rights"
        return loop.time() - begun

    assert run(story()) <= 1.0


def test_s07_a_new_password_ends_every_other_session_and_gives_a_new_secret(tmp_path: Path) -> None:
    access, _ = made(tmp_path)
    first, _ = login(access)
    second, visitor = login(access)
    opened = run(access.new_password(visitor.session, PASSWORD, "a quite new pass phrase"))
    assert access.by_cookie(first) is None and access.by_cookie(second) is None
    assert access.by_cookie(opened.secret) is not None
    with pytest.raises(NotLoggedIn):
        login(access)
    login(access, password="a quite new pass phrase")


def meanwhile(access: Access, monkeypatch: pytest.MonkeyPatch, **changed: object) -> None:
    """While the next password is hashed an administrator changes the operator."""
    plain = access.passwords.hash

    async def slow(password: str) -> str:
        access.file.change(lambda register: register.changed(replace(register.user("operator"), **changed)))
        return await plain(password)

    monkeypatch.setattr(access.passwords, "hash", slow)


@pytest.mark.parametrize("changed", [{"role": Role.VIEWER}, {"disabled": True}], ids=["demoted", "disabled"])
def test_s04_a_new_password_of_ones_own_does_not_bring_back_what_was_taken_meanwhile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changed: dict[str, object]
) -> None:
    access, _ = made(tmp_path)
    _, visitor = login(access)
    meanwhile(access, monkeypatch, **changed)
    with pytest.raises(NotLoggedIn):
        run(access.new_password(visitor.session, PASSWORD, "a quite new pass phrase"))
    found = access.register.user("operator")
    assert {name: getattr(found, name) for name in changed} == changed
    assert access.sessions.of("operator") == [visitor.session] and visitor.why_over == "rights"


@pytest.mark.parametrize("changed", [{"role": Role.VIEWER}, {"disabled": True}], ids=["demoted", "disabled"])
def test_s04_a_new_password_by_an_administrator_does_not_either(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changed: dict[str, object]
) -> None:
    """Each of two administrators changes what that one names, and nothing else."""
    access, _ = made(tmp_path)
    secret, _ = login(access)
    meanwhile(access, monkeypatch, **changed)
    me = Actor("administrator", RIGHTS[Role.ADMINISTRATOR], "s-1")
    body = ChangedUser(password="a quite new pass phrase")
    told = run(_change(access, "operator", body, me))
    found = access.register.user("operator")
    assert told == found and {name: getattr(found, name) for name in changed} == changed
    assert run(access.passwords.verify(found.password, "a quite new pass phrase"))
    assert access.by_cookie(secret) is None


def test_s05_a_wrong_old_password_changes_nothing_and_counts(tmp_path: Path) -> None:
    access, _ = made(tmp_path)
    _, visitor = login(access)
    for _ in range(10):
        with pytest.raises(Forbidden):
            run(access.new_password(visitor.session, "wrong password", "a quite new pass phrase"))
    with pytest.raises(TooManyAttempts):
        run(access.new_password(visitor.session, PASSWORD, "a quite new pass phrase"))
    assert visitor.why_over is None


def test_a_user_who_is_unknown_or_disabled_takes_as_long_as_a_wrong_password(tmp_path: Path) -> None:
    """Nobody learns from the answer, or from how long it took, which names exist: each is one hash."""
    access, _ = made(tmp_path)
    access.file.change(lambda register: register.changed(replace(register.user("operator"), disabled=True)))
    checked: list[str] = []
    verify = access.passwords._verify
    access.passwords._verify = lambda known, said: checked.append(known) or verify(known, said)  # type: ignore[method-assign,func-returns-value]
    told = set()
    for name in ("operator", "nobody", "administrator"):
        with pytest.raises(NotLoggedIn) as raised:
            run(access.login(name, "wrong password", "127.0.0.1"))
        told.add((raised.value.key, str(raised.value.params)))
    assert len(checked) == 3 and len(told) == 1
    with pytest.raises(NotLoggedIn):
        run(access.login("operator", PASSWORD, "127.0.0.1"))


def test_s06_the_secret_makes_the_first_administrator_once(tmp_path: Path) -> None:
    clock = Clock()
    access = Access(tmp_path, passwords=Passwords(QUICK), clock=clock, wall=clock.wall_ms)
    assert access.needs_setup
    with pytest.raises(NotLoggedIn):
        run(access.set_up("", "ann", PASSWORD, "127.0.0.1"))
    secret = access.setup.offer()
    assert access.setup.path.read_text().strip() == secret and access.setup.path.stat().st_mode & 0o777 == 0o600
    with pytest.raises(NotLoggedIn):
        run(access.set_up(secret + "x", "ann", PASSWORD, "127.0.0.1"))
    with pytest.raises(Unfit):
        run(access.set_up(secret, "ann", "short", "127.0.0.1"))
    opened = run(access.set_up(secret, "ann", PASSWORD, "127.0.0.1"))
    assert access.by_cookie(opened.secret) is not None
    assert access.register.user("ann").role is Role.ADMINISTRATOR
    assert not access.setup.path.exists()
    with pytest.raises(Conflict):
        run(access.set_up(secret, "eve", PASSWORD, "127.0.0.1"))


def test_s06_of_two_that_set_up_at_once_one_is_administrator(tmp_path: Path) -> None:
    import asyncio

    clock = Clock()
    access = Access(tmp_path, passwords=Passwords(QUICK), clock=clock, wall=clock.wall_ms)
    secret = access.setup.offer()

    async def both() -> list[object]:
        tries = (access.set_up(secret, name, PASSWORD, "127.0.0.1") for name in ("ann", "eve"))
        return await asyncio.gather(*tries, return_exceptions=True)

    found = asyncio.run(both())
    assert sorted(type(one).__name__ for one in found) == ["Conflict", "Opened"]
    assert len(access.register.users) == 1


def test_s06_guessing_the_secret_is_throttled(tmp_path: Path) -> None:
    clock = Clock()
    access = Access(tmp_path, passwords=Passwords(QUICK), clock=clock, wall=clock.wall_ms)
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
    late = run(access.issue_code("operator", 60))
    clock.now += 60
    for spent in (code, late, "guess"):
        with pytest.raises(NotLoggedIn):
            run(access.login_once(spent, "127.0.0.1"))


@pytest.mark.parametrize(
    "password",
    ["", "short pass"[:9], "x" * 201, "aaaaaaaaaaaa", "abababababab", "Password123", "ann smith-01x", "1234567890"],
)
def test_a_password_that_is_easily_guessed_is_refused(password: str) -> None:
    with pytest.raises(Unfit):
        check_new(password, "ann smith")


GUESSED = (
    "password123456", "PASSWORD!!!2026", "p@ssw0rd2024", "adminadmin", "admin-12345", "operator123", "drivebus123",
    "qwertyuiop", "poiuytrewq", "1q2w3e4r5t", "1qaz2wsx3edc", "zxcvbnm123", "abcd123456", "a123456789", "woaini1314",
    "5201314520", "13800138000", "Summer2026!", "welcome pump 1", "iloveyou123",
)  # fmt: skip


@pytest.mark.parametrize("password", GUESSED)
def test_s06_common_words_rows_and_digits_are_no_password(password: str) -> None:
    with pytest.raises(Unfit) as refused:
        check_new(password, "somebody else")
    assert refused.value.key == "access.password_common"


KEPT = (
    PASSWORD,
    "seven pumps sing",
    "7#kQ9!2x&4",
    "3fa94b01c7d2",
    "pumpenhaus nord 7",
    "password of the old quay",
    "锅炉房的门朝北开着呢",
)


@pytest.mark.parametrize("password", KEPT)
def test_what_has_something_of_its_own_is_a_password(password: str) -> None:
    assert check_new(password, "operator") == password


def test_the_hashes_that_are_really_used_are_argon2id_with_64_mib() -> None:
    hashed = run(Passwords().hash(PASSWORD))
    assert hashed.startswith("$argon2id$v=19$m=65536,t=3,p=1$")


def reborn(access: Access, clock: Clock) -> Access:
    """The web process was killed and started again."""
    return Access(access.setup.path.parent, passwords=access.passwords, clock=clock, wall=clock.wall_ms)


def test_a_session_outlives_a_crash_of_the_web_process(tmp_path: Path) -> None:
    """No password stands between a person and a stop because a process was killed."""
    access, clock = made(tmp_path)
    secret, visitor = login(access)
    clock.now += IDLE_S - 1
    run(access.touch(visitor.session))
    again = reborn(access, clock).by_cookie(secret)
    assert again is not None and again.actor == visitor.actor and again.session.csrf == visitor.session.csrf
    clock.now += IDLE_S - 1
    assert again.actor.may(Right.OPERATE), "the touch was kept"
    clock.now += ABSOLUTE_S
    assert reborn(access, clock).by_cookie(secret) is None
    assert access.keeper.path.stat().st_mode & 0o777 == 0o600 and secret not in access.keeper.path.read_text()


def test_a_touch_is_written_down_once_a_minute(tmp_path: Path) -> None:
    access, clock = made(tmp_path)
    _, visitor = login(access)
    begun = clock.now
    for passed_s, kept_s in ((KEEP_S - 1, 0.0), (KEEP_S, KEEP_S), (2 * KEEP_S - 1, KEEP_S), (2 * KEEP_S, 2 * KEEP_S)):
        clock.now = begun + passed_s
        run(access.touch(visitor.session))
        assert access.keeper.read()[0].active == begun + kept_s


def test_a_request_does_not_wait_for_a_disk_that_hangs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """6.5, G14: it may be a stop."""
    access, clock = made(tmp_path)
    _, visitor = login(access)
    clock.now += KEEP_S
    hangs = threading.Event()
    monkeypatch.setattr(access.keeper, "write", lambda kept: hangs.wait(20.0))

    async def story() -> None:
        await asyncio.wait_for(access.touch(visitor.session), 5.0)
        assert not hangs.is_set()
        hangs.set()

    asyncio.run(story())


def test_s04_what_was_ended_stays_ended_after_a_crash(tmp_path: Path) -> None:
    access, clock = made(tmp_path)
    one, other = login(access), login(access, "administrator")
    run(access.log_out(one[1].session))
    assert reborn(access, clock).by_cookie(one[0]) is None
    assert reborn(access, clock).by_cookie(other[0]) is not None
    access.file.change(lambda register: register.changed(replace(register.user("administrator"), password="new")))
    assert reborn(access, clock).by_cookie(other[0]) is None
    login(access), run(access.end_all("OPERATOR", "logout"))
    assert access.keeper.read() == reborn(access, clock).sessions.kept()


def test_s07_no_session_outlives_the_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The monotonic clock begins anew with the machine: ages would be wrong."""
    access, clock = made(tmp_path)
    secret, _ = login(access)
    monkeypatch.setattr("drivebus.plant.access.kept._BOOT", tmp_path / "another")
    assert reborn(access, clock).by_cookie(secret) is None
    (tmp_path / "another").write_text("another boot")
    assert reborn(access, clock).by_cookie(secret) is None


@pytest.mark.parametrize("content", ["", "{", "[]", '{"boot": "x", "sessions": [{}]}'])
def test_a_file_of_sessions_that_can_not_be_read_costs_a_login(tmp_path: Path, content: str) -> None:
    access, clock = made(tmp_path)
    secret, _ = login(access)
    access.keeper.path.write_text(content)
    fresh = reborn(access, clock)
    assert fresh.by_cookie(secret) is None
    login(fresh)


def test_g14_a_full_disk_keeps_nobody_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    access, _ = made(tmp_path)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("drivebus.plant.access.kept.replace_private", full)
    secret, visitor = login(access)
    assert access.by_cookie(secret) is not None
    run(access.log_out(visitor.session))
    assert access.by_cookie(secret) is None


def token_of(access: Access, clock: Clock, *rights: Right) -> ByToken:
    token = Token("t1", "scada", "operator", rights, digest("secret"), 0, clock.wall_ms() + 1000)
    access.file.change(lambda register: register.with_token(token))
    visitor = access.by_token("secret", "10.0.0.9")
    assert visitor is not None
    return visitor


def test_a_token_acts_in_its_users_name_from_afar_with_its_scope(tmp_path: Path) -> None:
    access, clock = made(tmp_path)
    actor = token_of(access, clock, Right.VIEW, Right.STOP).actor
    assert actor == Actor("operator/scada", frozenset({Right.VIEW, Right.STOP}), "token-t1", True, "10.0.0.9")
    _, visitor = login(access)
    assert visitor.actor.remote, "two steps to a start (6.5)"


def test_a_token_ends_with_its_date_its_withdrawal_and_its_user(tmp_path: Path) -> None:
    access, clock = made(tmp_path)
    visitor = token_of(access, clock, Right.VIEW, Right.STOP)
    clock.now += 0.999
    assert visitor.why_over is None
    clock.now += 0.001
    assert (visitor.why_over, visitor.actor.rights) == ("expired", frozenset())
    assert access.by_token("secret", "local") is None
    clock.now -= 1.0
    access.file.change(lambda register: register.removed("operator"))
    assert (visitor.why_over, visitor.actor.rights) == ("rights", frozenset())
    assert run(visitor.ended()) == "rights"


def test_a_token_of_a_disabled_user_may_nothing(tmp_path: Path) -> None:
    access, clock = made(tmp_path)
    visitor = token_of(access, clock, Right.VIEW)
    access.file.change(lambda register: register.changed(replace(register.user("operator"), disabled=True)))
    assert visitor.actor.rights == frozenset()


def test_s04_a_connection_of_a_token_ends_when_its_user_may_less(tmp_path: Path) -> None:
    import asyncio

    access, clock = made(tmp_path)
    visitor = token_of(access, clock, Right.VIEW, Right.STOP)

    async def story() -> float:
        waiting = asyncio.create_task(visitor.ended())
        await asyncio.sleep(10)
        assert not waiting.done()
        access.file.change(lambda register: register.changed(replace(register.user("operator"), role=Role.VIEWER)))
        begun = asyncio.get_running_loop().time()
        assert await waiting == "rights"
        return asyncio.get_running_loop().time() - begun

    assert run(story()) <= 1.0
