"""Behaviour of a drive at communication loss, as read from it: unknown again after each write."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest

from drivebus.errors import WaiverRequired
from drivebus.service.api.errors import localized
from drivebus.service.auth.rights import Role
from drivebus.service.config.model import BusConfig, DriveConfig
from drivebus.service.runtime.comm_loss import COMM_LOSS_NOT_READ
from drivebus.testing.virtual_time import run
from drivebus.values import Text
from fixtures.service import ServiceKit, plant_config, remote_actor, running_service

ENGINEER = remote_actor("eve", Role.ENGINEER)
BUS = BusConfig("s", "sim://e300@1?ramp=1")
SMALL = DriveConfig(id="small", bus="s", address=1, model="e300", title=Text("Small", "小风机"))


async def configure_trip(kit: ServiceKit) -> None:
    """Set the drive to trip and wait until that was read; the values of F9.3 are invented, the manual has none."""
    await asyncio.sleep(2)
    dialect = kit.service.plant.drives["fan-1"].drive.dialect
    rule = replace(dialect.profile.comm_loss, trips_values=(0,))
    dialect.profile = replace(dialect.profile, comm_loss=rule)
    await kit.call("lease.take", ENGINEER, drive="fan-1")
    await write(kit, **{"F9.3": 0.0, "F9.4": 5.0})
    await asyncio.sleep(5)
    assert await comm_loss_kind(kit) == "trips"


async def write(kit: ServiceKit, **values: float) -> None:
    await kit.call("lease.renew", ENGINEER, drive="fan-1")
    await kit.call("parameters.write", ENGINEER, drive="fan-1", values=values)


def test_the_reaction_to_a_communication_loss_is_called_not_read_only_until_it_was_read() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            not_read = localized("plant.comm_loss_not_read")
            assert (await kit.call("drives.get", drive="fan-1"))["comm_loss"]["text"] == not_read
            await asyncio.sleep(8)
            assert (await kit.call("drives.get", drive="fan-1"))["comm_loss"]["text"] != not_read

    run(scenario())


async def comm_loss_kind(kit: ServiceKit) -> str:
    found: str = (await kit.call("drives.get", drive="fan-1"))["comm_loss"]["kind"]
    return found


def test_after_a_write_the_behaviour_is_unknown_and_blocks_starts_until_it_is_read() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await configure_trip(kit)
            await write(kit, **{"F9.4": 0.0})
            assert await comm_loss_kind(kit) == "unknown"
            assert kit.service.plant.drives["fan-1"].comm_loss.view.text == COMM_LOSS_NOT_READ
            await kit.call("lease.release", ENGINEER, drive="fan-1")
            with pytest.raises(WaiverRequired):
                await kit.call("drive.run", drive="fan-1", frequency_hz=20.0)
            assert kit.station("fan-1").motor.starts == 0
            await asyncio.sleep(5)
            assert await comm_loss_kind(kit) == "runs_on"

    run(scenario())


@pytest.mark.parametrize("during", [True, False])
def test_a_read_that_began_before_a_write_ended_is_discarded(during: bool) -> None:
    """It may have returned the old value, and the next read is an hour away."""

    async def scenario() -> None:
        async with running_service() as kit:
            await configure_trip(kit)
            drive = kit.service.plant.drives["fan-1"]
            writes, report = drive.comm_loss.write_count, await drive.drive.comm_loss_behaviour()
            change = asyncio.create_task(write(kit, **{"F9.4": 0.0}))
            await asyncio.sleep(0.01)
            if not during:
                await change
            drive.comm_loss.set_read(report, drive.profile.comm_loss, kit.service.plant.now(), writes)
            assert await comm_loss_kind(kit) == "unknown"
            during_write = drive.comm_loss.write_count
            await change
            drive.comm_loss.set_read(report, drive.profile.comm_loss, kit.service.plant.now(), during_write)
            assert await comm_loss_kind(kit) == ("unknown" if during else "trips")

    run(scenario())


@pytest.mark.parametrize(("action", "time", "kind"), [(0x00, 50, "trips"), (0x10, 50, "runs_on"), (0x00, 0, "runs_on")])
def test_a_drive_with_a_published_behaviour_starts_without_a_waiver_where_it_trips(
    action: int, time: int, kind: str
) -> None:
    """The E300 manual publishes F4.3 and F4.4; the simulated drive then behaves as read."""

    async def scenario() -> None:
        async with running_service(plant_config(buses=(BUS,), drives=(SMALL,), groups=())) as kit:
            station = kit.station("small")
            station.keypad_set(0x4_03, action)
            station.keypad_set(0x4_04, time)
            await asyncio.sleep(8)
            found = (await kit.call("drives.get", drive="small"))["comm_loss"]
            assert (found["kind"], found["after_s"]) == (kind, time / 10)
            if kind != "trips":
                with pytest.raises(WaiverRequired):
                    await kit.call("drive.run", drive="small", frequency_hz=20.0)
                return
            await kit.call("drive.run", drive="small", frequency_hz=20.0)
            await asyncio.sleep(4)
            assert station.motor.energised
            bench = kit.simulated_bus("small")
            await kit.service.plant.buses["s"].bus.close()
            await asyncio.sleep(15)
            bench.advance()
            assert not station.motor.energised

    run(scenario())
