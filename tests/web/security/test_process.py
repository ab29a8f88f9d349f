"""The web process, ``python -m drivebus.web``, while the service runs, is down, and returns."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest

from drivebus import i18n
from drivebus.service.app import Service
from drivebus.service.auth.setup_secret import SETUP_SECRET_FILE
from drivebus.service.auth.users import UserFile
from drivebus.service.ipc.server import SocketServer
from drivebus.service.process.gateway_arguments import GatewayArguments, encode_arguments
from drivebus.simulator.port import clear_simulated_buses
from drivebus.web.gateway import WebConfig
from fixtures.service import fake_storage, plant_config
from fixtures.web_app import PASSWORD, USERS

TIMEOUT_S = 30.0


@contextmanager
def web(directory: Path, parent: bool = False) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Run the web process; yields it and its address. ``parent``: yields a parent of it that can be killed."""
    settings = WebConfig(port=0)
    arguments = GatewayArguments(
        socket=directory / "plant.sock", directory=directory, user_file=directory / "users.json", settings=settings
    )
    line = encode_arguments(arguments).decode()
    command = [sys.executable, "-m", "drivebus.web"]
    if parent:
        code = (
            "import subprocess, sys; child = subprocess.Popen(sys.argv[1:], stdin=subprocess.PIPE, text=True);"
            "child.stdin.write(sys.stdin.readline()); child.stdin.flush(); child.wait()"
        )
        command = [sys.executable, "-c", code, *command]
    process = subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "DRIVEBUS_LANG": "en"},
    )
    assert process.stdin is not None and process.stdout is not None
    process.stdin.write(line)
    process.stdin.flush()
    try:
        yield process, process.stdout.readline().strip()
    finally:
        process.kill()
        process.communicate()


async def response_of(client: httpx.AsyncClient, method: str, path: str, status: int, **more: Any) -> httpx.Response:
    """Repeat a request until its answer has this status."""
    async with asyncio.timeout(TIMEOUT_S):
        while (answer := await client.request(method, path, **more)).status_code != status:  # noqa: ASYNC110
            await asyncio.sleep(0.1)
    return answer


async def test_sessions_survive_a_restart_of_the_plant(tmp_path: Path) -> None:
    """Without the plant a read is a clear 503 and logging in works; with it the drives are back without a login."""
    with web(tmp_path) as (process, at):
        async with httpx.AsyncClient(base_url=at) as client:
            secret = (tmp_path / SETUP_SECRET_FILE).read_text().strip()
            body = {"secret": secret, "name": "ann", "password": PASSWORD}
            done = await client.post("/api/v1/setup", json=body)
            assert done.status_code == 200, done.text
            client.headers["X-Drivebus-CSRF"] = done.json()["csrf"]
            for method, path in (("GET", "/api/v1/drives"), ("POST", "/api/v1/stop")):
                away = await client.request(method, path)
                assert (away.status_code, away.json()["error"]["kind"]) == (503, "ServiceUnavailable")
            for _ in range(2):
                async with Service(plant_config(), fake_storage()) as service:
                    server = SocketServer(service, tmp_path / "plant.sock")
                    await server.open()
                    there = await response_of(client, "GET", "/api/v1/drives", 200)
                    assert [drive["id"] for drive in there.json()["drives"]][:2] == ["fan-1", "fan-2"]
                    assert (await client.post("/api/v1/stop")).status_code in (200, 504)
                    await server.close()
                clear_simulated_buses()
                await response_of(client, "GET", "/api/v1/drives", 503)
        process.send_signal(signal.SIGTERM)
        assert await asyncio.to_thread(process.wait, TIMEOUT_S) == 0
        assert process.stderr is not None
        reply_text = process.stderr.read()
        assert secret in reply_text and "Traceback" not in reply_text


async def test_a_session_and_the_users_survive_a_kill_of_the_web_process(tmp_path: Path) -> None:
    with web(tmp_path) as (process, at):
        async with httpx.AsyncClient(base_url=at) as client:
            secret = (tmp_path / SETUP_SECRET_FILE).read_text().strip()
            done = await client.post("/api/v1/setup", json={"secret": secret, "name": "ann", "password": PASSWORD})
            cookies, csrf = dict(client.cookies), done.json()["csrf"]
        process.kill()
        process.wait()
    with web(tmp_path) as (_, at):
        async with httpx.AsyncClient(base_url=at, cookies=cookies) as client:
            answer = (await client.get("/api/v1/session")).json()
            assert (answer["user"], answer["csrf"], answer["setup"]) == ("ann", csrf, False)
    assert not (tmp_path / SETUP_SECRET_FILE).exists()


async def test_a_web_process_that_finds_no_users_in_a_plant_that_had_some_prints_no_secret(tmp_path: Path) -> None:
    """The users were added on the command line, and no login followed."""
    file = UserFile(tmp_path / "users.json")
    file.change(lambda _: USERS)
    with web(tmp_path):
        pass
    file.path.unlink()
    with web(tmp_path) as (process, at):
        async with httpx.AsyncClient(base_url=at) as client:
            assert (await client.get("/api/v1/session")).json()["users_missing"]
        process.send_signal(signal.SIGTERM)
        assert await asyncio.to_thread(process.wait, TIMEOUT_S) == 0
        assert process.stderr is not None
        assert i18n.text("auth.users_missing", "en", file=str(file.path)) in process.stderr.read()
    assert not (tmp_path / SETUP_SECRET_FILE).exists()


async def test_the_web_process_ends_when_its_parent_is_killed(tmp_path: Path) -> None:
    """A restarted plant starts its own web process at the same address."""
    with web(tmp_path, parent=True) as (process, at):
        async with httpx.AsyncClient(base_url=at) as client:
            answer = await client.get("/api/v1/health")
            assert (answer.status_code, answer.json()) == (503, {"ok": False})  # there is no service
            process.kill()
            with pytest.raises(httpx.TransportError):
                async with asyncio.timeout(TIMEOUT_S):
                    while True:
                        await client.get("/api/v1/health")
                        await asyncio.sleep(0.1)


@pytest.mark.parametrize("line", ["", "a b\n"])
def test_wrong_arguments_end_with_exit_code_2(line: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "drivebus.web"], input=line, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2 and "Traceback" not in done.stderr
