"""Followers of a leader: their frequencies, and the control leases that a change needs."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest

from drivebus.errors import ControlNotHeld, Interlocked, StartInhibited, Superseded
from drivebus.service.auth.actor import Actor
from drivebus.service.auth.rights import Role
from drivebus.service.config.model import GroupConfig
from drivebus.simulator.motor import Trip
from drivebus.testing.virtual_time import run
from drivebus.values import Text
from fixtures.service import Json, ServiceKit, plant_config, remote_actor, running_service

GROUP = GroupConfig(id="fans", drives=("fan-1", "fan-2"), leader="fan-1", ratios={"fan-2": 0.5})
LED = plant_config(groups=(GROUP,))
ANN, BOB = remote_actor("ann"), remote_actor("bob")


async def start_fans(kit: ServiceKit, *owners: tuple[str, Actor]) -> None:
    """Let the service start both fans, then give control of them to these actors."""
    await asyncio.sleep(2)
    await kit.grant_waivers()
    await kit.call("group.start", group="fans", frequency_hz=20.0)
    for drive in GROUP.drives:
        await kit.call("lease.release", drive=drive)
    for drive, owner in owners:
        await kit.call("lease.take", owner, drive=drive)


def targets(kit: ServiceKit) -> list[float]:
    return [kit.station(drive).motor.target_hz for drive in GROUP.drives]


async def command_leader(kit: ServiceKit, operation: str) -> None:
    """Give the leader 30 Hz in the name of Ann, who controls it."""
    arm = (await kit.call("drive.arm", ANN, drive="fan-1"))["arm_token"] if operation == "drive.run" else None
    token = {} if arm is None else {"arm_token": arm}
    found = await kit.call(operation, ANN, drive="fan-1", frequency_hz=30.0, **token)
    assert found["followers"]["fan-2"]["status"] == "acknowledged"


@pytest.mark.parametrize("operation", ["drive.set_frequency", "drive.run"])
@pytest.mark.parametrize("owner", [BOB, None], ids=["another", "none"])
def test_a_leader_is_not_commanded_without_control_of_its_follower(operation: str, owner: Actor | None) -> None:
    """Rejected before any frame is sent; with control of both drives it is done."""

    async def scenario() -> None:
        async with running_service(LED) as kit:
            await start_fans(kit, ("fan-1", ANN), *((("fan-2", owner),) if owner is not None else ()))
            with pytest.raises(ControlNotHeld) as rejected:
                await command_leader(kit, operation)
            assert rejected.value.key == "plant.follower_not_owned" and rejected.value.params["drive"] == "fan-2"
            assert rejected.value.params["why"].key == ("plant.no_lease" if owner is None else "plant.not_owner")
            assert targets(kit) == [20.0, 10.0]
            assert kit.trail.entries[-1].outcome == "plant.follower_not_owned"
            await kit.call("lease.renew", ANN, drive="fan-1")
            await kit.call("lease.take", remote_actor("ann", Role.ENGINEER), drive="fan-2")
            await command_leader(kit, operation)
            assert targets(kit) == [30.0, 15.0]

    run(scenario())


def test_a_follower_without_a_configured_ratio_gets_the_frequency_of_its_leader() -> None:
    """The reference of plant.toml states it under ``leader`` and ``ratios``."""

    async def scenario() -> None:
        async with running_service(plant_config(groups=(replace(GROUP, ratios={}),))) as kit:
            await start_fans(kit, ("fan-1", ANN), ("fan-2", ANN))
            await command_leader(kit, "drive.set_frequency")
            assert targets(kit) == [30.0, 30.0]

    run(scenario())


BACKWARDS = replace(GROUP, drives=("fan-2", "fan-1"))
"""The configuration lists the follower first."""


@pytest.mark.parametrize("muted_s", [0, 10], ids=["unanswered", "offline"])
def test_no_follower_starts_after_a_leader_that_has_not_started(muted_s: float) -> None:
    """The error for an offline leader named it as a drive that runs without itself."""

    async def scenario() -> None:
        async with running_service(plant_config(groups=(BACKWARDS,))) as kit:
            await asyncio.sleep(2)
            await kit.grant_waivers()
            kit.station("fan-1").faults.mute = True  # it receives and may execute frames, but does not reply
            await asyncio.sleep(muted_s)
            await kit.call("group.arm", group="fans")
            found = (await kit.call("group.start", group="fans", frequency_hz=20.0))["outcomes"]
            assert found["fan-1"].get("status") is None
            assert (found["fan-2"]["code"], found["fan-2"]["params"]["leader"]) == ("plant.leader_not_done", "fan-1")
            assert kit.station("fan-2").motor.starts == 0
            kit.station("fan-1").faults.mute = False

    run(scenario())


def test_a_group_does_not_start_while_a_follower_is_known_to_be_offline() -> None:
    """The leader ran alone, and the outcome named the follower afterwards. Without a leader the others start."""

    async def scenario() -> None:
        for leader in ("fan-1", None):
            group = replace(GROUP, leader=leader, ratios={})
            async with running_service(plant_config(groups=(group,))) as kit:
                await asyncio.sleep(2)
                await kit.grant_waivers()
                kit.station("fan-2").faults.silent = True
                await asyncio.sleep(10)
                if leader is None:
                    await kit.call("group.start", group="fans", frequency_hz=20.0)
                    assert kit.station("fan-1").motor.starts == 1
                    continue
                for operation, more in (("group.arm", {}), ("group.start", {"frequency_hz": 20.0})):
                    with pytest.raises(Interlocked) as refused:
                        await kit.call(operation, group="fans", **more)
                    assert (refused.value.key, refused.value.params["drive"]) == ("plant.member_offline", "fan-2")
                assert kit.station("fan-1").motor.starts == 0
                kit.station("fan-2").faults.silent = False
                await asyncio.sleep(10)
                await kit.call("group.start", group="fans", frequency_hz=20.0)
                assert [kit.station(drive).motor.starts for drive in GROUP.drives] == [1, 1]

    run(scenario())


def test_a_member_whose_replies_are_not_accepted_is_not_called_silent_where_its_group_is_refused() -> None:
    async def scenario() -> None:
        async with running_service(plant_config(groups=(replace(GROUP, ratios={}),))) as kit:
            await asyncio.sleep(2)
            await kit.grant_waivers()
            kit.station("fan-2").faults.added_delay_s = 0.5  # each reply comes too late
            await asyncio.sleep(10)
            with pytest.raises(Interlocked) as refused:
                await kit.call("group.start", group="fans", frequency_hz=20.0)
            assert refused.value.key == "plant.member_offline"
            assert refused.value.text("en").startswith("no usable reply from fan-2")
            assert refused.value.text("zh").startswith("fan-2 无可用应答")

    run(scenario())


def test_no_follower_gets_the_share_of_a_frequency_that_its_leader_has_not_got() -> None:
    async def scenario() -> None:
        async with running_service(plant_config(groups=(BACKWARDS,))) as kit:
            await start_fans(kit, ("fan-1", ANN), ("fan-2", ANN))
            kit.station("fan-1").faults.silent = True
            found = await kit.call("group.set_frequency", ANN, group="fans", frequency_hz=30.0)
            assert found["outcomes"]["fan-2"]["code"] == "plant.leader_not_done"
            assert targets(kit) == [20.0, 10.0]
            kit.station("fan-1").faults.silent = False

    run(scenario())


async def change_half_done(kit: ServiceKit) -> asyncio.Task[Json]:
    """Begin a change of the group's frequency; return when the leader has it and the follower not yet."""
    change = asyncio.create_task(kit.call("group.set_frequency", ANN, group="fans", frequency_hz=30.0))
    while kit.station("fan-1").motor.target_hz != 30.0:  # noqa: ASYNC110  virtual time
        await asyncio.sleep(0.001)
    return change


