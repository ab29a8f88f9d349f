"""Changes of the user database from the command line: recorded by a running service, else in the trail itself."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest

from drivebus.errors import ConfigurationError, ServiceUnavailable
from drivebus.service.audit import AuditEntry, AuditTrail
from drivebus.service.auth.actor import local_user
from drivebus.service.auth.admin import change_users, user_file_of
from drivebus.service.auth.errors import Conflict
from drivebus.service.auth.users import UserDatabase
from drivebus.service.config.model import AuditConfig, PlantConfig
from drivebus.service.ipc.protocol import SERVICE_SOCKET
from drivebus.service.ipc.server import SocketServer
from drivebus.service.process.lock import single_instance
from fixtures.audit import problem_kinds, verify_report
from fixtures.auth import auth_service
from fixtures.service import plant_config
from fixtures.web_app import CountingService

REMOVAL: dict[str, Any] = {"what": "user.remove", "target": "operator", "params": {"why": "left"}}
REJECTED_REMOVAL = REMOVAL | {"target": "administrator"}


async def remove_user(config: PlantConfig, name: str = "operator") -> UserDatabase:
    return await change_users(
        config, "user.remove", name, {"why": "left"}, lambda database: database.without_user(name)
    )


def removal_records(directory: Path) -> list[dict[str, Any]]:
    records = map(json.loads, (directory / "audit.jsonl").read_text().splitlines())
    return [record for record in records if record["what"] == "user.remove"]


async def test_without_a_service_the_trail_records_each_change(tmp_path: Path) -> None:
    config = plant_config(directory=tmp_path)
    auth_service(tmp_path)
    after = await remove_user(config)
    assert after == user_file_of(config).read() and after.find("operator") is None
    with pytest.raises(Conflict):
        await remove_user(config, "administrator")
    records = removal_records(tmp_path)
    assert [{name: record[name] for name in ("what", "target", "params", "outcome")} for record in records] == [
        REMOVAL | {"outcome": "requested"},
        REMOVAL | {"outcome": "done"},
        REJECTED_REMOVAL | {"outcome": "requested"},
        REJECTED_REMOVAL | {"outcome": "auth.last_administrator"},
    ]
    who = {"name": local_user(), "session": "command-line", "address": "local"}
    assert [record["who"] for record in records] == [who] * 4
    checkpoints = (tmp_path / "checkpoints.jsonl").read_text().splitlines()
    assert len(checkpoints) == 4, "two of each command: one for the records found, one for its own"
    with single_instance(tmp_path):
        pass


async def test_without_a_service_the_configured_checkpoints_and_key_cover_a_change(tmp_path: Path) -> None:
    state, elsewhere = tmp_path / "state", tmp_path / "elsewhere"
    state.mkdir()
    elsewhere.mkdir()
    auth_service(state)
    audit = AuditConfig(checkpoints=elsewhere / "checkpoints.jsonl", key=elsewhere / "audit.key")
    config = plant_config(directory=state, audit=audit)
    trail = AuditTrail.of(config)
    await trail.open()
    await trail.record(AuditEntry(what="drive.run", target="fan-1"))
    await trail.close()
    await remove_user(config)
    report = verify_report(trail)
    assert problem_kinds(trail) == []
    assert report.keyed and report.covered == report.entries == 5
    last = json.loads((elsewhere / "checkpoints.jsonl").read_text().splitlines()[-1])
    assert last["n"] == removal_records(state)[-1]["n"]
    assert not (state / "checkpoints.jsonl").exists() and not (tmp_path / "state.audit.key").exists()


async def test_a_running_service_records_the_change(tmp_path: Path) -> None:
    auth_service(tmp_path)
    service = CountingService()
    server = SocketServer(service, tmp_path / SERVICE_SOCKET)
    with single_instance(tmp_path):
        await server.open()
        assert (await remove_user(plant_config(directory=tmp_path))).find("operator") is None
        async with asyncio.timeout(60):
            while server._connections:  # noqa: ASYNC110  asyncio.timeout ends it
                await asyncio.sleep(0.001)
        await server.close()
    requested, done = REMOVAL | {"outcome": "requested"}, REMOVAL | {"outcome": "done"}
    assert [entry for entry, _ in service.records] == [requested, done]
    assert {(actor.name, actor.session, actor.remote) for _, actor in service.records} == {
        (local_user(), "command-line", False),
    }
    assert not (tmp_path / "audit.jsonl").exists()


@pytest.mark.parametrize("socket_is_open", [True, False], ids=["audit fails", "no socket"])
async def test_nothing_is_changed_without_an_audit_record(socket_is_open: bool, tmp_path: Path) -> None:
    auth, _ = auth_service(tmp_path)
    server = SocketServer(CountingService(audit_fails=True), tmp_path / SERVICE_SOCKET)
    with single_instance(tmp_path):
        if socket_is_open:
            await server.open()
        with pytest.raises(ServiceUnavailable):
            await remove_user(plant_config(directory=tmp_path))
        await server.close()
    assert auth.database.find("operator") is not None


async def test_a_directory_that_can_not_be_used_is_named(tmp_path: Path) -> None:
    (tmp_path / "state").touch()
    with pytest.raises(ConfigurationError) as rejected:
        await remove_user(plant_config(directory=tmp_path / "state"))
    assert rejected.value.key == "plant.directory"


async def test_a_change_whose_second_audit_record_fails_is_reported_as_done(tmp_path: Path) -> None:
    """The disk became full with the change: the command failed as if nothing had been changed."""

    class FullAfterOne(CountingService):
        async def record(self, entry: dict[str, Any], actor: Any) -> None:
            self.audit_fails = bool(self.records)
            await super().record(entry, actor)

    for name, error in (("operator", None), ("administrator", Conflict)):
        auth_service(tmp_path / name)
        server = SocketServer(FullAfterOne(), tmp_path / name / SERVICE_SOCKET)
        with single_instance(tmp_path / name):
            await server.open()
            try:
                change = remove_user(plant_config(directory=tmp_path / name), name)
                if error is None:
                    assert (await change).find(name) is None
                else:
                    with pytest.raises(error):
                        await change
            finally:
                await server.close()
