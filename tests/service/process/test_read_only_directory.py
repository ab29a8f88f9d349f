"""Lock and sockets of a service whose state directory cannot be written, or is emptied while it runs."""

from __future__ import annotations

import asyncio
import errno
import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace

import pytest
from click.testing import CliRunner, Result

from drivebus import i18n
from drivebus.cli.commands import stop
from drivebus.cli.main import cli
from drivebus.errors import ConfigurationError
from drivebus.service.ipc import protocol
from drivebus.service.ipc.client import SocketClient
from drivebus.service.ipc.protocol import (
    SERVICE_SOCKET,
    STOP_SOCKET,
    create_runtime_folder,
    remove_runtime_folders,
    socket_path,
)
from drivebus.service.process import lock, main
from drivebus.service.process.lock import directory_problems, single_instance
from drivebus.service.process.logging_setup import RepetitionFilter
from fixtures.receiver import wait_until
from fixtures.service import LOCAL, SHOP_FILE, plant_config, running_service


@pytest.fixture
def runtime_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The only place of sockets outside the state directory; its path is short, as that of a Unix socket must be."""
    with TemporaryDirectory(prefix="drivebus-") as name:
        monkeypatch.setattr(protocol, "RUNTIME_FOLDERS", (str(tmp_path / "missing"), name))
        yield Path(name)


async def test_without_a_place_for_its_sockets_the_service_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(protocol, "RUNTIME_FOLDERS", ())
    async with running_service() as kit:
        with pytest.raises(ConfigurationError, match="No such file or directory"):
            async with main._service_sockets(kit.service, tmp_path / "missing"):
                pass


async def test_the_sockets_move_to_the_runtime_folder_and_back(tmp_path: Path, runtime_folder: Path) -> None:
    missing = tmp_path / "missing"
    async with running_service() as kit:
        missing.symlink_to(tmp_path / "later")
        folder = create_runtime_folder(missing)
        async with main._service_sockets(kit.service, missing):
            assert sorted(path.name for path in folder.iterdir()) == [SERVICE_SOCKET, STOP_SOCKET]
        assert not folder.exists()


async def test_a_socket_that_is_removed_is_there_again_and_a_stop_finds_the_service(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A cleaner of old files, or a state directory that is emptied: the stop said that no service runs."""
    monkeypatch.setattr(main, "SOCKET_CHECK_INTERVAL_S", 0.01)
    with TemporaryDirectory(prefix="drivebus-") as name:
        folder = Path(name) / "state"
        folder.mkdir(mode=0o700)
        async with running_service() as kit, main._service_sockets(kit.service, folder):
            client = SocketClient(folder / SERVICE_SOCKET)
            await client.call("plant.get", {}, LOCAL)
            connection = client._writer
            for path in folder.iterdir():
                path.unlink()
            folder.rmdir()
            await wait_until(lambda: len(caplog.messages) == 2)
            await asyncio.sleep(0.05)
            assert len([line for line in caplog.messages if "is missing: No such file or directory" in line]) == 2
            folder.mkdir(mode=0o700)
            await wait_until(lambda: (folder / STOP_SOCKET).is_socket() and (folder / SERVICE_SOCKET).is_socket())
            await wait_until(  # the line of the log follows the socket
                lambda: (
                    len([line for line in caplog.messages if "was removed or replaced; it is there again" in line]) == 2
                )
            )
            assert (await stop._request_stop(folder))["outcomes"]
            await client.call("plant.get", {}, LOCAL)
            assert client._writer is connection, "an open connection goes on"
            await client.close()
        assert list(folder.iterdir()) == []


