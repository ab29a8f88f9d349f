"""Counters of ``plant.statistics``."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path

from drivebus.service.api.operations.drives import StatisticsObject
from drivebus.service.config.model import BusConfig
from drivebus.testing.virtual_time import run
from fixtures.running_service import real_service
from fixtures.service import DRIVES, plant_config, running_service


def test_stops_are_counted_by_request_and_by_outcome() -> None:
    """A stop of everything counts for each drive; a DF800 can only acknowledge, and a missing drive does neither."""

    async def scenario() -> None:
        buses = (BusConfig("a", "sim://c320@1,2"), BusConfig("b", "sim://df800@1"))
        drives = (*DRIVES[:2], *(replace(drive, model="df800") for drive in DRIVES[2:]))
        async with running_service(plant_config(buses=buses, drives=drives)) as kit:
            await asyncio.sleep(5)
            assert (await kit.call("plant.statistics"))["stops"] == {"requested": 0, "confirmed": 0, "acknowledged": 0}
            await kit.call("drive.stop", drive="fan-1")
            assert (await kit.call("plant.statistics"))["stops"] == {"requested": 1, "confirmed": 1, "acknowledged": 0}
            await kit.call("plant.stop")
            assert (await kit.call("plant.statistics"))["stops"] == {"requested": 5, "confirmed": 3, "acknowledged": 1}

    run(scenario())


async def test_the_statistics_contain_those_of_the_history_and_of_each_drive(tmp_path: Path) -> None:
    async with real_service(tmp_path) as kit:
        for _ in range(1000):
            found = await kit.call("plant.statistics")
            if found["history"]["samples"] and found["drives"]["fan-1"]["running_h"] is not None:
                break
            await asyncio.sleep(0.05)
        assert found["history"]["ok"] and found["history"]["lost_samples"] == 0
        assert found["drives"].keys() == {"fan-1", "fan-2", "pump-1", "pump-2"}
        assert found["drives"]["fan-1"] == await kit.call("drives.statistics", drive="fan-1")
        assert found["history"]["samples"] > 0 and found["drives"]["fan-1"]["starts"] == 0


def test_the_statistics_of_a_drive_without_run_state_are_as_described() -> None:
    """A DF800 reports no run state, so its starts and hours are not known."""

    async def scenario() -> None:
        drive = replace(DRIVES[0], model="df800")
        async with running_service(plant_config(buses=(BusConfig("a", "sim://df800@1"),), drives=(drive,))) as kit:
            await asyncio.sleep(5)
            found = StatisticsObject.model_validate(await kit.call("drives.statistics", drive="fan-1"))
            assert (found.starts, found.running_h) == (None, None)

    run(scenario())
