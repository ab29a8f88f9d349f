"""A plant whose users' file is gone: no new plant, and open for no set-up."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivebus.service.auth.errors import Conflict
from drivebus.service.auth.service import AuthService
from drivebus.service.auth.users import UserFile
from drivebus.service.process.gateway_arguments import has_users
from drivebus.testing.virtual_time import run
from fixtures.auth import auth_service, login, new_auth_service, restarted
from fixtures.service import plant_config
from fixtures.web_app import PASSWORD, USERS


def without_its_file(directory: Path) -> tuple[AuthService, bytes]:
    """Return the service of a new web process in a plant whose file was deleted, and the file's content."""
    auth, clock = auth_service(directory)
    login(auth)
    content = auth.user_file.path.read_bytes()
    auth.user_file.path.unlink()
    return restarted(auth, clock), content


def test_a_plant_whose_user_file_was_deleted_is_not_open_for_set_up(tmp_path: Path) -> None:
    auth, _ = without_its_file(tmp_path)
    assert auth.users_missing and auth.needs_setup
    with pytest.raises(Conflict) as refused:
        run(auth.create_first_administrator(auth.setup_secret.issue(), "eve", PASSWORD, "127.0.0.1"))
    assert (refused.value.key, refused.value.params) == ("auth.users_missing", {"file": "users.json"})
    assert not auth.user_file.path.exists()


def test_a_restored_file_is_used_at_once(tmp_path: Path) -> None:
    auth, content = without_its_file(tmp_path)
    auth.user_file.path.write_bytes(content)
    assert not auth.users_missing and not auth.needs_setup
    assert login(auth)


def test_an_administrator_who_is_added_on_the_machine_ends_it(tmp_path: Path) -> None:
    """`drivebus user add` is another process: a file of its own is used."""
    auth, _ = without_its_file(tmp_path)
    UserFile(auth.user_file.path).change(lambda _: USERS)
    assert not auth.users_missing and not auth.needs_setup
    assert login(auth)


def test_a_new_plant_is_open_for_set_up(tmp_path: Path) -> None:
    auth, _ = new_auth_service(tmp_path)
    assert auth.needs_setup and not auth.users_missing
    auth.devices.issue("eve")  # a stranger's login makes this file of the same directory
    assert not auth.users_missing


def test_a_directory_that_is_removed_beside_the_running_service_makes_no_new_plant(tmp_path: Path) -> None:
    assert AuthService(tmp_path, had_users=True).users_missing


def test_the_service_knows_that_a_plant_has_users_by_their_file_or_their_sessions(tmp_path: Path) -> None:
    plant = plant_config(directory=tmp_path)
    assert not has_users(plant)
    auth, _ = without_its_file(tmp_path)
    assert has_users(plant), "by the sessions"
    auth.session_store.path.unlink()
    assert not has_users(plant)
    auth.user_file.change(lambda _: USERS)
    assert has_users(plant), "by the file"
