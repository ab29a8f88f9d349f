"""Whose frequency changes with another's: followers of a leader, and who may change both."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest

from drivebus.errors import ControlNotHeld, Superseded
from drivebus.service.auth.actor import Actor
from drivebus.service.auth.rights import Role
from drivebus.service.config.model import GroupConfig
from drivebus.testing.virtual_time import run
from fixtures.service import Json, ServiceKit, plant_config, remote_actor, running_service

GROUP = GroupConfig("fans", ("fan-1", "fan-2"), leader="fan-1", ratios={"fan-2": 0.5})
LED = plant_config(groups=(GROUP,))
ANN, BOB = remote_actor("ann"), remote_actor("bob")


async def running(kit: ServiceKit, *owners: tuple[str, Actor]) -> None:
    """Both fans run, started by somebody at the plant; then these take over."""
    await asyncio.sleep(2)
    await kit.grant_waivers()
    await kit.call("group.start", group="fans", frequency_hz=20.0)
    for drive in GROUP.drives:
        await kit.call("lease.release", drive=drive)
    for drive, owner in owners:
        await kit.call("lease.take", owner, drive=drive)


def targets(kit: ServiceKit) -> list[float]:
    return [kit.station(drive).motor.target_hz for drive in GROUP.drives]


async def asked(kit: ServiceKit, operation: str) -> None:
    """The leader gets 30 Hz from Ann, who owns it."""
    arm = (await kit.call("drive.arm", ANN, drive="fan-1"))["arm_token"] if operation == "drive.run" else None
    given = {} if arm is None else {"arm_token": arm}
    found = await kit.call(operation, ANN, drive="fan-1", frequency_hz=30.0, **given)
    assert found["followers"]["fan-2"]["status"] == "acknowledged"


@pytest.mark.parametrize("operation", ["drive.set_frequency", "drive.run"])
@pytest.mark.parametrize("owner", [BOB, None], ids=["another", "nobody"])
def test_a_follower_that_one_does_not_own_keeps_its_leader_at_its_frequency_too(
    operation: str, owner: Actor | None
) -> None:
    """Refused before any frame; whoever owns both may."""

    async def story() -> None:
        async with running_service(LED) as kit:
            await running(kit, ("fan-1", ANN), *((("fan-2", owner),) if owner is not None else ()))
            with pytest.raises(ControlNotHeld) as refused:
                await asked(kit, operation)
            assert refused.value.key == "plant.follower_not_owned" and refused.value.params["drive"] == "fan-2"
            assert refused.value.params["why"].key == ("plant.no_lease" if owner is None else "plant.not_owner")
            assert targets(kit) == [20.0, 10.0]
            assert kit.trail.entries[-1].outcome == "plant.follower_not_owned"
            await kit.call("lease.renew", ANN, drive="fan-1")
            await kit.call("lease.take", remote_actor("ann", Role.ENGINEER), drive="fan-2")
            await asked(kit, operation)
            assert targets(kit) == [30.0, 15.0]

    run(story())


def test_a_drive_whose_ratio_is_not_written_follows_at_one() -> None:
    """As plant.toml's reference says of ``leader`` and ``ratios``."""

    async def story() -> None:
        async with running_service(plant_config(groups=(replace(GROUP, ratios={}),))) as kit:
            await running(kit, ("fan-1", ANN), ("fan-2", ANN))
            await asked(kit, "drive.set_frequency")
            assert targets(kit) == [30.0, 30.0]

    run(story())


BACKWARDS = replace(GROUP, drives=("fan-2", "fan-1"))
"""The follower is written first."""


def test_nobody_starts_behind_a_leader_that_has_not_started() -> None:
    async def story() -> None:
        async with running_service(plant_config(groups=(BACKWARDS,))) as kit:
            await asyncio.sleep(2)
            await kit.grant_waivers()
            kit.station("fan-1").faults.mute = True  # it hears, and nobody knows what it made of it
            found = (await kit.call("group.start", group="fans", frequency_hz=20.0))["outcomes"]
            assert found["fan-1"].get("status") is None
            assert (found["fan-2"]["code"], found["fan-2"]["params"]["leader"]) == ("plant.leader_not_done", "fan-1")
            assert kit.station("fan-2").motor.starts == 0
            kit.station("fan-1").faults.mute = False

    run(story())


def test_no_follower_gets_the_share_of_a_frequency_that_its_leader_has_not_got() -> None:
    async def story() -> None:
        async with running_service(plant_config(groups=(BACKWARDS,))) as kit:
            await running(kit, ("fan-1", ANN), ("fan-2", ANN))
            kit.station("fan-1").faults.silent = True
            found = await kit.call("group.set_frequency", ANN, group="fans", frequency_hz=30.0)
            assert found["outcomes"]["fan-2"]["code"] == "plant.leader_not_done"
            assert targets(kit) == [20.0, 10.0]
            kit.station("fan-1").faults.silent = False

    run(story())