def test_a_follower_that_is_stopped_while_its_leader_is_commanded_gets_no_frequency() -> None:
    """The frequency of the follower was commanded before its stop."""

    async def scenario() -> None:
        async with running_service(LED) as kit:
            await start_fans(kit, ("fan-1", ANN), ("fan-2", ANN))
            change = await change_half_done(kit)
            await kit.call("drive.stop", BOB, drive="fan-2")
            left = (await change)["outcomes"]
            assert left["fan-1"]["status"] == "acknowledged"
            assert left["fan-2"]["code"] == "plant.stopped_meanwhile"

    run(scenario())


def test_a_follower_that_another_session_takes_while_its_leader_is_commanded_gets_no_frequency() -> None:
    async def scenario() -> None:
        async with running_service(LED) as kit:
            await start_fans(kit, ("fan-1", ANN), ("fan-2", ANN))
            change = await change_half_done(kit)
            await kit.call("lease.take", remote_actor("eve", Role.ENGINEER), drive="fan-2")
            assert (await change)["outcomes"]["fan-2"]["code"] == "plant.not_owner"
            assert targets(kit) == [30.0, 10.0]

    run(scenario())


def test_a_rejected_start_of_a_leader_keeps_its_arm_token_valid() -> None:
    async def scenario() -> None:
        async with running_service(LED) as kit:
            await start_fans(kit, ("fan-1", ANN))
            arm = (await kit.call("drive.arm", ANN, drive="fan-1"))["arm_token"]
            with pytest.raises(ControlNotHeld):
                await kit.call("drive.run", ANN, drive="fan-1", frequency_hz=30.0, arm_token=arm)
            await kit.call("lease.take", ANN, drive="fan-2")
            await kit.call("drive.run", ANN, drive="fan-1", frequency_hz=30.0, arm_token=arm)

    run(scenario())


