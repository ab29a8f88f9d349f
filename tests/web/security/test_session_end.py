"""A user who loses the right to control while controlling drives: it ends at once, and the audit trail says why."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from httpx import AsyncClient

from drivebus.service.audit.description import described
from drivebus.service.audit.records import SESSION_ENDED
from drivebus.service.auth.users import UserFile
from drivebus.service.config.model import OnClientLost
from drivebus.testing.virtual_time import run
from drivebus.types import Json
from drivebus.values import bilingual_text
from fixtures.rest_api import FakeService
from fixtures.service import ServiceKit, plant_config, running_service
from fixtures.web_app import WebAppHarness

JOG_LEASE_S = 0.5  # a jog ends this long after its last renewal
AT_ONCE_S = 1.0
"""Less than the time of a lease, and enough for a stop of the simulated drive to be requested."""


def on_a_plant(directory: Path, scenario: Callable[[ServiceKit, WebAppHarness], Awaitable[None]]) -> None:
    async def whole() -> None:
        found = plant_config()
        drives = [
            replace(drive, on_client_lost=OnClientLost.STOP) if drive.id == "fan-1" else drive for drive in found.drives
        ]
        async with running_service(replace(found, drives=tuple(drives))) as kit:
            harness = WebAppHarness(directory, service=kit.service)
            await asyncio.sleep(5)
            await kit.grant_waivers()
            await scenario(kit, harness)

    run(whole())


async def start(client: AsyncClient, drive: str, action: str = "run") -> Any:
    assert (await client.post(f"/api/v1/drives/{drive}/lease")).status_code == 200
    arm = (await client.post(f"/api/v1/drives/{drive}/arm")).json()["arm_token"]
    answer = await client.post(f"/api/v1/drives/{drive}/{action}", json={"frequency_hz": 5.0, "arm_token": arm})
    assert answer.status_code == 200, answer.text
    return answer.json()


def ended_records(kit: ServiceKit) -> list[Any]:
    return [entry for entry in kit.trail.entries if entry.what == SESSION_ENDED]


def test_a_removed_user_loses_control_at_once_and_each_drive_does_what_its_policy_says(tmp_path: Path) -> None:
    """The drives ran on under a removed user's control for up to ten seconds."""

    async def scenario(kit: ServiceKit, harness: WebAppHarness) -> None:
        user, chief = await harness.log_in("operator"), await harness.log_in("administrator")
        for drive in ("fan-1", "fan-2"):
            await start(user, drive)
        assert (await chief.delete("/api/v1/users/operator")).status_code == 200
        await asyncio.sleep(AT_ONCE_S)
        plant = kit.service.plant
        assert [plant.leases.get(drive, plant.now()) for drive in ("fan-1", "fan-2")] == [None, None]
        reason = bilingual_text("plant.session_ended.removed")
        ended = kit.drives_of_events("plant.lease_ended_with_session", owner="operator", reason=reason)
        assert (ended, kit.drives_of_events("plant.lease_lost", owner="operator")) == (["fan-1", "fan-2"], [])
        assert kit.drives_of_events("plant.stopped_client_lost", owner="operator") == ["fan-1"]
        assert {alarm.kind: alarm.drive for alarm in plant.alarms.active()} == {"control_lost": "fan-2"}
        (record,) = ended_records(kit)
        assert (record.who, record.params["drives"]) == ("operator", ["fan-1", "fan-2"])
        text = described({"what": record.what, "who": {"name": record.who}, "target": "", "params": record.params})
        assert "user removed" in text["text"]["en"]

    on_a_plant(tmp_path, scenario)


@pytest.mark.parametrize("drive", ["fan-1", "fan-2"], ids=["stop", "hold"])
def test_a_jog_of_a_disabled_user_is_stopped_at_once(tmp_path: Path, drive: str) -> None:
    async def scenario(kit: ServiceKit, harness: WebAppHarness) -> None:
        user, chief = await harness.log_in("operator"), await harness.log_in("administrator")
        await start(user, drive, "jog")
        answer = await chief.patch("/api/v1/users/operator", json={"disabled": True})
        assert answer.status_code == 200, answer.text
        await asyncio.sleep(JOG_LEASE_S / 2)
        assert kit.drives_of_events("plant.jog_ended_with_session") == [drive], "without waiting for its renewal"
        assert kit.service.plant.alarms.active() == [], "its motor is being stopped"
        assert not kit.drives_of_events("plant.stopped_client_lost"), "one stop is enough"
        assert kit.service.plant.drives[drive].last_stop is not None

    on_a_plant(tmp_path, scenario)