async def test_a_stop_finds_the_service_after_its_directory_was_moved_away_and_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The sockets of the folder that came back had no listener: the stop found no service while it ran."""
    monkeypatch.setattr(main, "SOCKET_CHECK_INTERVAL_S", 0.01)
    with TemporaryDirectory(prefix="drivebus-") as name:
        folder, away = Path(name) / "state", Path(name) / "away"
        folder.mkdir(mode=0o700)
        async with running_service() as kit, main._service_sockets(kit.service, folder):
            await asyncio.sleep(0.05)
            folder.rename(away)
            folder.mkdir(mode=0o700)
            await wait_until(lambda: (folder / STOP_SOCKET).is_socket() and (folder / SERVICE_SOCKET).is_socket())
            await asyncio.sleep(0.05)
            shutil.rmtree(folder)
            away.rename(folder)
            await asyncio.sleep(0.2)
            assert (await stop._request_stop(folder))["outcomes"]
            client = SocketClient(folder / SERVICE_SOCKET)
            await client.call("plant.get", {}, LOCAL)
            await client.close()


async def test_a_socket_whose_directory_may_not_be_entered_for_a_time_is_restored_later(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The check itself failed and was never made again."""
    monkeypatch.setattr(main, "SOCKET_CHECK_INTERVAL_S", 0.01)
    with TemporaryDirectory(prefix="drivebus-") as name:
        folder = Path(name)
        async with running_service() as kit, main._service_sockets(kit.service, folder):
            with monkeypatch.context() as patch:
                patch.setattr(Path, "is_socket", _raise_permission_error)
                await wait_until(lambda: len(caplog.messages) == 2)
                assert all("is missing: Permission denied" in line for line in caplog.messages)
            (folder / STOP_SOCKET).unlink()
            await wait_until((folder / STOP_SOCKET).is_socket)


async def test_no_second_service_starts_on_a_directory_that_was_removed_and_created_again() -> None:
    """The lock was gone: the second service took the sockets, and a stop reached the one without the ports."""
    with TemporaryDirectory(prefix="drivebus-") as name:
        folder = Path(name) / "state"
        folder.mkdir(mode=0o700)
        async with running_service() as kit, main._service_sockets(kit.service, folder):
            with pytest.raises(ConfigurationError) as refused:
                await asyncio.wait_for(main.run_service(plant_config(directory=folder)), 10.0)
            assert refused.value.key == "plant.runs_already"
            assert (await stop._request_stop(folder))["outcomes"]
        killed = await asyncio.start_unix_server(lambda reader, writer: None, folder / STOP_SOCKET)
        killed.close()
        assert (folder / STOP_SOCKET).is_socket()
        await main._check_no_service_answers(folder)


