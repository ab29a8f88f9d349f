"""Groups: sequenced starts, common stops, followers at their ratio, and the frequencies that a group may have."""

from __future__ import annotations

import asyncio
from dataclasses import asdict, replace
from functools import partial

import pytest

from drivebus.bus.station import Presence
from drivebus.drives.drive import Drive
from drivebus.drives.state import DriveState
from drivebus.errors import (
    LimitError,
    Superseded,
)
from drivebus.service.audit.description import described
from drivebus.service.config.model import BusConfig, DriveConfig, GroupConfig
from drivebus.simulator.motor import Motor
from drivebus.testing.virtual_time import run
from drivebus.values import Text
from fixtures.service import BUSES, DRIVES, commanded_hz, plant_config, ready, remote_actor, running_service
from fixtures.system_bench import wait_until

GROUP = GroupConfig(id="fans", drives=("fan-1", "fan-2", "pump-1"), start_interval_s=3.0, max_concurrent_starts=2)


def test_a_group_start_does_not_wait_for_the_turn_of_a_slow_poll() -> None:
    """Each drive waited for a poll of the one before, which was due 10 s later."""
    drives = tuple(replace(drive, min_poll_interval_s=10.0) for drive in DRIVES if drive.bus == "b")
    group = GroupConfig(id="pumps", drives=tuple(drive.id for drive in drives), title=Text("Pumps", "水泵"))

    async def scenario() -> None:
        async with running_service(plant_config(drives=drives, groups=(group,), buses=BUSES[1:])) as kit:
            await asyncio.sleep(15)
            await kit.grant_waivers()
            began = asyncio.get_running_loop().time()
            found = (await kit.call("group.start", group="pumps", frequency_hz=20.0))["outcomes"]
            assert [outcome["status"] for outcome in found.values()] == ["confirmed", "confirmed"]
            assert 1.0 < asyncio.get_running_loop().time() - began < 4.0

    run(scenario())


def test_a_group_starts_its_drives_in_sequence_and_a_stop_of_one_ends_it() -> None:
    async def scenario() -> None:
        async with running_service(plant_config(groups=(GROUP,))) as kit:
            await ready(kit)
            start = asyncio.create_task(kit.call("group.start", group="fans", frequency_hz=20.0))
            await asyncio.sleep(4.5)
            await kit.call("drive.stop", drive="fan-1")
            found = (await start)["outcomes"]
            assert [found[drive].get("status") for drive in GROUP.drives] == ["confirmed", "confirmed", None]
            assert found["pump-1"]["kind"] == "Superseded"
            assert kit.station("pump-1").motor.starts == 0

    run(scenario())


def test_a_group_that_is_starting_is_not_started_again_until_that_has_ended() -> None:
    async def scenario() -> None:
        async with running_service(plant_config(groups=(GROUP,))) as kit:
            await ready(kit)
            start = asyncio.create_task(kit.call("group.start", group="fans", frequency_hz=20.0))
            await asyncio.sleep(1)
            with pytest.raises(Superseded) as caught:
                await kit.call("group.start", group="fans", frequency_hz=10.0)
            assert caught.value.key == "plant.group_starting"
            await start
            assert await commanded_hz(kit, *GROUP.drives) == [20.0] * 3
            assert "fan-1" in (await kit.call("group.start", group="fans", frequency_hz=10.0))["outcomes"]

    run(scenario())


def test_a_group_whose_lease_was_lost_starts_no_further_drive() -> None:
    async def scenario() -> None:
        async with running_service(plant_config(groups=(replace(GROUP, start_interval_s=7.0),))) as kit:
            await ready(kit)
            ann = remote_actor()
            for drive in GROUP.drives:
                await kit.call("lease.take", ann, drive=drive)
            arm = (await kit.call("group.arm", ann, group="fans"))["arm_token"]
            found = (await kit.call("group.start", ann, group="fans", frequency_hz=20.0, arm_token=arm))["outcomes"]
            assert [found[drive].get("kind") for drive in GROUP.drives] == [None, None, "ControlNotHeld"]
            assert kit.station("pump-1").motor.starts == 0
            entry = next(entry for entry in reversed(kit.trail.entries) if entry.what == "group.start")
            row = described({**asdict(entry), "who": {"name": ann.name}})
            lost = found["pump-1"]["text"]
            assert row["outcome_text"]["en"] == f"fan-1, fan-2: Confirmed; pump-1: {lost['en']}", "no code"
            assert row["outcome_text"]["zh"] == f"fan-1、fan-2：已确认；pump-1：{lost['zh']}"

    run(scenario())


