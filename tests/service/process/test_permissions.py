"""Owner and mode of the state directory and of the files that a plant trusts."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from drivebus.errors import ConfigurationError
from drivebus.profiles.load import own_files
from drivebus.service.config.load import load
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
    with pytest.raises(ConfigurationError, match="chown -h nobody") as refused, single_instance(tmp_path):
        raise AssertionError
    assert refused.value.key == "plant.foreign_owner"
    monkeypatch.setattr(permissions, "ROOT", -1)
    with pytest.raises(ConfigurationError, match="chown -h nobody"):
        check_trusted(file)


def test_a_group_of_one_user_may_write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Files are made with mode 664 where each user has a group of his own."""
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


@pytest.mark.parametrize("others_can_write", ["mine.toml", "base.toml", "."])
async def test_a_profile_that_others_can_write_or_replace_is_refused(tmp_path: Path, others_can_write: str) -> None:
    """A profile decides which frame starts a drive and which one stops it."""
    folder = tmp_path / "profiles"
    folder.mkdir()
    (folder / "mine.toml").write_text('format = 1\nextends = "base.toml"\n')
    (folder / "base.toml").write_text('format = 1\nextends = "c320"\n')
    drive = replace(plant_config().drives[0], model=str(folder / "mine.toml"))
    config = plant_config(directory=tmp_path / "state", drives=(drive,))
    check_plant_files(config)
    (folder / others_can_write).chmod(0o777)
    with pytest.raises(ConfigurationError, match="chmod go-w") as refused:
        await run_service(config)
    assert refused.value.params["path"] == str((folder / others_can_write).resolve())


@pytest.mark.parametrize("is_link_of_link", [False, True])
def test_a_link_that_others_can_replace_is_refused(tmp_path: Path, is_link_of_link: bool) -> None:
    """Another user could lead it to another plant of the same user, or to a certificate of its own."""
    private, shared = tmp_path / "private", tmp_path / "shared"
    private.mkdir()
    shared.mkdir()
    (private / "hall.toml").write_text("")
    link = shared / "plant.toml"
    link.symlink_to("../private/hall.toml")
    if is_link_of_link:
        link = private / "plant.toml"
        link.symlink_to(shared / "plant.toml")
    config = plant_config(directory=tmp_path / "state", source=str(link))
    check_plant_files(config)
    shared.chmod(0o777)
    with pytest.raises(ConfigurationError, match="chmod go-w") as refused:
        check_plant_files(config)
    assert refused.value.params["path"] == str(shared)


def test_a_link_of_another_user_in_a_folder_of_all_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The owner of the link can lead it elsewhere, although the sticky bit keeps all others from that."""
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o1777)
    (shared / "hall.toml").write_text("")
    link = shared / "plant.toml"
    link.symlink_to("hall.toml")
    config = plant_config(directory=tmp_path / "state", source=str(link))
    check_plant_files(config)
    owner = link.lstat()
    monkeypatch.setattr(Path, "lstat", lambda path: SimpleNamespace(st_uid=65_534, st_mode=owner.st_mode))
    with pytest.raises(ConfigurationError) as refused:
        check_plant_files(config)
    assert (refused.value.key, refused.value.params["path"]) == ("plant.foreign_owner", str(link))


NAMED_PATHS = {
    "directory": ('[plant]\ndirectory = "{path}"', True),
    "users": ('[plant]\nusers = "{path}"', False),
    "key": ('[audit]\nkey = "{path}"', False),
    "checkpoints": ('[audit]\ncheckpoints = "{path}"', False),
    "head": ('[audit]\nhead = "{path}"', False),
}


@pytest.mark.parametrize("inside", [False, True], ids=["the name is the link", "a folder of the name is the link"])
@pytest.mark.parametrize("setting", NAMED_PATHS)
def test_no_path_of_the_plant_file_leads_over_a_link_of_another_user(
    setting: str, inside: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The link was followed before its owner was looked at: checkpoints were appended to any file of this user."""
    private, shared = tmp_path / "private", tmp_path / "shared"
    private.mkdir(mode=0o700)
    shared.mkdir()
    shared.chmod(0o1777)
    table, is_folder = NAMED_PATHS[setting]
    target = private / "target"
    if is_folder:
        target.mkdir(mode=0o700)
    else:
        target.touch(0o600)
    link = shared / "link"
    link.symlink_to(private if inside else target)
    base = '[bus.a]\nport = "sim://c320@1"\n[drive.fan]\nbus = "a"\naddress = 1\nmodel = "c320"\n'
    if "[plant]" in table:
        text = f'format = 1\n{table}\nid = "hall"\ntitle = "Hall"\n{base}'
    else:
        text = f'format = 1\n[plant]\nid = "hall"\ntitle = "Hall"\ndirectory = "{tmp_path / "state"}"\n{table}\n{base}'
    file = tmp_path / "hall.toml"
    file.write_text(text.format(path=link / "target" if inside else link))
    config = load(file)
    check_plant_files(config)
    owner, lstat = link.lstat(), Path.lstat
    foreign = SimpleNamespace(st_uid=65_534, st_mode=owner.st_mode)
    monkeypatch.setattr(Path, "lstat", lambda path: foreign if path == link else lstat(path))
    with pytest.raises(ConfigurationError) as refused:
        check_plant_files(config)
    assert (refused.value.key, refused.value.params["path"]) == ("plant.foreign_owner", str(link))


