"""Changing the register from the command line: recorded by the plant where it runs, else in its trail."""

from __future__ import annotations

import asyncio
import getpass
import json
from pathlib import Path
from typing import Any

import pytest

from drivebus.errors import ConfigurationError
from drivebus.service.auth.admin import change_users, user_file_of
from drivebus.service.auth.errors import Conflict
from drivebus.service.auth.users import UserDatabase
from drivebus.service.ipc.protocol import SERVICE_SOCKET
from drivebus.service.ipc.server import SocketServer
from drivebus.service.process.lock import single_instance
from fixtures.auth import auth_service
from fixtures.service import plant_config
from fixtures.web_app import CountingService

ASKED: dict[str, Any] = {"what": "user.remove", "target": "operator", "params": {"why": "left"}}
REFUSED = ASKED | {"target": "administrator"}


async def removed(directory: Path, name: str = "operator") -> UserDatabase:
    chosen = plant_config(directory=directory)
    return await change_users(
        chosen, "user.remove", name, {"why": "left"}, lambda register: register.without_user(name)
    )


def records(directory: Path) -> list[dict[str, Any]]:
    lines = map(json.loads, (directory / "audit.jsonl").read_text().splitlines())
    return [one for one in lines if one["what"] == "user.remove"]


async def test_without_a_plant_it_stands_in_the_trail_who_changed_what(tmp_path: Path) -> None:
    auth_service(tmp_path)
    after = await removed(tmp_path)
    assert after == user_file_of(plant_config(directory=tmp_path)).read() and after.find("operator") is None
    with pytest.raises(Conflict):
        await removed(tmp_path, "administrator")
    message = [{name: one[name] for name in ("what", "target", "params", "outcome")} for one in records(tmp_path)]
    assert message == [
        ASKED | {"outcome": "requested"},
        ASKED | {"outcome": "done"},
        REFUSED | {"outcome": "requested"},
        REFUSED | {"outcome": "auth.last_administrator"},
    ]
    who = {"name": getpass.getuser(), "session": "command-line", "address": "local"}
    assert [one["who"] for one in records(tmp_path)] == [who] * 4
    marks = (tmp_path / "checkpoints.jsonl").read_text().splitlines()
    assert len(marks) == 4, "each time what was found and what was written is vouched for"
    with single_instance(tmp_path):
        pass


async def test_the_plant_itself_records_it_where_it_runs(tmp_path: Path) -> None:
    auth_service(tmp_path)
    plant = CountingService()
    server = SocketServer(plant, tmp_path / SERVICE_SOCKET)
    with single_instance(tmp_path):
        await server.open()
        assert (await removed(tmp_path)).find("operator") is None
        async with asyncio.timeout(2):
            while server._connections:  # noqa: ASYNC110  asyncio.timeout ends it
                await asyncio.sleep(0.001)
        await server.close()
    assert [entry for entry, _ in plant.records] == [ASKED | {"outcome": "requested"}, ASKED | {"outcome": "done"}]
    assert {(who.name, who.session, who.remote) for _, who in plant.records} == {
        (getpass.getuser(), "command-line", False),
    }
    assert not (tmp_path / "audit.jsonl").exists()


@pytest.mark.parametrize("how", ["deaf", "hung up"])
async def test_nothing_is_changed_without_an_audit_record(how: str, tmp_path: Path) -> None:
    access, _ = auth_service(tmp_path)
    server = SocketServer(CountingService(audit_fails=True), tmp_path / SERVICE_SOCKET)
    with single_instance(tmp_path):
        if how == "deaf":
            await server.open()
        with pytest.raises(Exception, match=r"plant|went wrong|answer"):
            await removed(tmp_path)
        await server.close()
    assert access.database.find("operator") is not None


async def test_a_directory_that_can_not_be_used_is_named(tmp_path: Path) -> None:
    (tmp_path / "state").touch()
    with pytest.raises(ConfigurationError) as refused:
        await removed(tmp_path / "state")
    assert refused.value.key == "plant.directory"