def test_a_group_is_stopped_together() -> None:
    async def scenario() -> None:
        async with running_service(plant_config(groups=(replace(GROUP, start_interval_s=0.0),))) as kit:
            await ready(kit)
            found = await kit.call("group.start", group="fans", frequency_hz=20.0)
            assert {outcome["status"] for outcome in found["outcomes"].values()} == {"confirmed"}
            found = await kit.call("group.stop", remote_actor("bob"), group="fans")
            assert {outcome["status"] for outcome in found["outcomes"].values()} == {"confirmed"}

    run(scenario())


def test_a_drive_that_does_not_stop_is_reported_as_soon_however_many_drives_of_other_buses_are_stopped(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The deadline counted the drives of all buses: of a group of 300 on ten buses it was two minutes."""
    others = [DriveConfig(id=f"pump-{address}", bus="b", address=address, model="c320") for address in range(1, 21)]
    fan = DriveConfig(id="fan", bus="a", address=1, model="c320")
    buses = (BusConfig(id="a", port="sim://c320@1"), BusConfig(id="b", port="sim://c320@1-20"))
    group = GroupConfig(id="all", drives=tuple(drive.id for drive in (fan, *others)))

    async def scenario() -> None:
        async with running_service(plant_config(buses=buses, drives=(fan, *others), groups=(group,))) as kit:
            await ready(kit, "fan")
            monkeypatch.setattr(Motor, "stop", lambda *_: None)
            began = asyncio.get_running_loop().time()
            stop = asyncio.create_task(kit.call("group.stop", group="all"))
            await wait_until(lambda: kit.service.plant.drives["fan"].drive.stop_pending)
            assert asyncio.get_running_loop().time() - began < 2.2
            await stop

    run(scenario())


@pytest.mark.parametrize("start_interval_s", [0.0, 1.0])
def test_no_more_drives_of_a_group_accelerate_at_once_than_allowed(start_interval_s: float) -> None:
    async def scenario() -> None:
        buses = (replace(BUSES[0], port="sim://c320@1,2?ramp=8"), replace(BUSES[1], port="sim://vc660@1,2?ramp=8"))
        group = GroupConfig(
            id="fans", drives=("fan-1", "fan-2", "pump-1"), start_interval_s=start_interval_s, max_concurrent_starts=1
        )
        async with running_service(plant_config(buses=buses, groups=(group,))) as kit:
            await ready(kit)
            start = asyncio.create_task(kit.call("group.start", group="fans", frequency_hz=20.0))
            most = 0
            while not start.done():
                await asyncio.sleep(0.05)
                phases = [kit.station(drive).motor.phase.value for drive in group.drives]
                most = max(most, phases.count("accelerating"))
            assert most == 1
            assert {outcome["status"] for outcome in (await start)["outcomes"].values()} == {"confirmed"}

    run(scenario())


def test_followers_run_at_their_ratio_and_follow_their_leader() -> None:
    async def scenario() -> None:
        group = GroupConfig(id="fans", drives=("fan-1", "fan-2"), leader="fan-1", ratios={"fan-2": 0.5})
        async with running_service(plant_config(groups=(group,))) as kit:
            await ready(kit)
            await kit.call("group.start", group="fans", frequency_hz=20.0)
            assert kit.station("fan-2").motor.target_hz == 10.0
            found = await kit.call("drive.set_frequency", drive="fan-1", frequency_hz=30.0)
            assert found["followers"]["fan-2"]["status"] == "acknowledged"
            assert kit.station("fan-2").motor.target_hz == 15.0
            await kit.call("group.set_frequency", group="fans", frequency_hz=24.0)
            assert kit.station("fan-2").motor.target_hz == 12.0

    run(scenario())


def test_a_group_with_a_follower_above_its_limit_does_not_start() -> None:
    async def scenario() -> None:
        group = GroupConfig(id="fans", drives=("fan-1", "fan-2"), leader="fan-1", ratios={"fan-2": 30.0})
        async with running_service(plant_config(groups=(group,))) as kit:
            await ready(kit)
            with pytest.raises(LimitError) as caught:
                await kit.call("group.start", group="fans", frequency_hz=20.0)
            assert caught.value.params["frequency_hz"] == 600.0
            assert kit.station("fan-1").motor.starts == 0

    run(scenario())


@pytest.mark.parametrize("operation", ["group.start", "group.set_frequency"])
def test_a_limit_hit_at_a_ratio_names_the_drive_and_the_frequencies_that_the_group_may_have(operation: str) -> None:
    """It named neither: 36 Hz was above the maximum where 40 Hz had been entered for three drives."""

    async def scenario() -> None:
        group = GroupConfig(id="fans", drives=("fan-1", "fan-2"), leader="fan-1", ratios={"fan-2": 3.0})
        async with running_service(plant_config(groups=(group,))) as kit:
            await ready(kit)
            with pytest.raises(LimitError) as caught:
                await kit.call(operation, group="fans", frequency_hz=20.0)
            assert caught.value.text("en") == (
                "fan-2 gets 3.0 times the frequency of group fans: 60.0 Hz is above the maximum of 50.0 Hz; "
                "nothing was sent. fan-2 permits 0.0 Hz to 16.66 Hz for the group"
            )
            assert caught.value.text("zh").startswith("fan-2 的频率为组 fans 频率的 3.0 倍：")
            assert (await kit.call("group.start", group="fans", frequency_hz=16.66))["outcomes"]["fan-2"]["status"]

    run(scenario())


def test_a_group_with_an_offline_drive_is_not_called_stopped() -> None:
    """The state of the offline drive was that of the last replies, which are good for three poll periods."""

    async def scenario() -> None:
        drives = tuple(replace(drive, min_poll_interval_s=10.0) for drive in DRIVES)
        async with running_service(plant_config(drives=drives)) as kit:
            await asyncio.sleep(30)
            view = partial(kit.service.groups.group_view, kit.service.plant.group("fans"))
            assert view()["state"] == "stopped"
            kit.station("fan-2").faults.silent = True
            runtime = kit.service.plant.drives["fan-2"]
            await asyncio.sleep(15)
            assert runtime.bus.presence(runtime.config.address) is Presence.OFFLINE
            assert runtime.status().state is DriveState.STOPPED and view()["state"] == "unknown"

    run(scenario())


def test_a_cap_of_an_unknown_setpoint_step_is_not_called_the_range_of_a_group(monkeypatch: pytest.MonkeyPatch) -> None:
    """The refusal limited the drive to 0.5 Hz and named a range up to 50 Hz."""

    def refuse(drive: Drive, frequency_hz: float) -> float:
        raise LimitError("drives.step_cap")

    async def scenario() -> None:
        group = GroupConfig(id="fans", drives=("fan-1", "fan-2"), leader="fan-1", ratios={"fan-2": 3.0})
        async with running_service(plant_config(groups=(group,))) as kit:
            await ready(kit)
            monkeypatch.setattr(Drive, "check_frequency", refuse)
            with pytest.raises(LimitError) as caught:
                await kit.call("group.start", group="fans", frequency_hz=20.0)
            assert caught.value.key == "plant.member_limit" and caught.value.params["why"].key == "drives.step_cap"
            assert caught.value.text("en").startswith("fan-1 in group fans: ")

    run(scenario())


def test_a_group_offers_no_frequency_above_the_cap_of_a_member_at_its_ratio() -> None:
    """It offered its lowest maximum: 50 Hz, where a follower of unknown setpoint step was capped at 0.5 Hz."""

    async def scenario() -> None:
        drives = tuple(
            replace(drive, options={"setpoint_step": "unknown"} if drive.id == "fan-2" else drive.options)
            for drive in DRIVES
        )
        group = GroupConfig(id="fans", drives=("fan-1", "fan-2"), leader="fan-1", ratios={"fan-2": 2.0})
        async with running_service(plant_config(drives=drives, groups=(group,))) as kit:
            await ready(kit)
            caps_hz = [(await kit.call("drives.get", drive=id))["setpoint_cap_hz"] for id in group.drives]
            assert caps_hz == [None, 0.5]
            (found,) = (await kit.call("groups.list"))["groups"]
            assert (found["minimum_hz"], found["maximum_hz"]) == (0.0, 0.25)
            with pytest.raises(LimitError) as caught:
                await kit.call("group.set_frequency", group="fans", frequency_hz=0.26)
            assert caught.value.key == "plant.member_limit" and caught.value.params["why"].key == "drives.step_cap"
            with pytest.raises(LimitError, match=r"fan-2 permits 0\.0 Hz to 0\.25 Hz for the group"):
                await kit.call("group.set_frequency", group="fans", frequency_hz=30.0)
            outcomes = (await kit.call("group.set_frequency", group="fans", frequency_hz=0.25))["outcomes"]
            assert outcomes["fan-2"]["status"]
            kit.service.plant.drives["fan-2"].drive.dialect.set_option("setpoint_step", "0.01")
            (found,) = (await kit.call("groups.list"))["groups"]
            assert found["maximum_hz"] == 25.0

    run(scenario())
