"""What ends by itself: a jog takes the arms with it; an owner who is gone is noticed also where the drive is silent."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest

from drivebus.drives.state import DriveState
from drivebus.errors import ArmRequired
from drivebus.service.alarms import SystemAlarm
from drivebus.service.config.model import OnClientLost
from drivebus.simulator.port import simulated_bus_of
from drivebus.testing.virtual_time import run
from drivebus.types import Json
from fixtures.service import DRIVES, ServiceKit, plant_config, remote_actor, running_service

ANN = remote_actor()


@pytest.mark.parametrize("lost", [True, False])
def test_the_end_of_a_jog_voids_what_was_armed_before_it(lost: bool) -> None:
    """Letting go, or being too late, is a stop."""

    async def story() -> None:
        async with running_service() as kit:
            await asyncio.sleep(2)
            await kit.grant_waivers()
            await kit.call("lease.take", ANN, drive="fan-1")
            first, second = [(await kit.call("drive.arm", ANN, drive="fan-1"))["arm_token"] for _ in range(2)]
            jog = (await kit.call("drive.jog", ANN, drive="fan-1", frequency_hz=5.0, arm_token=first))["jog"]
            if lost:
                await asyncio.sleep(2)
            else:
                await kit.call("drive.jog_end", ANN, drive="fan-1", jog=jog)
            starts = kit.station("fan-1").motor.starts
            with pytest.raises(ArmRequired):
                await kit.call("drive.run", ANN, drive="fan-1", frequency_hz=20.0, arm_token=second)
            assert kit.station("fan-1").motor.starts == starts

    run(story())


def raised(kit: ServiceKit) -> set[str]:
    return {one.kind for one in kit.service.plant.alarms.active() if one.cleared_ms is None}


@pytest.mark.parametrize("silent", [True, False])
@pytest.mark.parametrize("policy", list(OnClientLost))
def test_an_owner_who_is_gone_is_noticed_where_nothing_shows_that_the_drive_stands(
    policy: OnClientLost, silent: bool
) -> None:
    """Nobody here started it, and it may be running all the same; one that is seen to stand needs nothing."""

    async def story() -> None:
        drives = tuple(replace(drive, on_client_lost=policy) for drive in DRIVES)
        async with running_service(plant_config(drives=drives)) as kit:
            await asyncio.sleep(2)
            await kit.call("lease.take", ANN, drive="fan-1")
            unit = kit.service.plant.drives["fan-1"]
            if silent:
                simulated_bus_of(unit.bus.port).unplug()
            await asyncio.sleep(15)
            assert unit.status().state is (DriveState.UNKNOWN if silent else DriveState.STOPPED)
            assert ("control_lost" in raised(kit)) is (silent and policy is OnClientLost.HOLD)
            stops = [one.what for one in kit.trail.entries if one.who == "drivebus"]
            assert stops == (["drive.stop"] if silent and policy is OnClientLost.STOP else [])

    run(story())


def test_the_events_of_a_lost_port_are_said_once_and_by_nobody() -> None:
    """Whoever acknowledged an alarm is not who ended it."""
    events: list[Json] = []

    async def story() -> None:
        async with running_service() as kit:
            await asyncio.sleep(2)
            hall = kit.service.plant
            port = simulated_bus_of(hall.drives["fan-1"].bus.port)
            port.unplug()
            await asyncio.sleep(2)
            (alarm,) = [one for one in hall.alarms.active() if one.kind == SystemAlarm.PORT_LOST]
            assert alarm.text.en == "Bus a has lost its port: it is opened again as soon as possible"
            hall.publish_alarms(hall.alarms.acknowledge(alarm.id, "ann", hall.wall_ms()))
            port.replug()
            await asyncio.sleep(3)
            events.extend(kit.history.events)

    run(story())
    received = [(event["outcome"], event["actor"]) for event in events]
    assert [one for one in received if one[1] == "ann"] == [("acknowledged", "ann")]
    assert ("cleared", None) in received
