"""The service as a process: single instance, systemd notification, orderly end, killed web process."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from drivebus.cli.commands import stop
from drivebus.cli.errors import ExitCode, exit_code_of
from drivebus.errors import ConfigurationError, StopUnconfirmed
from drivebus.service.auth.actor import local_actor
from drivebus.service.ipc.client import SocketClient

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
link = "sim://c320@1,2?ramp=0.5"
[drive.fan-1]
bus = "a"
address = 1
model = "c320"
"""
SECOND = '[drive.fan-2]\nbus = "a"\naddress = 2\nmodel = "c320"\n'
ME = local_actor("tester", "t-1")


def write(tmp_path: Path, *more: str) -> Path:
    file = tmp_path / "plant.toml"
    file.write_text(PLANT.format(directory=tmp_path / "state") + "".join(more))
    return file


@contextmanager
def served(file: Path, *words: str, **environment: str) -> Iterator[subprocess.Popen[str]]:
    """A plant that is ready."""
    process = subprocess.Popen(
        [*COMMAND, "serve", str(file), *words],
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


def verb(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*COMMAND, *words], capture_output=True, text=True, check=False)


async def seen(client: SocketClient, drive: str) -> dict[str, Any]:
    """The drive once it answers."""
    while True:
        found = {view["id"]: view for view in (await client.call("drives.list", {}, ME))["drives"]}
        if found.get(drive, {}).get("state") == "stopped":
            return found[drive]
        await asyncio.sleep(0.1)


def test_one_plant_runs_once_takes_over_its_file_and_ends_with_its_motors_stopped(tmp_path: Path) -> None:
    """``Type=notify``; SIGHUP; SIGTERM stops what was started, in order."""
    file, state = write(tmp_path), tmp_path / "state"
    manager = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    manager.bind(str(tmp_path / "notify"))
    manager.settimeout(20)
    asked = {"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "1000000"}
    with served(file, "--without", "web", "--log", "json", **asked) as process:
        text = [manager.recv(100).decode() for _ in range(3)]
        assert "READY=1" in text and "WATCHDOG=1" in text
        second = verb("serve", str(file), "--without", "web")
        assert second.returncode == 2 and "already uses" in second.stderr

        async def story() -> None:
            client = SocketClient(state / "plant.sock")
            await seen(client, "fan-1")
            write(tmp_path, SECOND)
            process.send_signal(signal.SIGHUP)
            await seen(client, "fan-2")
            for drive in ("fan-1", "fan-2"):
                await client.call("waiver.grant", {"drive": drive, "reason": "test bench"}, ME)
            await client.call("drive.run", {"drive": "fan-1", "frequency_hz": 20.0}, ME)
            stopped = await asyncio.to_thread(verb, "stop", "--all", str(file), "--json")
            assert stopped.returncode == 0, stopped
            assert json.loads(stopped.stdout)["buses"]["a"]["confirmed"] is True
            await client.call("start_inhibit.release", {"drive": "fan-2"}, ME)
            await client.call("drive.run", {"drive": "fan-2", "frequency_hz": 20.0}, ME)
            await client.close()

        asyncio.run(story())  # meanwhile the manager's queue is full: no bus waits for it
        manager.setblocking(False)
        with suppress(BlockingIOError):
            while True:
                manager.recv(100)
        process.send_signal(signal.SIGTERM)
        _, errors = process.communicate(timeout=20)
        assert process.returncode == 0
    while manager.recv(100) != b"STOPPING=1":
        pass
    manager.close()
    log = [json.loads(line) for line in errors.splitlines()]
    assert [one["outcome"] for one in log if one.get("kind") == "stop" and one.get("drive") == "fan-2"] == ["confirmed"]
    trail = [json.loads(line) for line in (state / "audit.jsonl").read_text().splitlines()]
    assert "drive.run" in {entry["what"] for entry in trail}
    assert not [name for name in state.iterdir() if name.suffix == ".sock"]


def test_a_plant_whose_terminal_is_closed_ends_and_does_not_read_its_file_again(tmp_path: Path) -> None:
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
        assert process.wait(20) == 0
    finally:
        process.kill()
        process.wait()
    assert not [one for one in (tmp_path / "state").iterdir() if one.suffix == ".sock"]


def test_every_line_of_a_plant_that_was_asked_for_json_is_json(tmp_path: Path) -> None:
    """The page's address too, which its own process tells."""
    words = [*COMMAND, "serve", str(write(tmp_path)), "--json"]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        assert process.stdout is not None
        plant, page = (json.loads(process.stdout.readline()) for _ in range(2))
    finally:
        process.kill()
        process.communicate()
    assert (plant["plant"], page["page"].startswith("http://127.0.0.1:")) == ("hall", True)


def test_a_killed_web_part_leaves_the_plant_going_and_comes_back(tmp_path: Path) -> None:
    """Kill -9 of the web process."""
    file, state = write(tmp_path), tmp_path / "state"
    with served(file) as process:
        assert process.stdout is not None
        first = process.stdout.readline()
        assert first.startswith("http://127.0.0.1:")
        (child,) = children(process.pid)
        os.kill(child, signal.SIGKILL)
        client = SocketClient(state / "plant.sock")

        async def story() -> None:
            await seen(client, "fan-1")
            await client.close()

        asyncio.run(story())
        assert process.stdout.readline().startswith("http://127.0.0.1:")
        (another,) = children(process.pid)
        assert another != child
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=20)
        assert process.returncode == 0
        assert not Path(f"/proc/{another}").exists()


def children(pid: int) -> list[int]:
    return [int(one) for one in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def test_stop_all_says_when_no_plant_answers(tmp_path: Path) -> None:
    found = verb("stop", "--all", "--directory", str(tmp_path))
    assert found.returncode == 1 and "nothing was stopped" in found.stderr
    assert verb("stop", "--all").returncode == 2


@pytest.mark.parametrize(
    "wrong", ["", '[drive.x]\nmodel = "c999"\n', "[drive.x\n", 'title = "no end\n', "[plant]\n"], ids=range(5)
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
def test_a_file_that_names_no_plant_is_refused_with_its_mistakes(text: str, tmp_path: Path) -> None:
    file = tmp_path / "plant.toml"
    file.write_text(text)
    with pytest.raises(ConfigurationError) as refused:
        stop._state_folder(str(file), None)
    assert refused.value.key == "plant_config.refused"


@pytest.mark.parametrize(("says", "key"), [(b"", "stop_all.hangs"), (b"received\n", "stop_all.gone")])
def test_stop_all_never_waits_for_a_plant_that_hangs_and_calls_nothing_stopped(
    says: bytes, key: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Frozen, it still has its socket, and the kernel takes the word for it."""
    monkeypatch.setattr(stop, "STOP_ACCEPT_TIMEOUT_S", 0.2)

    def asked() -> None:
        with socket.socket(socket.AF_UNIX) as door:
            door.bind(str(tmp_path / "stop.sock"))
            door.listen()
            threading.Thread(target=answered, args=(door,), daemon=True).start()
            asyncio.run(stop._request_stop(tmp_path))

    def answered(door: socket.socket) -> None:
        if says:
            with door.accept()[0] as one:
                one.recv(100)
                one.sendall(says)

    with pytest.raises(StopUnconfirmed) as caught:
        asked()
    assert caught.value.key == key and exit_code_of(caught.value) is ExitCode.UNKNOWN
