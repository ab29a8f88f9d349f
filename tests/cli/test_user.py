"""``drivebus user``: users and tokens of a plant, managed on the machine of the service."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from drivebus import i18n
from drivebus.cli import output
from drivebus.cli.main import cli
from drivebus.service.auth.passwords import PasswordHashing
from drivebus.service.auth.rights import Right, Role
from drivebus.service.auth.service import AuthService
from drivebus.testing.virtual_time import run
from fixtures.service import SHOP_FILE
from fixtures.web_app import FAST_HASHER, PASSWORD


@pytest.fixture
def plant(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a plant file; passwords are hashed with fast parameters."""
    hashing = PasswordHashing(FAST_HASHER)
    monkeypatch.setattr("drivebus.service.auth.passwords.PasswordHashing", lambda: hashing)
    path = tmp_path / "plant.toml"
    path.write_text(SHOP_FILE)
    return path


def user(plant: Path, command: str, *words: str, stdin: str = "") -> Result:
    return CliRunner().invoke(cli, ["user", command, str(plant), *words, "--lang", "en"], input=stdin)


def auth_service(plant: Path) -> AuthService:
    return AuthService(plant.parent / "state", passwords=PasswordHashing(FAST_HASHER))


def records(plant: Path) -> list[tuple[str, str, str]]:
    lines = (plant.parent / "state" / "audit.jsonl").read_text().splitlines()
    found: list[dict[str, Any]] = [json.loads(line) for line in lines]
    wanted = ("user.", "password", "token.")
    return [(entry["what"], entry["target"], entry["outcome"]) for entry in found if entry["what"].startswith(wanted)]


def test_an_added_user_can_log_in_and_the_change_is_audited(plant: Path) -> None:
    result = user(plant, "add", "Ann", "--role", "administrator", stdin=PASSWORD + "\n")
    assert (result.exit_code, result.output) == (0, "ann is added as administrator.\n")
    opened = run(auth_service(plant).login("ann", PASSWORD, "local"))
    assert opened.session.user == "ann"
    assert records(plant) == [("user.add", "Ann", "requested"), ("user.add", "Ann", "done")]
    assert PASSWORD not in (plant.parent / "state" / "audit.jsonl").read_text()
    listed = user(plant, "list", "--json")
    assert [(account["name"], account["role"]) for account in json.loads(listed.output)["users"]] == [
        ("ann", "administrator")
    ]


def test_tokens_are_listed_and_withdrawn(plant: Path) -> None:
    user(plant, "add", "ann", "--role", "viewer", stdin=PASSWORD + "\n")
    assert user(plant, "tokens").output == "There is no token.\n"
    made = json.loads(user(plant, "token", "ann", "--label", "scada", "--json").stdout)
    assert all(text in user(plant, "tokens").output for text in (made["id"], "ann", "scada", "view"))
    (listed,) = json.loads(user(plant, "tokens", "--json").stdout)["tokens"]
    assert (listed["id"], "digest" in listed, "secret" in listed) == (made["id"], False, False)
    assert auth_service(plant).token_credential(made["token"], "local") is not None
    assert user(plant, "revoke", made["id"]).output == f"Token {made['id']} is withdrawn.\n"
    assert auth_service(plant).token_credential(made["token"], "local") is None
    assert records(plant)[-2:] == [("token.remove", made["id"], "requested"), ("token.remove", made["id"], "done")]
    assert user(plant, "revoke", made["id"]).exit_code == 1


def test_a_weak_password_and_an_existing_name_are_errors_with_the_reason(plant: Path) -> None:
    weak = user(plant, "add", "ann", "--role", "viewer", stdin="short\n")
    assert weak.exit_code == 1 and "10 to 200 characters" in weak.output
    assert not (plant.parent / "state" / "users.json").exists()
    user(plant, "add", "ann", "--role", "viewer", stdin=PASSWORD + "\n")
    taken = user(plant, "add", "ANN", "--role", "administrator", stdin=PASSWORD + "\n")
    assert taken.exit_code == 1 and "already" in taken.output
    assert records(plant)[-1] == ("user.add", "ANN", "auth.name_taken")
    assert auth_service(plant).database.user("ann").role is Role.VIEWER


