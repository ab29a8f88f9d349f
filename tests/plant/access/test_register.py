"""Users, tokens and codes as values, and the file that keeps them."""

from __future__ import annotations

import json
import stat
import threading
from dataclasses import replace
from pathlib import Path

import pytest

from drivebus.errors import ConfigurationError
from drivebus.plant.access.refusals import Conflict, NoSuch, Unfit
from drivebus.plant.access.register import Once, Register, Token, User
from drivebus.plant.access.rights import Right, Role
from drivebus.plant.access.store import AccessFile

ADMIN = User("ann", Role.ADMINISTRATOR, "$hash", 1)
TOKEN = Token("t1", "scada", "ann", (Right.VIEW,), "d" * 64, 1, 2)


def test_the_last_administrator_can_neither_go_nor_lose_the_role_nor_be_disabled() -> None:
    register = Register().added(ADMIN)
    for change in (
        lambda: register.removed("ann"),
        lambda: register.changed(replace(ADMIN, role=Role.ENGINEER)),
        lambda: register.changed(replace(ADMIN, disabled=True)),
        lambda: register.changed(replace(ADMIN, password=None)),
    ):
        with pytest.raises(Conflict):
            change()
    two = register.added(replace(ADMIN, name="bob"))
    assert two.removed("ann").has_administrator


def test_names_that_look_alike_are_one_user() -> None:
    register = Register().added(ADMIN)
    assert register.find("ANN") == register.find("ａｎｎ") == ADMIN
    with pytest.raises(Conflict):
        register.added(replace(ADMIN, role=Role.VIEWER))


@pytest.mark.parametrize("name", ["", "a b", "a\nb", "a\x1b[31m", "_a", ".a", "x" * 65, "Ann", "a\u202eb", "a/b", '"'])
def test_s13_a_name_that_would_write_more_than_a_name_is_refused(name: str) -> None:
    with pytest.raises(Unfit):
        Register().added(User(name, Role.VIEWER, None, 1))


@pytest.mark.parametrize("name", ["ann", "王伟", "li.wei-2@plant", "7"])
def test_a_name_in_any_script_is_taken(name: str) -> None:
    user = User(name, Role.VIEWER, None, 1)
    assert Register().added(user).find(name) == user


def test_a_token_can_not_do_more_than_its_user() -> None:
    register = Register().added(ADMIN).added(User("vera", Role.VIEWER, "$", 1))
    with pytest.raises(Unfit):
        register.with_token(replace(TOKEN, user="vera", rights=(Right.VIEW, Right.STOP)))
    with pytest.raises(Unfit):
        register.with_token(replace(TOKEN, rights=()))
    with pytest.raises(NoSuch):
        register.with_token(replace(TOKEN, user="nobody"))


def test_with_a_user_go_the_users_tokens_and_codes() -> None:
    register = Register().added(ADMIN).added(User("vera", Role.VIEWER, "$", 1))
    register = register.with_token(replace(TOKEN, user="vera")).with_code(Once("c", "vera", 9), 0)
    after = register.with_token(TOKEN).removed("vera")
    assert (after.users, after.tokens, after.codes) == ((ADMIN,), (TOKEN,), ())
    with pytest.raises(NoSuch):
        after.without_token("t2")
    assert after.without_token("t1").tokens == ()


def test_codes_that_are_too_old_go_with_the_next_one() -> None:
    register = Register().added(ADMIN).with_code(Once("old", "ann", 5), 0).with_code(Once("new", "ann", 50), 5)
    assert [code.digest for code in register.codes] == ["new"]


def test_the_file_is_readable_by_its_owner_only_and_says_what_was_put(tmp_path: Path) -> None:
    path = tmp_path / "state" / "access.json"
    AccessFile(path).change(lambda register: register.added(ADMIN).with_token(TOKEN))
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.with_suffix(".lock").stat().st_mode) == 0o600
    assert AccessFile(path).read() == Register((ADMIN,), (TOKEN,))
    assert json.loads(path.read_text())["users"][0]["role"] == "administrator"


def test_a_change_that_fails_changes_nothing(tmp_path: Path) -> None:
    file = AccessFile(tmp_path / "access.json")
    file.change(lambda register: register.added(ADMIN))
    before = file.path.read_bytes()
    with pytest.raises(Conflict):
        file.change(lambda register: register.removed("ann"))
    assert file.path.read_bytes() == before


def test_what_another_program_changed_is_seen_at_the_next_look(tmp_path: Path) -> None:
    one, other = AccessFile(tmp_path / "access.json"), AccessFile(tmp_path / "access.json")
    one.change(lambda register: register.added(ADMIN))
    assert other.read().users == (ADMIN,)
    assert other.read() is other.read(), "read once while it does not change"
    one.change(lambda register: register.with_token(TOKEN))
    assert other.read().tokens == (TOKEN,)


@pytest.mark.parametrize("content", ["", "{", "[]", '{"users": [{"name": 1}]}', '{"users": [{"name": "a"}]}'])
def test_a_file_that_is_none_of_ours_is_refused_and_never_overwritten(tmp_path: Path, content: str) -> None:
    path = tmp_path / "access.json"
    path.write_text(content)
    with pytest.raises(ConfigurationError) as raised:
        AccessFile(path).read()
    assert raised.value.params["file"] == str(path)
    with pytest.raises(ConfigurationError):
        AccessFile(path).change(lambda register: register.added(ADMIN))
    assert path.read_text() == content


def test_a_slip_of_an_editor_takes_nobodys_stop_away_and_is_not_written_over(tmp_path: Path) -> None:
    file = AccessFile(tmp_path / "access.json")
    file.change(lambda register: register.added(ADMIN))
    file.read()
    file.path.write_text("{ oops")
    assert file.read().users == (ADMIN,)
    with pytest.raises(ConfigurationError):
        file.change(lambda register: register.with_token(TOKEN))
    assert file.path.read_text() == "{ oops"
    mended = AccessFile(tmp_path / "other.json").change(lambda register: register.added(replace(ADMIN, name="bob")))
    (tmp_path / "other.json").replace(file.path)
    assert file.read() == mended


def test_of_two_programs_that_change_at_once_both_are_kept(tmp_path: Path) -> None:
    def add(n: int) -> None:
        AccessFile(tmp_path / "access.json").change(lambda register: register.added(replace(ADMIN, name=f"u{n}")))

    threads = [threading.Thread(target=add, args=(n,)) for n in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(AccessFile(tmp_path / "access.json").read().users) == 8


def test_g12_a_disk_that_is_full_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = AccessFile(tmp_path / "access.json")
    file.change(lambda register: register.added(ADMIN))

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as context:
        context.setattr("os.fsync", full)
        with pytest.raises(ConfigurationError):
            file.change(lambda register: register.with_token(TOKEN))
    assert AccessFile(file.path).read() == Register((ADMIN,))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["access.json", "access.lock"]
