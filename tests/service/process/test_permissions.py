"""Owner and mode of the state directory and of the files that a plant trusts."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace

import pytest

from drivebus.errors import ConfigurationError
from drivebus.service.process import permissions
from drivebus.service.process.lock import single_instance
from drivebus.service.process.main import run_service
from drivebus.service.process.permissions import check_plant_files, check_trusted
from fixtures.service import plant_config


def test_a_state_directory_that_others_can_write_is_refused_with_the_command_that_mends_it(tmp_path: Path) -> None:
    """Another user could put an administrator into it."""
    folder = tmp_path / "my state"
    folder.mkdir()
    for mode in (0o777, 0o702):
        folder.chmod(mode)
        with pytest.raises(ConfigurationError, match=rf"chmod go-w '{folder}'"), single_instance(folder):
            raise AssertionError
    folder.chmod(0o755)
    with single_instance(folder):
        pass


def test_a_directory_of_another_user_is_refused_and_a_file_of_root_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "plant.toml"
    file.write_text("")
    monkeypatch.setattr(permissions, "ROOT", os.geteuid())
    monkeypatch.setattr(os, "geteuid", lambda: 65_534)
    check_trusted(file)
    with pytest.raises(ConfigurationError, match="chown nobody") as refused, single_instance(tmp_path):
        raise AssertionError
    assert refused.value.key == "plant.foreign_owner"
    monkeypatch.setattr(permissions, "ROOT", -1)
    with pytest.raises(ConfigurationError, match="chown nobody"):
        check_trusted(file)


def test_a_group_of_one_user_may_write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where each user has a group of his own, files are made with mode 664."""
    tmp_path.chmod(0o770)
    members: list[str] = []
    user = SimpleNamespace(pw_name="li", pw_gid=tmp_path.stat().st_gid)
    monkeypatch.setattr("pwd.getpwuid", lambda uid: user)
    monkeypatch.setattr("grp.getgrgid", lambda gid: SimpleNamespace(gr_name="li", gr_mem=members))
    check_trusted(tmp_path)
    members.append("wang")
    with pytest.raises(ConfigurationError, match="chmod go-w"):
        check_trusted(tmp_path)


def test_a_lock_file_that_is_a_link_leaves_the_file_that_it_names_alone(tmp_path: Path) -> None:
    (tmp_path / "precious").write_text("kept")
    (tmp_path / "service.lock").symlink_to(tmp_path / "precious")
    with pytest.raises(ConfigurationError, match="can't be used"), single_instance(tmp_path):
        raise AssertionError
    assert (tmp_path / "precious").read_text() == "kept"


def test_a_second_service_leaves_the_process_id_of_the_first(tmp_path: Path) -> None:
    with single_instance(tmp_path):
        with pytest.raises(ConfigurationError, match="already uses"), single_instance(tmp_path):
            raise AssertionError
        assert (tmp_path / "service.lock").read_text() == f"{os.getpid()}\n"


@pytest.mark.parametrize(
    ("name", "mode", "key"),
    [
        ("plant.toml", 0o666, "plant.writable_by_others"),
        ("state/users.json", 0o602, "plant.writable_by_others"),
        ("state.audit.key", 0o644, "plant.secret_readable"),
    ],
)
async def test_the_service_starts_with_no_plant_users_or_key_that_others_can_change_or_read(
    tmp_path: Path, name: str, mode: int, key: str
) -> None:
    (tmp_path / "state").mkdir()
    for file in ("plant.toml", "state/users.json", "state.audit.key"):
        (tmp_path / file).write_text("")
        (tmp_path / file).chmod(0o600)
    config = plant_config(directory=tmp_path / "state", source=str(tmp_path / "plant.toml"))
    check_plant_files(config)
    (tmp_path / name).chmod(mode)
    with pytest.raises(ConfigurationError) as refused:
        await run_service(config)
    assert refused.value.key == key
