"""Messages for a port that cannot be opened: the reason and the remedy."""

from __future__ import annotations

import errno
import grp
import os
import subprocess
import sys
from pathlib import Path

import pytest

from drivebus import i18n
from drivebus.errors import ErrorScope, PortUnavailable
from drivebus.ports import open_errors, open_port
from drivebus.ports.discovery import DeviceUser, PortInfo, device_users, lock_holder, pids_named, process_name
from fixtures.receiver import FakeReceiver
from ports.conftest import Pty


async def refused(path: str) -> PortUnavailable:
    with pytest.raises(PortUnavailable) as caught:
        await open_port(path).open(FakeReceiver())
    return caught.value


def no_ports(monkeypatch: pytest.MonkeyPatch, *existing: str) -> None:
    ports = [PortInfo(device=link, description="", identity=f"device:{link}", url=link) for link in existing]
    monkeypatch.setattr("drivebus.ports.open_errors.discover_ports", lambda: ports)


async def test_a_missing_port_names_those_that_exist(monkeypatch: pytest.MonkeyPatch) -> None:
    no_ports(monkeypatch, "/dev/ttyUSB1", "/dev/ttyACM0")
    error = await refused("/dev/ttyUSB9")
    assert (error.key, error.params["existing"]) == ("ports.missing", ("/dev/ttyUSB1", "/dev/ttyACM0"))
    assert error.scope is ErrorScope.PORT


async def test_a_machine_without_ports_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    no_ports(monkeypatch)
    monkeypatch.setattr(open_errors, "_in_wsl", lambda: False)
    assert (await refused("/dev/ttyUSB9")).key == "ports.missing_none"
    monkeypatch.setattr(open_errors, "_in_wsl", lambda: True)
    error = await refused("/dev/ttyUSB9")
    assert error.key == "ports.missing_wsl"
    assert "usbipd attach" in str(error)
    assert "usbipd attach" in error.text("zh")


@pytest.mark.parametrize("kind", ["file", "folder", "device"])
async def test_a_file_that_is_no_serial_port_is_rejected_by_name(tmp_path: Path, kind: str) -> None:
    path = {"file": tmp_path / "file", "folder": tmp_path, "device": Path("/dev/null")}[kind]
    (tmp_path / "file").write_text("")
    assert (await refused(str(path))).key == "ports.not_serial"


def test_a_name_without_hardware_is_distinguished_from_a_missing_one(pty: Pty) -> None:
    """The kernel names /dev/ttyS0 to S3 whether they exist or not; to open them gives EIO."""
    assert open_errors.open_error(pty.path, OSError(errno.EIO, "x")).key == "ports.no_hardware"
    other = open_errors.open_error(pty.path, OSError(errno.EMFILE, "too many open files"))
    assert (other.key, str(other.params["reason"])) == ("ports.failed", "Too many open files")


def denied(path: Path) -> PortUnavailable:
    return open_errors.open_error(str(path), PermissionError(errno.EACCES, "denied"))


def test_a_missing_right_names_the_group_and_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    node = tmp_path / "ttyUSB0"
    node.write_text("")
    node.chmod(0o660)
    group = grp.struct_group(("dialout", "x", 20, []))
    monkeypatch.setattr(grp, "getgrgid", lambda _: group)
    monkeypatch.setattr(open_errors, "_group_of", lambda _: 20)
    error = denied(node)
    assert (error.key, error.params["group"]) == ("ports.permission", "dialout")
    assert f"sudo usermod -aG dialout {error.params['user']}" in str(error)
    monkeypatch.setattr(grp, "getgrgid", lambda _: grp.struct_group(("dialout", "x", 20, [error.params["user"]])))
    assert denied(node).key == "ports.permission_relogin"
    node.chmod(0o600)
    assert denied(node).key == "ports.permission_rule"