def test_a_follower_at_standstill_needs_no_control_lease() -> None:
    async def scenario() -> None:
        async with running_service(LED) as kit:
            await start_fans(kit, ("fan-1", ANN), ("fan-2", BOB))
            await kit.call("drive.stop", ANN, drive="fan-2")
            found = await kit.call("drive.set_frequency", ANN, drive="fan-1", frequency_hz=30.0)
            assert found["followers"] == {} and kit.station("fan-1").motor.target_hz == 30.0

    run(scenario())


def test_a_follower_whose_lease_ends_while_its_leader_is_commanded_is_reported() -> None:
    async def scenario() -> None:
        async with running_service(LED) as kit:
            await start_fans(kit, ("fan-1", ANN), ("fan-2", ANN))
            change = asyncio.create_task(kit.call("drive.set_frequency", ANN, drive="fan-1", frequency_hz=30.0))
            await asyncio.sleep(0.1)
            await kit.call("lease.take", remote_actor("eve", Role.ENGINEER), drive="fan-2")
            left = (await change)["followers"]["fan-2"]
            assert (left["kind"], left["params"]["drive"]) == ("ControlNotHeld", "fan-2")
            assert targets(kit) == [30.0, 10.0]
            assert kit.trail.entries[-1].outcome == "acknowledged, plant.not_owner"
            texts = kit.event_texts()
            assert any("does not follow its leader: eve has control of fan-2" in text for text in texts)

    run(scenario())


def test_a_stop_of_a_follower_while_its_leaders_command_is_recorded_cancels_that_command() -> None:
    """The follower's frequency was commanded before its stop."""

    async def scenario() -> None:
        async with running_service(LED) as kit:
            await start_fans(kit, ("fan-1", ANN), ("fan-2", ANN))
            kit.trail.delay_s = 0.5
            change = asyncio.create_task(kit.call("drive.set_frequency", ANN, drive="fan-1", frequency_hz=30.0))
            await asyncio.sleep(0.1)
            await kit.call("drive.stop", BOB, drive="fan-2")
            with pytest.raises(Superseded) as rejected:
                await change
            assert rejected.value.params["drive"] == "fan-2"
            assert kit.station("fan-1").motor.target_hz == 20.0

    run(scenario())


def test_an_audit_record_names_every_drive_that_its_command_affects() -> None:
    async def scenario() -> None:
        async with running_service(LED) as kit:
            await start_fans(kit, ("fan-1", ANN), ("fan-2", ANN))
            await kit.call("drive.set_frequency", ANN, drive="fan-1", frequency_hz=30.0)
            drives = {entry.what: entry.params.get("drives") for entry in kit.trail.entries}
            assert drives["drive.set_frequency"] == ["fan-2"]
            assert drives["group.start"] == ["fan-1", "fan-2"]
            assert drives["lease.take"] is None

    run(scenario())


@pytest.mark.parametrize(
    ("operation", "event"), [("drive.pause", "plant.did_pause"), ("drive.hold_ramp", "plant.did_hold_ramp")]
)
def test_a_leader_is_neither_paused_nor_held_while_a_follower_runs(operation: str, event: str) -> None:
    """The followers would run on at their share of the frequency that the leader no longer has."""
    pumps = GroupConfig(id="pumps", drives=("pump-1", "pump-2"), leader="pump-1")
    more = {"seconds": 1.0} if operation == "drive.hold_ramp" else {}

    async def scenario() -> None:
        async with running_service(plant_config(groups=(pumps,))) as kit:
            await asyncio.sleep(2)
            await kit.grant_waivers()
            await kit.call("group.start", group="pumps", frequency_hz=20.0)
            await asyncio.sleep(5)
            with pytest.raises(StartInhibited) as rejected:
                await kit.call(operation, drive="pump-1", **more)
            assert rejected.value.key == "plant.leader_holds" and rejected.value.params["follower"] == "pump-2"
            found = await kit.call(operation, drive="pump-2", **more)
            assert found["outcome"]["status"] in ("confirmed", "acknowledged")
            how = Text.from_mapping(found["outcome"]["text"])
            assert kit.drives_of_events(event, **more, how=how) == ["pump-2"]

    run(scenario())


@pytest.mark.parametrize("leader", ["fan-1", None])
def test_a_group_with_a_tripped_drive_is_neither_armed_nor_started_and_the_drive_is_named(leader: str | None) -> None:
    async def scenario() -> None:
        group = replace(GROUP, leader=leader, ratios={})
        async with running_service(plant_config(groups=(group,))) as kit:
            await asyncio.sleep(2)
            await kit.grant_waivers()
            kit.station("fan-2").trip(Trip.UNDERVOLTAGE)
            await asyncio.sleep(2)
            for operation, more in (("group.arm", {}), ("group.start", {"frequency_hz": 20.0})):
                with pytest.raises(StartInhibited) as refused:
                    await kit.call(operation, group="fans", **more)
                assert (refused.value.key, refused.value.params["drive"]) == ("plant.member_fault", "fan-2")
            assert kit.station("fan-1").motor.starts == 0

    run(scenario())
