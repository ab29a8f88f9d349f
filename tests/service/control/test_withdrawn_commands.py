"""Commands under way of a session that loses control: what was not sent is not sent, what was sent is confirmed."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest

from drivebus.drives.state import DriveState
from drivebus.errors import Superseded
from drivebus.service.auth.rights import Role
from drivebus.testing.virtual_time import run
from fixtures.service import GROUPS, plant_config, remote_actor, running_service

ANN = remote_actor()


@pytest.mark.parametrize("drive", ["fan-1", "pump-1"])
@pytest.mark.parametrize("taken", [False, True], ids=["the user is disabled", "an engineer takes control"])
def test_no_start_frame_is_sent_once_its_user_has_lost_control_and_one_sent_before_is_confirmed(
    drive: str, taken: bool
) -> None:
    """The motor started up to 0.7 s after its user was disabled, and the audit trail named the start as confirmed."""
    found: list[tuple[int, int, str | None]] = []

    async def scenario(after_s: float) -> None:
        async with running_service() as kit:
            starting = await kit.begin(ANN, "drive.run", drive, 20.0)
            await asyncio.sleep(after_s)
            assert not starting.done()
            starts = kit.station(drive).motor.starts
            if taken:
                await kit.call("lease.take", remote_actor("li", Role.ENGINEER), drive=drive)
            else:
                await kit.service.end_control("rights", ANN)
            await asyncio.wait([starting])
            await asyncio.sleep(1)
            state = kit.service.plant.drives[drive].status().state
            assert (state is DriveState.STOPPED) == (starts == 0)
            found.append((starts, kit.station(drive).motor.starts, kit.trail.outcomes("drive.run")[-1]))
            if starts == 0:
                error = starting.exception()
                assert isinstance(error, Superseded) and error.may_be_running is False
                (entry,) = [one for one in kit.trail.entries if one.what == "drive.run" and one.of is not None]
                assert "control of it ended" in entry.params["error_text"]["en"]
                assert not kit.service.plant.drives[drive].started_by_service

    for after_s in (0.0, 0.2, 0.45, 0.6, 0.65, 0.9):
        run(scenario(after_s))
    assert set(found) == {(0, 0, "plant.control_ended_meanwhile"), (1, 1, "confirmed")}


def test_a_group_start_ends_with_the_drive_whose_frame_had_left_and_tells_the_others() -> None:
    async def scenario() -> None:
        async with running_service(plant_config(groups=(replace(GROUPS[0], start_interval_s=20.0),))) as kit:
            await asyncio.sleep(2)
            await kit.grant_waivers()
            for drive in ("fan-1", "fan-2"):
                await kit.call("lease.take", ANN, drive=drive)
            arm = (await kit.call("group.arm", ANN, group="fans"))["arm_token"]
            starting = asyncio.create_task(kit.call("group.start", ANN, group="fans", frequency_hz=20.0, arm_token=arm))
            while kit.station("fan-1").motor.starts == 0:  # noqa: ASYNC110  the simulated drive has no event
                await asyncio.sleep(0.001)
            await kit.service.end_control("rights", ANN)
            async with asyncio.timeout(5):  # another user may start the group again without waiting for its interval
                outcomes = (await starting)["outcomes"]
            assert (outcomes["fan-1"]["status"], outcomes["fan-2"]["code"]) == ("confirmed", "plant.lease_gone")
            assert kit.station("fan-2").motor.starts == 0
            assert kit.trail.outcomes("group.start")[-1] == "confirmed, plant.lease_gone"

    run(scenario())


def test_a_jog_whose_frame_has_not_left_when_its_user_is_disabled_is_not_sent() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            jogging = await kit.begin(ANN, "drive.jog", "fan-1", 5.0)
            await asyncio.sleep(0.1)
            await kit.service.end_control("rights", ANN)
            with pytest.raises(Superseded) as withdrawn:
                await jogging
            assert withdrawn.value.key == "plant.control_ended_meanwhile"
            await asyncio.sleep(1)
            assert kit.station("fan-1").motor.starts == 0

    run(scenario())


def test_a_start_after_the_loss_of_control_is_another_command() -> None:
    """Another user's start, or the same user's after a new login, is not withdrawn with the one before."""

    async def scenario() -> None:
        async with running_service() as kit:
            starting = await kit.begin(ANN, "drive.run", "fan-1", 20.0)
            await kit.service.end_control("rights", ANN)
            bob = remote_actor("bob")
            await kit.call("lease.take", bob, drive="fan-1")
            arm = (await kit.call("drive.arm", bob, drive="fan-1"))["arm_token"]
            started = await kit.call("drive.run", bob, drive="fan-1", frequency_hz=10.0, arm_token=arm)
            assert (started["outcome"]["status"], starting.done()) == ("confirmed", True)
            assert kit.station("fan-1").motor.starts == 1

    run(scenario())