def test_a_device_of_roots_own_group_needs_a_rule_and_no_membership(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    node = tmp_path / "ttyUSB0"
    node.write_text("")
    node.chmod(0o660)
    monkeypatch.setattr(open_errors, "_group_of", lambda _: 0)
    error = denied(node)
    assert (error.key, error.params["mode"]) == ("ports.permission_rule", "-rw-rw----")


def test_a_port_in_a_directory_that_can_not_be_searched_can_not_be_opened(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The mode and the group of the device can't be read then."""
    real = Path.stat

    def stat(path: Path, **options: bool) -> os.stat_result:
        if path.name == "ttyUSB0":
            raise PermissionError(errno.EACCES, "denied")
        return real(path, **options)

    monkeypatch.setattr(Path, "stat", stat)
    error = denied(tmp_path / "ttyUSB0")
    assert (error.key, str(error.params["reason"])) == ("ports.failed", "Permission denied")


def test_a_busy_port_names_the_program_that_uses_it(pty: Pty) -> None:
    program = (
        "import os, sys, time; os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY); print(1, flush=True); time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", program, pty.path], stdout=subprocess.PIPE) as child:
        assert child.stdout is not None
        child.stdout.readline()
        error = open_errors.open_error(pty.path, OSError(errno.EBUSY, "busy"))
        assert (error.key, error.params["pid"]) == ("ports.held", child.pid)
        assert error.params["name"] == process_name(child.pid)
        assert DeviceUser(child.pid, process_name(child.pid)) in device_users({pty.path})[pty.path]
        child.kill()
    assert process_name(child.pid) == ""


def test_a_user_that_proc_hides_is_identified_by_its_lock(pty: Pty, monkeypatch: pytest.MonkeyPatch) -> None:
    """The open files of another user's drivebus are hidden, the kernel's list of locks is not."""
    monkeypatch.setattr(open_errors, "device_users", lambda paths: {path: [] for path in paths})
    program = (
        "import fcntl, os, sys, time; fcntl.flock(os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY), fcntl.LOCK_EX); "
        "print(1, flush=True); time.sleep(60)"
    )
    assert lock_holder(pty.path) is None
    with subprocess.Popen([sys.executable, "-c", program, pty.path], stdout=subprocess.PIPE) as child:
        assert child.stdout is not None
        child.stdout.readline()
        error = open_errors.open_error(pty.path, OSError(errno.EBUSY, "busy"))
        assert (error.key, error.params["pid"]) == ("ports.held", child.pid)
        child.kill()
    assert lock_holder(pty.path) is None
    assert lock_holder("/dev/no such port") is None


def test_our_own_lock_is_not_reported_as_a_user(pty: Pty) -> None:
    import fcntl

    fd = os.open(pty.path, os.O_RDWR | os.O_NOCTTY)
    fcntl.flock(fd, fcntl.LOCK_EX)
    assert lock_holder(pty.path) is None
    os.close(fd)


@pytest.mark.parametrize(
    ("name", "key", "hint"),
    [
        ("ModemManager", "ports.held_modemmanager", "systemctl disable --now ModemManager"),
        ("brltty", "ports.held_brltty", "systemctl mask --now brltty"),
        ("agetty", "ports.held_getty", "systemctl disable --now serial-getty@ttyS0"),
        ("minicom", "ports.held", "minicom (pid 42)"),
    ],
)
def test_a_known_program_comes_with_its_own_remedy(name: str, key: str, hint: str) -> None:
    error = open_errors.in_use_error("/dev/ttyS0", DeviceUser(42, name))
    assert error.key == key
    assert hint in str(error)
    assert hint.split(" (")[0] in error.text("zh")


def test_a_hidden_user_is_guessed_by_name_or_found_with_a_command(pty: Pty, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(open_errors, "pids_named", lambda name: [7] if name == "brltty" else [])
    error = open_errors.open_error(pty.path, OSError(errno.EBUSY, "busy"))
    assert (error.key, error.params["pid"]) == ("ports.held_brltty", 7)
    monkeypatch.setattr(open_errors, "pids_named", lambda _: [])
    error = open_errors.open_error(pty.path, OSError(errno.EBUSY, "busy"))
    assert error.key == "ports.busy"
    assert f"sudo fuser -v {pty.path}" in str(error)


async def test_a_real_port_that_another_program_has_open_without_a_lock_is_rejected(
    pty: Pty, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The other program is a second master. Ptys are not checked, so the pty is declared a real port."""
    from drivebus.ports import tty
    from drivebus.ports.tty import SerialDescriptor, open_device
    from drivebus.types import Capabilities

    def real(*args: object, **options: object) -> SerialDescriptor:
        descriptor = open_device(*args, **options)  # type: ignore[arg-type]
        descriptor.capabilities = Capabilities(has_line_timing=True)
        return descriptor

    monkeypatch.setattr(tty, "open_device", real)
    monkeypatch.setattr(tty, "device_users", lambda paths: {path: [DeviceUser(4711, "picocom")] for path in paths})
    error = await refused(pty.path)
    assert (error.key, error.params["pid"], error.params["name"]) == ("ports.held", 4711, "picocom")
    monkeypatch.setattr(tty, "device_users", lambda paths: {path: [DeviceUser(os.getpid(), "us")] for path in paths})
    port = open_port(pty.path)
    await port.open(FakeReceiver())
    await port.close()


def test_processes_are_found_by_name() -> None:
    assert os.getpid() in pids_named(process_name(os.getpid()))
    assert pids_named("no such program") == []


def test_every_message_has_its_parameters_in_both_languages() -> None:
    import re

    for prefix in ("ports.", "capture."):
        keys = [key for key in i18n.catalogue("en") if key.startswith(prefix)]
        assert keys
        for key in keys:
            places = [set(re.findall(r"\{(\w+)\}", i18n.catalogue(language)[key])) for language in ("en", "zh")]
            assert places[0] == places[1], key


def test_the_message_of_a_missing_port_names_those_that_exist(monkeypatch: pytest.MonkeyPatch) -> None:
    no_ports(monkeypatch, "/dev/ttyUSB1")
    error = open_errors.open_error("/dev/ttyUSB0", FileNotFoundError(errno.ENOENT, "x"))
    assert str(error) == "/dev/ttyUSB0 does not exist; plug the adapter in or use one that exists: /dev/ttyUSB1"
    assert error.text("zh") == "/dev/ttyUSB0 不存在；请插好适配器，或使用现有串口：/dev/ttyUSB1"