@pytest.mark.parametrize("make", [os.mkfifo, Path.mkdir, Path.touch], ids=["a FIFO", "a folder", "a file"])
@pytest.mark.parametrize("setting", ["users", "key"])
def test_what_another_user_put_in_the_place_of_users_or_key_is_refused(
    setting: str, make: Callable[[Path], object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A FIFO in a folder that all can write was not looked at, and kept the service waiting for good."""
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o1777)
    path = shared / "planted"
    make(path)
    path.chmod(0o700)
    config = plant_config(directory=tmp_path / "state")
    if setting == "users":
        config = replace(config, users=path)
    else:
        config = replace(config, audit=replace(config.audit, key=path))
    check_plant_files(config)
    found, stat = path.stat(), Path.stat
    foreign = SimpleNamespace(st_uid=65_534, st_gid=found.st_gid, st_mode=found.st_mode)
    monkeypatch.setattr(Path, "stat", lambda asked, **kw: foreign if asked == path else stat(asked, **kw))
    with pytest.raises(ConfigurationError) as refused:
        check_plant_files(config)
    assert (refused.value.key, refused.value.params["path"]) == ("plant.foreign_owner", str(path))
    text = refused.value.text("en")
    assert text.index("remove it") < text.index("chown -h"), "chown would make planted users and a known key valid"


def test_a_foreign_link_to_a_readable_file_in_the_place_of_the_key_is_no_reason_to_change_the_mode_of_that_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command that was named, `chmod go-rwx`, would have followed the link, as to /etc/passwd."""
    shared, target = tmp_path / "shared", tmp_path / "passwd"
    shared.mkdir()
    shared.chmod(0o1777)
    target.touch(0o644)
    link = shared / "hall.key"
    link.symlink_to(target)
    owner, lstat = link.lstat(), Path.lstat
    foreign = SimpleNamespace(st_uid=65_534, st_mode=owner.st_mode)
    monkeypatch.setattr(Path, "lstat", lambda path: foreign if path == link else lstat(path))
    config = plant_config(directory=tmp_path / "state")
    with pytest.raises(ConfigurationError) as refused:
        check_plant_files(replace(config, audit=replace(config.audit, key=link)))
    assert (refused.value.key, refused.value.params["path"]) == ("plant.foreign_owner", str(link))


def test_files_of_an_installed_model_are_not_checked() -> None:
    """They have the owner and mode that the package manager gave them."""
    assert own_files("c320") == [] == own_files("huanyang_hy")


def test_a_folder_in_which_others_can_replace_a_file_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / "shared" / "plants"
    folder.mkdir(parents=True)
    (folder / "plant.toml").write_text("")
    config = plant_config(directory=tmp_path / "state", source=str(folder / "plant.toml"))
    for writable in (folder, folder.parent):
        writable.chmod(0o777)
        with pytest.raises(ConfigurationError, match="chmod go-w") as refused:
            check_plant_files(config)
        assert refused.value.params["path"] == str(writable.resolve())
        writable.chmod(0o1777)
        check_plant_files(config)
        writable.chmod(0o755)
    link = tmp_path / "link.toml"
    link.symlink_to(folder / "plant.toml")
    folder.chmod(0o777)
    with pytest.raises(ConfigurationError, match="chmod go-w"):
        check_plant_files(plant_config(directory=tmp_path / "state", source=str(link)))


def test_a_users_file_that_others_can_create_is_refused(tmp_path: Path) -> None:
    """In a folder such as /tmp the first one to create it would be the administrator."""
    folder = tmp_path / "tmp"
    folder.mkdir()
    folder.chmod(0o1777)
    config = plant_config(directory=tmp_path / "state", users=folder / "users.json")
    with pytest.raises(ConfigurationError) as refused:
        check_plant_files(config)
    assert refused.value.key == "plant.shared_folder"
    (folder / "users.json").touch(0o600)
    check_plant_files(config)
