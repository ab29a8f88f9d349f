"""Release and waivers of several drives at once: a result for each, and the same rules as for one."""

from __future__ import annotations

import asyncio

import pytest

from drivebus.errors import DrivebusError, Superseded
from drivebus.service.auth.rights import Role
from drivebus.testing.virtual_time import run
from drivebus.values import Text
from fixtures.service import FakeAuditTrail, ServiceKit, remote_actor, running_service

ANN, BOB = remote_actor("ann"), remote_actor("bob")
ENGINEER = remote_actor("eve", Role.ENGINEER)


def inhibited(kit: ServiceKit) -> set[str]:
    drives = kit.service.plant.drives.values()
    return {runtime.id for runtime in drives if runtime.bus.start_inhibited(runtime.config.address)}


def test_all_drives_are_released_at_once_but_those_of_another_user() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(2)
            await kit.call("plant.stop")
            await kit.call("lease.take", BOB, drive="fan-2")
            found = (await kit.call("start_inhibits.release", ANN, all=True))["outcomes"]
            assert found.pop("fan-2")["code"] == "plant.not_owner"
            assert found == {id: {"status": "done"} for id in ("fan-1", "pump-1", "pump-2")}
            assert inhibited(kit) == {"fan-2"}
            view = await kit.call("drives.get", drive="fan-1")
            assert view["lease"] is None, "the lease was only taken for the release"
            engineer = (await kit.call("start_inhibits.release", ENGINEER, all=True))["outcomes"]
            assert engineer["fan-2"]["code"] == "plant.not_owner", "a release takes control from no other user"
            again = (await kit.call("start_inhibits.release", BOB, group="fans"))["outcomes"]
            assert again == {"fan-1": {"status": "unchanged"}, "fan-2": {"status": "done"}}
            assert (await kit.call("drives.get", drive="fan-2"))["lease"]["owner"] == "bob"

    run(scenario())


def test_a_stop_during_the_release_of_several_drives_keeps_all_of_them_inhibited() -> None:
    async def scenario() -> None:
        trail = FakeAuditTrail()
        async with running_service(trail=trail) as kit:
            await asyncio.sleep(2)
            await kit.call("plant.stop")
            trail.delay_s = 0.5
            release = asyncio.create_task(kit.call("start_inhibits.release", ANN, drives=["fan-1", "pump-1"]))
            await asyncio.sleep(0.1)
            await kit.call("plant.stop")
            with pytest.raises(Superseded):
                await release
            assert len(inhibited(kit)) == 4

    run(scenario())


def test_waivers_of_a_selection_leave_drives_alone_that_need_none_or_have_one() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(2)
            await kit.call("waiver.grant", drive="fan-1", reason="its own")
            trips = kit.service.plant.drives["pump-1"]
            trips.comm_loss.last_read = type(trips.comm_loss.last_read)(kind="trips", after_s=1.0, text=Text("", ""))
            found = (await kit.call("waivers.grant", ENGINEER, all=True, reason="hard-wired stop"))["outcomes"]
            done = {id for id, outcome in found.items() if outcome["status"] == "done"}
            assert done == {"fan-2", "pump-2"} and found["fan-1"] == {"status": "unchanged"}
            waivers = {runtime.id: runtime.comm_loss.waiver for runtime in kit.service.plant.drives.values()}
            assert waivers == {
                "fan-1": "its own (tester)",
                "fan-2": "hard-wired stop (eve)",
                "pump-1": None,
                "pump-2": "hard-wired stop (eve)",
            }
            (entry, *_) = (entry for entry in kit.trail.entries if entry.what == "waivers.grant")
            assert entry.params["drives"] == ["fan-1", "fan-2", "pump-1", "pump-2"], "the record names each drive"

    run(scenario())


def test_an_empty_selection_and_an_unknown_drive_change_nothing() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            with pytest.raises(DrivebusError, match="no drive is selected"):
                await kit.call("waivers.grant", reason="because")
            with pytest.raises(DrivebusError, match="no drive fan-9"):
                await kit.call("waivers.grant", drives=["fan-1", "fan-9"], reason="because")
            with pytest.raises(DrivebusError) as denied:
                await kit.call("waivers.grant", ANN, all=True, reason="because")
            assert denied.value.key == "plant.forbidden"
            assert kit.service.plant.drives["fan-1"].comm_loss.waiver is None

    run(scenario())