async def test_a_socket_that_is_removed_again_and_again_fills_no_log(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A cleaner that runs each second: every restoration was a line of the log."""
    monkeypatch.setattr(main, "SOCKET_CHECK_INTERVAL_S", 0.001)
    now = [0.0]
    repetition = RepetitionFilter(lambda: now[0])
    monkeypatch.setattr(main.LOG, "filters", [repetition])
    with TemporaryDirectory(prefix="drivebus-") as name:
        stop_socket = Path(name) / STOP_SOCKET
        async with running_service() as kit, main._service_sockets(kit.service, Path(name)):

            async def remove() -> None:
                stop_socket.unlink()
                await wait_until(stop_socket.is_socket)
                await asyncio.sleep(0.01)  # for the line of the log

            for _ in range(10):
                await remove()
            line = f"the socket {stop_socket} was removed or replaced; it is there again"
            assert caplog.messages == [line]
            now[0] = 600.0
            await remove()
            await wait_until(lambda: len(caplog.messages) == 2)
            assert caplog.messages[1] == f"{line} (and 9 more)"


def _raise_permission_error(path: Path) -> bool:
    raise PermissionError(errno.EACCES, "Permission denied", str(path))


@pytest.mark.parametrize("reason", [errno.EROFS, errno.ENOSPC, errno.EDQUOT])
def test_a_directory_that_cannot_be_written_is_locked_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reason: int
) -> None:
    real_open = os.open

    def fail(path: Path, flags: int, *mode: int) -> int:
        if flags & os.O_CREAT:
            raise OSError(reason, os.strerror(reason))
        return real_open(path, flags, *mode)

    tmp_path.chmod(0o700)
    with monkeypatch.context() as unwritable:
        unwritable.setattr(lock.os, "open", fail)
        with (
            single_instance(tmp_path),
            pytest.raises(ConfigurationError, match="already uses"),
            single_instance(tmp_path),
        ):
            pass
    with single_instance(tmp_path):
        assert (tmp_path / "service.lock").read_text() == f"{os.getpid()}\n"


def test_a_service_on_a_directory_that_became_writable_finds_the_one_that_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tmp_path.chmod(0o700)
    monkeypatch.setattr(lock, "_open_lock_file", lambda path: None)
    with single_instance(tmp_path):
        monkeypatch.undo()
        with pytest.raises(ConfigurationError, match="already uses"), single_instance(tmp_path):
            pass


def test_a_folder_in_the_place_of_the_lock_file_keeps_no_service_from_starting_and_is_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    tmp_path.chmod(0o700)
    folder = tmp_path / "service.lock"
    folder.mkdir()
    with single_instance(tmp_path), pytest.raises(ConfigurationError, match="already uses"), single_instance(tmp_path):
        pass
    assert f"{folder} is a folder" in caplog.text and "Remove this folder" in caplog.text
    assert [error.key for error in directory_problems(tmp_path)] == ["plant.lock_is_folder"]


def test_check_names_a_state_directory_that_cannot_be_written_with_its_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was silent, and the service then refused every start. The help did not say that it looks."""
    for language, words in {"en": "a state directory", "zh": "状态目录"}.items():
        assert words in i18n.text("help.check.long", language)
    state, plant = tmp_path / "state", tmp_path / "plant.toml"
    plant.write_text(SHOP_FILE)

    def run(*options: str) -> Result:
        found = CliRunner().invoke(cli, ["check", str(plant), "--lang", "en", *options])
        assert found.exit_code == 0
        return found

    def problems() -> list[str]:
        return [error["key"] for error in json.loads(run("--json").stdout)["directory_problems"]]

    assert problems() == [], "the service makes it"
    state.mkdir(mode=0o500)
    if os.geteuid() == 0:
        os.chown(state, 12345, -1)  # root could write its own
    assert f"chmod u+rwx {state}" in run().output
    assert problems() == ["plant.directory_unwritable"]
    state.chmod(0o700)
    assert problems() == []
    monkeypatch.setattr(lock.os, "statvfs", lambda _: SimpleNamespace(f_flag=os.ST_RDONLY))
    assert "read-only file system" in run().output
    assert problems() == ["plant.directory_read_only"]


def test_another_error_of_the_lock_file_is_refused_as_before(tmp_path: Path) -> None:
    tmp_path.chmod(0o700)
    (tmp_path / "service.lock").symlink_to(tmp_path / "foreign")
    with pytest.raises(ConfigurationError, match="symbolic link"), single_instance(tmp_path):
        pass
    assert not (tmp_path / "foreign").exists()


async def test_sockets_in_the_runtime_folder_are_found_until_they_are_removed(
    tmp_path: Path, runtime_folder: Path
) -> None:
    folder = create_runtime_folder(tmp_path)
    assert folder.parent == runtime_folder and folder.stat().st_mode & 0o777 == 0o700
    assert socket_path(tmp_path, STOP_SOCKET) == tmp_path / STOP_SOCKET
    server = await asyncio.start_unix_server(lambda reader, writer: None, folder / STOP_SOCKET)
    assert socket_path(tmp_path, STOP_SOCKET) == folder / STOP_SOCKET
    server.close()
    remove_runtime_folders(tmp_path)
    assert not folder.exists()
    assert socket_path(tmp_path, STOP_SOCKET) == tmp_path / STOP_SOCKET


@pytest.mark.parametrize("trick", ["others may write", "symbolic link", "file"])
async def test_a_runtime_folder_that_others_prepared_is_not_used(
    tmp_path: Path, runtime_folder: Path, trick: str
) -> None:
    """Any user may create a name below /tmp before the service does."""
    folder, foreign = create_runtime_folder(tmp_path), tmp_path / "foreign"
    server = await asyncio.start_unix_server(lambda reader, writer: None, folder / STOP_SOCKET)
    if trick == "others may write":
        folder.chmod(0o777)
    else:
        folder.rename(foreign)
        folder.symlink_to(foreign) if trick == "symbolic link" else folder.write_text("")
    assert socket_path(tmp_path, STOP_SOCKET) == tmp_path / STOP_SOCKET
    with pytest.raises(OSError):
        create_runtime_folder(tmp_path)
    remove_runtime_folders(tmp_path)
    assert folder.exists()
    server.close()
