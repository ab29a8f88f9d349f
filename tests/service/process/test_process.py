"""The service as a process: single instance, systemd notification, orderly end, killed web process."""

from __future__ import annotations

import asyncio
import errno
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import httpx
import pytest

from drivebus import i18n
from drivebus.cli.commands import stop
from drivebus.cli.errors import ExitCode, exit_code_of
from drivebus.errors import AuditUnavailable, ConfigurationError, StopUnconfirmed
from drivebus.service.auth.actor import local_actor
from drivebus.service.auth.rights import Role
from drivebus.service.auth.users import UserFile
from drivebus.service.ipc.client import SocketClient
from drivebus.service.ipc.protocol import SERVICE_SOCKET, STOP_SOCKET, socket_path
from fixtures.child_process import CHILD_TIMEOUT_S, SLOW_MACHINE_C320
from fixtures.running_service import token, user_database
from fixtures.service import WIDEST_LIMITS

COMMAND = [sys.executable, "-m", "drivebus"]
PLANT = """
format = 1
[plant]
id = "hall"
title = "Hall"
directory = "{directory}"
[gateway.web]
port = 0
[bus.a]
port = "sim://c320@1,2?ramp=0.5"
[drive.fan-1]
bus = "a"
address = 1
model = "./slow_machine_c320.toml"
"""
SECOND = '[drive.fan-2]\nbus = "a"\naddress = 2\nmodel = "./slow_machine_c320.toml"\n'
ME = local_actor("tester", "t-1")
READ_ONLY_MOUNT = 'mount --bind "$0" "$0" && mount -o remount,bind,ro "$0" && exec "$@"'
UNSHARE = ["unshare", "--mount", *([] if os.geteuid() == 0 else ["--map-root-user"]), "sh", "-c", READ_ONLY_MOUNT]
"""Begin of a command for which a directory, its next word, is read-only, also if it is root's."""


def write(tmp_path: Path, *more: str) -> Path:
    shutil.copy(SLOW_MACHINE_C320, tmp_path)
    file = tmp_path / "plant.toml"
    file.write_text(PLANT.format(directory=tmp_path / "state") + "".join(more))
    return file


@contextmanager
def running_service(
    file: Path, *words: str, prefix: Sequence[str] = (), command: Sequence[str] = COMMAND, **environment: str
) -> Iterator[subprocess.Popen[str]]:
    """A service process that is ready."""
    process = subprocess.Popen(
        [*prefix, *command, "serve", str(file), *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"DRIVEBUS_LANG": "en", "PYTHONUNBUFFERED": "1", **environment},
    )
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line.startswith("Plant hall is running"), (line, process.stderr and process.stderr.read())
        yield process
    finally:
        process.kill()
        process.communicate()


def command(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*COMMAND, *words], capture_output=True, text=True, check=False)


async def wait_until_state(client: SocketClient, drive: str, state: str) -> dict[str, Any]:
    """Return the view of a drive once its state is read as the given one."""
    while True:
        found = {view["id"]: view for view in (await client.call("drives.list", {}, ME))["drives"]}
        if found.get(drive, {}).get("state") == state:
            return dict(found[drive])
        await asyncio.sleep(0.1)


def test_ctrl_z_does_not_suspend_a_service_and_says_why(tmp_path: Path) -> None:
    """The motors ran on without supervision, and no stop of the page was sent until ``fg``."""
    with running_service(write(tmp_path), "--without", "web") as process:
        process.send_signal(signal.SIGTSTP)
        assert process.stderr is not None
        assert any("Ctrl-Z does not suspend the service" in line for line in process.stderr)
        assert command("stop", "--all", "--directory", str(tmp_path / "state")).returncode == 0