def test_a_withdrawn_token_loses_control_at_once_and_another_session_keeps_its_own(tmp_path: Path) -> None:
    async def scenario(kit: ServiceKit, harness: WebAppHarness) -> None:
        secret = await harness.token("operator", "view", "stop", "operate")
        await start(harness.client(authorization=f"Bearer {secret}"), "fan-1")
        chief, idle = await harness.log_in("administrator"), await harness.log_in("operator")
        await start(chief, "fan-2")
        await idle.post("/api/v1/logout")
        harness.auth.user_file.change(lambda found: found.without_token(found.tokens[0].id))
        await asyncio.sleep(AT_ONCE_S)
        assert kit.drives_of_events("plant.stopped_client_lost", owner="operator/t") == ["fan-1"]
        plant = kit.service.plant
        assert plant.leases.get("fan-2", plant.now()) is not None
        assert [entry.who for entry in ended_records(kit)] == ["operator/t"], (
            "a session without control leaves no record"
        )

    on_a_plant(tmp_path, scenario)


def test_a_token_that_loses_one_right_after_the_other_controls_drives_until_it_loses_that_right(tmp_path: Path) -> None:
    async def scenario(kit: ServiceKit, harness: WebAppHarness) -> None:
        secret = await harness.token("engineer", "view", "stop", "operate", "write_parameters")
        await start(harness.client(authorization=f"Bearer {secret}"), "fan-1")
        chief = await harness.log_in("administrator")
        plant, roles = kit.service.plant, {}
        for role in ("operator", "viewer"):
            assert (await chief.patch("/api/v1/users/engineer", json={"role": role})).status_code == 200
            await asyncio.sleep(AT_ONCE_S)
            roles[role] = plant.leases.get("fan-1", plant.now()) is not None
        assert roles == {"operator": True, "viewer": False}
        assert kit.drives_of_events("plant.stopped_client_lost", owner="engineer/t") == ["fan-1"]
        assert [entry.who for entry in ended_records(kit)] == ["engineer/t"]

    on_a_plant(tmp_path, scenario)


DAMAGED_USERS = [b"", b"{ oops", b"[]", b'{"users": [{"name": 5}]}', b"[" * 100_000, b"\xff", None]


@pytest.mark.parametrize("damaged", DAMAGED_USERS, ids=lambda data: str(data)[:20])
def test_a_users_file_that_is_damaged_for_a_while_does_not_end_the_watch_of_sessions(
    tmp_path: Path, damaged: bytes | None
) -> None:
    """Once it is repaired, a user who is no longer in it loses control at once, without any request."""

    async def scenario(kit: ServiceKit, harness: WebAppHarness) -> None:
        user = await harness.log_in("operator")
        await start(user, "fan-1")
        file, plant = harness.auth.user_file, kit.service.plant
        repaired = file.read().without_user("operator")
        file.path.unlink()
        if damaged is not None:
            file.path.write_bytes(damaged)
        await asyncio.sleep(3)
        assert plant.leases.get("fan-1", plant.now()) is not None, "the users of before stay in force"
        file.path.unlink(missing_ok=True)
        UserFile(file.path).change(lambda _: repaired)
        await asyncio.sleep(AT_ONCE_S)
        assert plant.leases.get("fan-1", plant.now()) is None
        assert [entry.who for entry in ended_records(kit)] == ["operator"]

    on_a_plant(tmp_path, scenario)


def test_the_download_of_a_removed_user_ends_with_the_next_part(tmp_path: Path) -> None:
    """A user who read it slowly got the history for as long as that took, also what was added to it meanwhile."""

    async def scenario() -> None:
        def next_part(params: Json) -> Json:
            number = int(params.get("cursor", 0))
            if number == 1:
                harness.auth.user_file.change(lambda database: database.without_user("viewer"))
            return {"file": "x.csv", "text": f"part {number}\n", "next": str(number + 1) if number < 3 else None}

        plant = FakeService(**{"history.export": next_part})
        harness = WebAppHarness(tmp_path, service=plant)
        viewer = await harness.log_in("viewer")
        answer = await viewer.get("/api/v1/history/export?tags=a&from_ms=0&to_ms=9")
        assert answer.text == "part 0\npart 1\n"

    run(scenario())