async def between(kit: ServiceKit) -> asyncio.Task[Json]:
    """A change of the group's frequency that its leader has got and its follower has not."""
    change = asyncio.create_task(kit.call("group.set_frequency", ANN, group="fans", frequency_hz=30.0))
    while kit.station("fan-1").motor.target_hz != 30.0:  # noqa: ASYNC110  virtual time
        await asyncio.sleep(0.001)
    return change


def test_a_follower_stopped_while_its_leader_gets_the_groups_frequency_is_left_alone() -> None:
    """Its share was wished before its stop."""

    async def story() -> None:
        async with running_service(LED) as kit:
            await running(kit, ("fan-1", ANN), ("fan-2", ANN))
            change = await between(kit)
            await kit.call("drive.stop", BOB, drive="fan-2")
            left = (await change)["outcomes"]
            assert left["fan-1"]["status"] == "acknowledged"
            assert left["fan-2"]["code"] == "plant.stopped_meanwhile"

    run(story())


def test_a_follower_taken_by_another_while_its_leader_gets_the_groups_frequency_is_left_alone() -> None:
    async def story() -> None:
        async with running_service(LED) as kit:
            await running(kit, ("fan-1", ANN), ("fan-2", ANN))
            change = await between(kit)
            await kit.call("lease.take", remote_actor("eve", Role.ENGINEER), drive="fan-2")
            assert (await change)["outcomes"]["fan-2"]["code"] == "plant.not_owner"
            assert targets(kit) == [30.0, 10.0]

    run(story())


def test_a_refused_run_of_a_leader_leaves_its_arm_for_the_next_try() -> None:
    """Nothing was started with it."""

    async def story() -> None:
        async with running_service(LED) as kit:
            await running(kit, ("fan-1", ANN))
            arm = (await kit.call("drive.arm", ANN, drive="fan-1"))["arm_token"]
            with pytest.raises(ControlNotHeld):
                await kit.call("drive.run", ANN, drive="fan-1", frequency_hz=30.0, arm_token=arm)
            await kit.call("lease.take", ANN, drive="fan-2")
            await kit.call("drive.run", ANN, drive="fan-1", frequency_hz=30.0, arm_token=arm)

    run(story())


def test_a_follower_that_stands_or_that_nobody_here_started_is_no_reason_to_refuse() -> None:
    async def story() -> None:
        async with running_service(LED) as kit:
            await running(kit, ("fan-1", ANN), ("fan-2", BOB))
            await kit.call("drive.stop", ANN, drive="fan-2")
            found = await kit.call("drive.set_frequency", ANN, drive="fan-1", frequency_hz=30.0)
            assert found["followers"] == {} and kit.station("fan-1").motor.target_hz == 30.0

    run(story())


def test_a_follower_whose_lease_ends_while_its_leader_is_commanded_is_left_alone_and_named() -> None:
    async def story() -> None:
        async with running_service(LED) as kit:
            await running(kit, ("fan-1", ANN), ("fan-2", ANN))
            change = asyncio.create_task(kit.call("drive.set_frequency", ANN, drive="fan-1", frequency_hz=30.0))
            await asyncio.sleep(0.1)
            await kit.call("lease.take", remote_actor("eve", Role.ENGINEER), drive="fan-2")
            left = (await change)["followers"]["fan-2"]
            assert (left["kind"], left["params"]["drive"]) == ("ControlNotHeld", "fan-2")
            assert targets(kit) == [30.0, 10.0]
            assert kit.trail.entries[-1].outcome == "acknowledged, plant.not_owner"
            message = [event["text"]["en"] for _, event in kit.service.plant.hub.items("events")]
            assert any("does not follow its leader: eve has control of fan-2" in text for text in message)

    run(story())


def test_a_stop_of_a_follower_while_its_leaders_new_frequency_is_recorded_takes_that_away() -> None:
    """The follower's share was wished before its stop."""

    async def story() -> None:
        async with running_service(LED) as kit:
            await running(kit, ("fan-1", ANN), ("fan-2", ANN))
            kit.trail.delay_s = 0.5
            change = asyncio.create_task(kit.call("drive.set_frequency", ANN, drive="fan-1", frequency_hz=30.0))
            await asyncio.sleep(0.1)
            await kit.call("drive.stop", BOB, drive="fan-2")
            with pytest.raises(Superseded) as refused:
                await change
            assert refused.value.params["drive"] == "fan-2"
            assert kit.station("fan-1").motor.target_hz == 20.0

    run(story())


def test_the_trail_names_every_drive_that_a_command_concerns() -> None:
    async def story() -> None:
        async with running_service(LED) as kit:
            await running(kit, ("fan-1", ANN), ("fan-2", ANN))
            await kit.call("drive.set_frequency", ANN, drive="fan-1", frequency_hz=30.0)
            named = {entry.what: entry.params.get("drives") for entry in kit.trail.entries}
            assert named["drive.set_frequency"] == ["fan-2"]
            assert named["group.start"] == ["fan-1", "fan-2"]
            assert named["lease.take"] is None

    run(story())