def test_a_user_is_disabled_enabled_given_a_new_password_and_removed(plant: Path) -> None:
    for name, role in (("ann", "administrator"), ("bob", "operator")):
        user(plant, "add", name, "--role", role, stdin=PASSWORD + "\n")
    auth = auth_service(plant)
    credential = auth.session_credential(run(auth.login("bob", PASSWORD, "local")).secret)
    assert credential is not None
    assert user(plant, "disable", "bob").exit_code == 0
    assert credential.end_reason == "disabled", "the open session is ended"
    assert user(plant, "enable", "bob").exit_code == 0
    assert user(plant, "passwd", "bob", stdin="another pass phrase\n").exit_code == 0
    run(auth.login("bob", "another pass phrase", "local"))
    assert user(plant, "remove", "ann").exit_code == 1, "the last administrator"
    assert user(plant, "remove", "bob").exit_code == 0
    assert [account.name for account in auth.database.users] == ["ann"]


def test_a_token_is_printed_once_and_has_the_given_rights(plant: Path) -> None:
    user(plant, "add", "bob", "--role", "operator", stdin=PASSWORD + "\n")
    result = user(plant, "token", "bob", "--right", "view", "--right", "stop", "--days", "30", "--json")
    secret = json.loads(result.stdout)["token"]
    credential = auth_service(plant).token_credential(secret, "local")
    assert credential is not None and credential.actor.rights == {Right.VIEW, Right.STOP}
    assert secret not in (plant.parent / "state" / "users.json").read_text()
    beyond = user(plant, "token", "bob", "--right", "write_parameters")
    assert beyond.exit_code == 1 and "write_parameters" in beyond.output


def test_a_change_that_cannot_be_audited_is_not_made(plant: Path) -> None:
    state = plant.parent / "state"
    (state / "audit.jsonl").mkdir(parents=True)
    result = user(plant, "add", "ann", "--role", "viewer", stdin=PASSWORD + "\n")
    assert result.exit_code == 1
    assert not (state / "users.json").exists()


def test_a_token_that_cannot_be_shown_is_withdrawn(plant: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Regression: on a full disk a token remained that nobody had seen."""
    user(plant, "add", "bob", "--role", "operator", stdin=PASSWORD + "\n")
    echo = output.click.echo

    def fail(text: str, err: bool = False, **more: Any) -> None:
        if not err:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        echo(text, err=err, **more)

    with monkeypatch.context() as patch:
        patch.setattr(output.click, "echo", fail)
        result = user(plant, "token", "bob", "--right", "view")
    assert result.exit_code == 2 and "No space left on device" in result.stderr
    assert i18n.text("user_command.token_lost", "en") in result.stderr
    assert auth_service(plant).database.tokens == ()
    assert [what for what, _, _ in records(plant)[-4:]] == ["token.add"] * 2 + ["token.remove"] * 2


def test_a_users_file_that_cannot_be_written_stays_and_no_token_is_shown(
    plant: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Regression: on a full disk the advice was to restore the file from a backup."""
    user(plant, "add", "bob", "--role", "operator", stdin=PASSWORD + "\n")
    file = plant.parent / "state" / "users.json"
    before = file.read_bytes()

    def fail(*_: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("drivebus.service.auth.users.atomic_write_private", fail)
    result = user(plant, "token", "bob", "--right", "view")
    assert (result.exit_code, result.stdout, file.read_bytes()) == (2, "", before)
    expected = i18n.text("auth.store_unwritten", "en", file=file, problem="No space left on device")
    assert expected in result.stderr and "backup" not in result.stderr