def test_a_used_port_of_the_page_is_reported_before_the_running_plant(tmp_path: Path) -> None:
    """The plant was reported to run, and only a second later that its page can't be reached."""
    file = write(tmp_path)
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        file.write_text(file.read_text().replace("port = 0", f"port = {port}"))
        process = subprocess.Popen(
            [*COMMAND, "serve", str(file)],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env=os.environ | {"DRIVEBUS_LANG": "en", "PYTHONUNBUFFERED": "1"},
        )
        try:
            assert process.stdout is not None
            lines: list[str] = []
            while not any(line.startswith("Plant hall is running") for line in lines):
                lines.append(process.stdout.readline())
                assert lines[-1], "the service goes on without its page"
            (reported,) = (line for line in lines if f"can't listen on 127.0.0.1:{port}" in line)
            assert "stops and history run without it" in reported
            assert "another host or port under [gateway.web] in plant.toml" in reported
            assert command("stop", "--all", str(file)).returncode == 0
        finally:
            process.kill()
            process.communicate()


def test_a_gateway_whose_port_stays_used_says_so_once(tmp_path: Path) -> None:
    """Each retry printed the same sentence, up to every 30 s for as long as the other program ran."""
    file = write(tmp_path)
    with socket.create_server(("127.0.0.1", 0)) as other:
        file.write_text(file.read_text().replace("port = 0", f"port = {other.getsockname()[1]}"))
        with running_service(file) as process:
            assert process.stderr is not None
            lines: list[str] = []
            while sum("ended again" in line for line in lines) < 2:
                lines.append(process.stderr.readline())
                assert lines[-1], "the service goes on without its page"
    assert sum(line.startswith("Can't listen on") for line in lines) == 1


