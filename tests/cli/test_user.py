"""``drivebus user``: who may log in, from the command line of the plant's own machine."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from drivebus.cli.main import cli
from drivebus.service.auth.passwords import PasswordHashing
from drivebus.service.auth.rights import Right, Role
from drivebus.service.auth.service import AuthService
from drivebus.testing.virtual_time import run
from fixtures.service import SHOP_FILE
from fixtures.web_app import FAST_HASHER, PASSWORD


@pytest.fixture
def plant(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A plant's file; hashing is quick here, what is used in earnest is tested elsewhere."""
    made = PasswordHashing(FAST_HASHER)
    monkeypatch.setattr("drivebus.service.auth.passwords.PasswordHashing", lambda: made)
    path = tmp_path / "plant.toml"
    path.write_text(SHOP_FILE)
    return path


def user(plant: Path, verb: str, *words: str, typed: str = "") -> Result:
    return CliRunner().invoke(cli, ["user", verb, str(plant), *words, "--lang", "en"], input=typed)


def access(plant: Path) -> AuthService:
    return AuthService(plant.parent / "state", passwords=PasswordHashing(FAST_HASHER))


def records(plant: Path) -> list[tuple[str, str, str]]:
    lines = (plant.parent / "state" / "audit.jsonl").read_text().splitlines()
    found: list[dict[str, Any]] = [json.loads(line) for line in lines]
    wanted = ("user.", "password", "token.")
    return [(one["what"], one["target"], one["outcome"]) for one in found if one["what"].startswith(wanted)]


def test_a_user_is_added_and_logs_in_and_both_is_recorded(plant: Path) -> None:
    done = user(plant, "add", "Ann", "--role", "administrator", typed=PASSWORD + "\n")
    assert (done.exit_code, done.output) == (0, "ann is added as administrator.\n")
    opened = run(access(plant).login("ann", PASSWORD, "local"))
    assert opened.session.user == "ann"
    assert records(plant) == [("user.add", "Ann", "requested"), ("user.add", "Ann", "done")]
    assert PASSWORD not in (plant.parent / "state" / "audit.jsonl").read_text()
    listed = user(plant, "list", "--json")
    assert [(one["name"], one["role"]) for one in json.loads(listed.output)["users"]] == [("ann", "administrator")]


def test_a_weak_password_and_a_taken_name_are_refused_with_the_reason(plant: Path) -> None:
    weak = user(plant, "add", "ann", "--role", "viewer", typed="short\n")
    assert weak.exit_code == 1 and "10 to 200 characters" in weak.output
    assert not (plant.parent / "state" / "users.json").exists()
    user(plant, "add", "ann", "--role", "viewer", typed=PASSWORD + "\n")
    taken = user(plant, "add", "ANN", "--role", "administrator", typed=PASSWORD + "\n")
    assert taken.exit_code == 1 and "already" in taken.output
    assert records(plant)[-1] == ("user.add", "ANN", "auth.name_taken")
    assert access(plant).database.user("ann").role is Role.VIEWER


def test_a_user_is_kept_out_let_in_again_renamed_a_password_and_removed(plant: Path) -> None:
    for name, role in (("ann", "administrator"), ("bob", "operator")):
        user(plant, "add", name, "--role", role, typed=PASSWORD + "\n")
    door = access(plant)
    visitor = door.session_credential(run(door.login("bob", PASSWORD, "local")).secret)
    assert visitor is not None
    assert user(plant, "disable", "bob").exit_code == 0
    assert visitor.end_reason == "rights", "an open session sees it"
    assert user(plant, "enable", "bob").exit_code == 0
    assert user(plant, "passwd", "bob", typed="another pass phrase\n").exit_code == 0
    run(door.login("bob", "another pass phrase", "local"))
    assert user(plant, "remove", "ann").exit_code == 1, "the last administrator"
    assert user(plant, "remove", "bob").exit_code == 0
    assert [one.name for one in door.database.users] == ["ann"]


def test_a_token_is_shown_once_and_may_what_was_asked_for(plant: Path) -> None:
    user(plant, "add", "bob", "--role", "operator", typed=PASSWORD + "\n")
    done = user(plant, "token", "bob", "--right", "view", "--right", "stop", "--days", "30", "--json")
    secret = json.loads(done.stdout)["token"]
    visitor = access(plant).token_credential(secret, "local")
    assert visitor is not None and visitor.actor.rights == {Right.VIEW, Right.STOP}
    assert secret not in (plant.parent / "state" / "users.json").read_text()
    beyond = user(plant, "token", "bob", "--right", "write_parameters")
    assert beyond.exit_code == 1 and "write_parameters" in beyond.output


def test_nothing_is_changed_where_it_can_not_be_recorded(plant: Path) -> None:
    state = plant.parent / "state"
    (state / "audit.jsonl").mkdir(parents=True)
    done = user(plant, "add", "ann", "--role", "viewer", typed=PASSWORD + "\n")
    assert done.exit_code == 1
    assert not (state / "users.json").exists()
