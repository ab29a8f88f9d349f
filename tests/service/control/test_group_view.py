"""State and range of a group, as every client sees them."""

from __future__ import annotations

import asyncio
from dataclasses import replace

from drivebus.drives.context import DriveLimits
from drivebus.service.config.model import GroupConfig
from drivebus.testing.virtual_time import run
from fixtures.service import DRIVES, plant_config, running_service


def test_a_group_with_a_drive_that_replies_without_a_known_state_is_not_called_stopped() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(5)
            service, drive = kit.service, kit.service.plant.drives["fan-2"]
            assert service.groups.group_view(service.plant.group("fans"))["state"] == "stopped"
            drive.stop_monitor()
            assert drive.is_online and drive.state_is_unknown
            assert service.groups.group_view(service.plant.group("fans"))["state"] == "unknown"

    run(scenario())


def test_the_lowest_frequency_of_a_group_is_one_that_every_member_permits_at_its_ratio() -> None:
    """3.33 Hz at the ratio 3 would be below a minimum of 10 Hz."""

    async def scenario() -> None:
        drives = tuple(
            replace(drive, limits=DriveLimits(minimum_hz=10.0)) if drive.id == "fan-2" else drive for drive in DRIVES
        )
        group = GroupConfig(id="fans", drives=("fan-1", "fan-2"), leader="fan-1", ratios={"fan-2": 3.0})
        async with running_service(plant_config(drives=drives, groups=(group,))) as kit:
            (found,) = (await kit.call("groups.list"))["groups"]
            assert found["minimum_hz"] == 3.34

    run(scenario())