def test_a_service_runs_once_reloads_its_file_and_stops_its_drives_at_the_end(tmp_path: Path) -> None:
    """It notifies systemd (``Type=notify``), reloads on SIGHUP, and ends in order on SIGTERM."""
    file, state = write(tmp_path), tmp_path / "state"
    manager = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    manager.bind(str(tmp_path / "notify"))
    manager.settimeout(CHILD_TIMEOUT_S)
    environment = {"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "1000000"}
    with running_service(file, "--without", "web", "--log", "json", **environment) as process:
        text = [manager.recv(100).decode() for _ in range(3)]
        assert "READY=1" in text and "WATCHDOG=1" in text
        second = command("serve", str(file), "--without", "web")
        assert second.returncode == 2 and "already uses" in second.stderr

        async def scenario() -> None:
            client = SocketClient(state / "plant.sock")
            await wait_until_state(client, "fan-1", "stopped")
            write(tmp_path, SECOND)
            process.send_signal(signal.SIGHUP)
            await wait_until_state(client, "fan-2", "stopped")
            for drive in ("fan-1", "fan-2"):
                await client.call("waiver.grant", {"drive": drive, "reason": "test bench"}, ME)
            await client.call("drive.run", {"drive": "fan-1", "frequency_hz": 20.0}, ME)
            stopped = await asyncio.to_thread(command, "stop", "--all", str(file), "--json")
            assert stopped.returncode == 0, stopped
            assert json.loads(stopped.stdout)["buses"]["a"]["confirmed"] is True
            await client.call("start_inhibit.release", {"drive": "fan-2"}, ME)
            await client.call("drive.run", {"drive": "fan-2", "frequency_hz": 20.0}, ME)
            await client.close()

        asyncio.run(scenario())  # meanwhile the manager's queue is full: no bus waits for it
        manager.setblocking(False)
        with suppress(BlockingIOError):
            while True:
                manager.recv(100)
        process.send_signal(signal.SIGTERM)
        _, errors = process.communicate(timeout=CHILD_TIMEOUT_S)
        assert process.returncode == 0
    while manager.recv(100) != b"STOPPING=1":
        pass
    manager.close()
    log = [json.loads(line) for line in errors.splitlines()]
    assert [event["outcome"] for event in log if event.get("kind") == "stop" and event.get("drive") == "fan-2"] == [
        "confirmed"
    ]
    trail = [json.loads(line) for line in (state / "audit.jsonl").read_text().splitlines()]
    assert "drive.run" in {entry["what"] for entry in trail}
    assert not [name for name in state.iterdir() if name.suffix == ".sock"]


def test_a_service_with_a_read_only_directory_stops_and_refuses_what_it_cannot_record(tmp_path: Path) -> None:
    """It did not start: no poll and no stop until the disk was repaired."""
    file, state = write(tmp_path), tmp_path / "state"
    state.mkdir(mode=0o700)
    read_only = [*UNSHARE, str(state)]
    if shutil.which("unshare") is None or subprocess.run([*read_only, "true"], check=False).returncode != 0:
        pytest.skip("no right to mount a directory read-only")

    async def scenario() -> None:
        client = SocketClient(socket_path(state, SERVICE_SOCKET))
        await wait_until_state(client, "fan-1", "stopped")
        assert (await stop._request_stop(state))["outcomes"]["fan-1"]["status"] == "confirmed"
        await client.call("start_inhibit.release", {"drive": "fan-1"}, ME)
        await client.call("drive.set_frequency", {"drive": "fan-1", "frequency_hz": 10.0}, ME)
        for operation, params in (
            ("drive.run", {"frequency_hz": 10.0}),
            ("drive.limits", {**WIDEST_LIMITS, "maximum_hz": 20.0}),
            ("waiver.grant", {"reason": "test bench"}),
        ):
            with pytest.raises(AuditUnavailable, match="Read-only file system"):
                await client.call(operation, {"drive": "fan-1", **params}, ME)
        plant = await client.call("plant.get", {}, ME)
        assert not plant["audit_ok"] and not plant["history_ok"]
        alarms = (await client.call("alarms.list", {}, ME))["active"]
        assert "history" in [alarm["subject"] for alarm in alarms if alarm["kind"] == "storage_failure"]
        await client.close()

    with running_service(file, "--without", "web", "--log", "json", prefix=read_only) as process:
        asyncio.run(scenario())
        process.send_signal(signal.SIGTERM)
        _, log = process.communicate(timeout=CHILD_TIMEOUT_S)
    assert process.returncode == 0
    assert any(f"{state} can't be written: Read-only file system" in line for line in log.splitlines())


def test_a_reload_signal_during_the_start_ends_nothing(tmp_path: Path) -> None:
    """It ended the process, and systemd, which counts that as a clean end, did not start it again."""
    file = write(tmp_path)
    code = (
        "import os, signal, sys\n"
        "import drivebus.service.config.load\n"
        "module = sys.modules['drivebus.service.config.load']\n"
        "real = module.load\n"
        "module.load = lambda source: os.kill(os.getpid(), signal.SIGHUP) or real(source)\n"
        "from drivebus.cli.main import main\n"
        f"sys.argv = ['drivebus', 'serve', {str(file)!r}, '--without', 'web']\n"
        "main()\n"
    )
    process = subprocess.Popen([sys.executable, "-u", "-c", code], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None and process.stdout.readline()
        process.send_signal(signal.SIGTERM)
        assert process.wait(CHILD_TIMEOUT_S) == 0
    finally:
        process.kill()
        process.communicate()


@pytest.mark.parametrize("moment", ["the command line is loaded", "the file is read", "the service is imported"])
def test_a_request_to_terminate_during_the_start_ends_it_with_a_sentence(moment: str, tmp_path: Path) -> None:
    """It ended the process without a line, and Ctrl-C in the same moment with an empty one."""
    module = {
        "the command line is loaded": "drivebus.cli.main",
        "the file is read": "drivebus.service.config.load",
        "the service is imported": "drivebus.service.process.main",
    }[moment]
    program = f"""
import os, signal, sys
class Terminating:
    def find_spec(self, name, *_):
        if name == {module!r}:
            sys.meta_path.remove(self)
            os.kill(os.getpid(), signal.SIGTERM)
sys.meta_path.insert(0, Terminating())
sys.argv[1:] = ["serve", {str(write(tmp_path))!r}, "--without", "web", "--lang", "zh"]
from drivebus.__main__ import main
main()
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout) == (ExitCode.INTERRUPTED, "")
    assert ended.stderr.strip() == i18n.text("cli.interrupted_early", "zh")
    assert not (tmp_path / "state").exists()


def test_a_service_whose_terminal_is_closed_ends_instead_of_reloading(tmp_path: Path) -> None:
    """A closed terminal ends the service; otherwise it would keep running with its port."""
    file, (master, slave) = write(tmp_path), os.openpty()
    process = subprocess.Popen(
        ["setsid", "--ctty", *COMMAND, "serve", str(file), "--without", "web"],
        stdin=slave,
        stdout=slave,
        stderr=slave,
        env=os.environ | {"DRIVEBUS_LANG": "en"},
    )
    try:
        os.close(slave)
        text = b""
        while b"Plant hall is running" not in text:
            text += os.read(master, 1000)
        os.close(master)
        assert process.wait(CHILD_TIMEOUT_S) == 0
    finally:
        process.kill()
        process.wait()
    assert not [path for path in (tmp_path / "state").iterdir() if path.suffix == ".sock"]


def test_a_service_goes_on_where_its_output_cannot_be_written(tmp_path: Path) -> None:
    """``drivebus serve plant.toml | head -1``: a text that cannot be written ended the service."""
    file = write(tmp_path)
    reader, writer = os.pipe()
    os.close(reader)
    process = subprocess.Popen([*COMMAND, "serve", str(file)], stdout=writer)
    os.close(writer)
    try:
        while not (tmp_path / "state" / "setup-secret").exists():  # the page is open
            assert process.poll() is None
            time.sleep(0.05)
        assert command("stop", "--all", str(file), "--json").returncode == 0
        process.send_signal(signal.SIGTERM)
        assert process.wait(CHILD_TIMEOUT_S) == 0
    finally:
        process.kill()
        process.wait()


def test_with_json_every_line_of_standard_output_is_json(tmp_path: Path) -> None:
    """The address of the page, which the web process prints, is JSON too."""
    words = [*COMMAND, "serve", str(write(tmp_path)), "--json"]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        assert process.stdout is not None
        plant, page = (json.loads(process.stdout.readline()) for _ in range(2))
    finally:
        process.kill()
        process.communicate()
    assert (plant["plant"], page["page"].startswith("http://127.0.0.1:")) == ("hall", True)


def test_a_killed_web_process_is_started_again_and_the_service_goes_on(tmp_path: Path) -> None:
    file, state = write(tmp_path), tmp_path / "state"
    with running_service(file) as process:
        assert process.stdout is not None
        first = process.stdout.readline()
        assert first.startswith("http://127.0.0.1:")
        (child,) = children(process.pid)
        os.kill(child, signal.SIGKILL)
        client = SocketClient(state / "plant.sock")

        async def scenario() -> None:
            await wait_until_state(client, "fan-1", "stopped")
            await client.close()

        asyncio.run(scenario())
        assert process.stdout.readline().startswith("http://127.0.0.1:")
        (another,) = children(process.pid)
        assert another != child
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=CHILD_TIMEOUT_S)
        assert process.returncode == 0
        assert not Path(f"/proc/{another}").exists()


LONG_END = (
    "from drivebus.service.control import stops; stops.SERVICE_STOP_TIMEOUT_S = 10.0;"
    "from drivebus.__main__ import main; main()"
)
"""The command ``drivebus`` whose service waits ten seconds for the stops at its end."""
C320_WITH_DECELERATION_TIME = """
format = 1
extends = "c320"
[timing]
adapter_latency_s = 0.3
evidence = "user"
[parameters."F0.9"]
text = "deceleration time"
unit = "s"
factor = 0.1
minimum = 0.1
maximum = 6000.0
evidence = "user: the simulated drive"
"""


def test_the_page_can_stop_drives_until_the_stops_of_an_ending_service_are_done(tmp_path: Path) -> None:
    """It was gone at once: for up to three seconds no page could stop a drive that the service leaves running."""
    held = '[drive.fan-2]\nbus = "a"\naddress = 2\nmodel = "./slow_machine_c320.toml"\non_service_stop = "hold"\n'
    file, state = write(tmp_path, held), tmp_path / "state"
    (tmp_path / "slow.toml").write_text(C320_WITH_DECELERATION_TIME)
    file.write_text(file.read_text().replace("./slow_machine_c320.toml", "./slow.toml", 1))
    UserFile(state / "users.json").change(lambda _: user_database())
    with running_service(file, command=[sys.executable, "-c", LONG_END]) as process:
        assert process.stdout is not None
        page = process.stdout.readline().strip() + "/api/v1"

        async def start() -> None:
            client = SocketClient(state / "plant.sock")
            for drive in ("fan-1", "fan-2"):
                await wait_until_state(client, drive, "stopped")
                await client.call("waiver.grant", {"drive": drive, "reason": "test bench"}, ME)
            await client.call(
                "parameters.write", {"drive": "fan-1", "values": {"F0.9": 600.0}}, ME
            )  # deceleration time
            for drive in ("fan-1", "fan-2"):
                await client.call("drive.run", {"drive": drive, "frequency_hz": 10.0}, ME)
                await wait_until_state(client, drive, "running")
            await client.close()

        asyncio.run(start())
        process.send_signal(signal.SIGTERM)
        time.sleep(0.7)  # the web process used to end within this time
        with httpx.Client(
            headers={"Authorization": f"Bearer {token(Role.OPERATOR)}"}, timeout=CHILD_TIMEOUT_S
        ) as browser:
            while browser.get(f"{page}/drives/fan-1").json()["state"] != "decelerating":
                time.sleep(0.05)
            answer = browser.post(f"{page}/drives/fan-2/stop", json={})
        assert (answer.status_code, answer.json()["outcome"]["status"]) == (200, "confirmed")
        _, errors = process.communicate(timeout=CHILD_TIMEOUT_S)
        assert process.returncode == ExitCode.UNKNOWN
    assert f"fan-1: {i18n.text('serve.decelerating', 'en')}" in errors, errors
    trail = [json.loads(line) for line in (state / "audit.jsonl").read_text().splitlines()]
    stops = [entry for entry in trail if entry["what"] == "drive.stop"]
    fan_1, fan_2 = (entry["n"] for entry in stops[:2])
    assert [(entry["target"], entry["outcome"], entry["of"]) for entry in stops] == [
        ("fan-1", "requested", None),
        ("fan-2", "requested", None),
        ("fan-2", "confirmed", fan_2),
        ("fan-1", "decelerating", fan_1),
    ], errors


def children(pid: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def test_stop_all_reports_a_missing_service(tmp_path: Path) -> None:
    found = command("stop", "--all", "--directory", str(tmp_path))
    sentence = i18n.text("stop_all.no_service", "en", socket=socket_path(tmp_path, STOP_SOCKET))
    assert found.returncode == 4 and sentence in " ".join(found.stderr.split())
    assert command("stop", "--all").returncode == 2


def test_stop_all_without_permission_does_not_say_that_no_service_answers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The service may well run; only this user may not open its socket."""

    async def refuse(*args: object, **kwargs: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(asyncio, "open_unix_connection", refuse)
    with pytest.raises(StopUnconfirmed) as raised:
        asyncio.run(stop._request_stop(tmp_path))
    assert raised.value.key == "stop_all.no_permission"
    assert raised.value.params["socket"] == str(socket_path(tmp_path, STOP_SOCKET))


@pytest.mark.parametrize(
    "wrong",
    ["", f"x = {'9' * 5_000}\n", '[drive.x]\nmodel = "c999"\n', "[drive.x\n", 'title = "no end\n', "[plant]\n"],
    ids=range(6),
)
def test_an_error_in_the_file_does_not_prevent_a_stop_of_all_drives(
    wrong: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The stop is also needed while the file is being edited."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    file = write(tmp_path, wrong)
    assert stop._state_folder(str(file), None) == tmp_path / "state"
    file.write_text(f'format = 1\n[plant]\nid = "hall"\n[bus.a]\n{wrong}')
    assert stop._state_folder(str(file), None) == tmp_path / "drivebus" / "plants" / "hall"


@pytest.mark.parametrize(
    "text", ["", "[plant]\nid = 3\n", '[plant]\nid = "No"\n', '[plant]\nid = "a"\ndirectory = 5\n']
)
def test_a_file_that_names_no_plant_is_rejected_with_its_faults(text: str, tmp_path: Path) -> None:
    file = tmp_path / "plant.toml"
    file.write_text(text)
    with pytest.raises(ConfigurationError) as refused:
        stop._state_folder(str(file), None)
    assert refused.value.key == "plant_config.refused"


@pytest.mark.parametrize(
    ("reply", "key"),
    [
        (b"", "stop_all.hangs"),
        (b"received\n", "stop_all.gone"),
        (b'received\n{"outcomes": {}}\n', "stop_all.not_a_result"),
        (b"received\nno JSON\n", "stop_all.not_a_result"),
        (b"received\n[]\n", "stop_all.not_a_result"),
        (b'hello\n{"outcomes": {}, "buses": {}}\n', "stop_all.not_a_result"),
    ],
)
def test_stop_all_reports_an_unknown_outcome_of_a_service_that_hangs_and_of_another_program(
    reply: bytes, key: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A frozen process still has its socket; the answer of another program ended the command with a traceback."""
    monkeypatch.setattr(stop, "STOP_ACCEPT_TIMEOUT_S", 0.2)

    def request_stop() -> None:
        with socket.socket(socket.AF_UNIX) as server:
            server.bind(str(tmp_path / "stop.sock"))
            server.listen()
            threading.Thread(target=answer, args=(server,), daemon=True).start()
            asyncio.run(stop._request_stop(tmp_path))

    def answer(server: socket.socket) -> None:
        if reply:
            with server.accept()[0] as connection:
                connection.recv(100)
                connection.sendall(reply)

    with pytest.raises(StopUnconfirmed) as caught:
        request_stop()
    assert caught.value.key == key and exit_code_of(caught.value) is ExitCode.UNKNOWN


def test_the_setup_secret_is_announced_in_the_language_of_the_command(tmp_path: Path) -> None:
    """The process of the page took the language of the environment and ignored ``--lang``."""
    file = write(tmp_path)
    process = subprocess.Popen(
        [*COMMAND, "serve", str(file), "--lang", "zh"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"DRIVEBUS_LANG": "en", "PYTHONIOENCODING": "utf-8"},
    )
    try:
        assert process.stderr is not None
        announced = next(line for line in process.stderr if "http://127.0.0.1" in line)
        assert announced.endswith("输入此设置密钥：\n")
        secret = (tmp_path / "state" / "setup-secret").read_text(encoding="utf-8").strip()
        assert process.stderr.readline() == f"{secret}\n", "a narrow terminal would break it"
    finally:
        process.terminate()
        process.communicate(timeout=CHILD_TIMEOUT_S)


def test_the_announcement_of_a_setup_secret_that_could_not_be_saved_names_no_file_as_its_place(tmp_path: Path) -> None:
    """On a full disk the announcement named a file that did not exist."""
    (tmp_path / "state" / "setup-secret").mkdir(parents=True)
    (tmp_path / "state").chmod(0o700)
    process = subprocess.Popen(
        [*COMMAND, "serve", str(write(tmp_path)), "--lang", "en"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stderr is not None
        lines = iter(process.stderr)
        announced = next(line for line in lines if "http://127.0.0.1" in line) + next(lines) + next(lines)
        assert "It is also in" not in announced and "only here: " in announced and "can't be written: " in announced
    finally:
        process.terminate()
        process.communicate(timeout=CHILD_TIMEOUT_S)
