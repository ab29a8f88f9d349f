"""What is seen of a bus."""

from __future__ import annotations

import asyncio

from drivebus.plant.model import BusSetting
from drivebus.testing.virtual import run
from plantkit import plant, setting


def test_a_failure_counts_once_in_the_figures_of_its_bus() -> None:
    async def story() -> None:
        buses = (BusSetting("a", "sim://c320@1"), BusSetting("b", "sim://vc660@1,2"))
        async with plant(setting(buses=buses)) as kit:
            await asyncio.sleep(10)
            bus = await kit.call("buses.get", bus="a")
            silent = next(station for station in bus["stations"] if station["address"] == 2)
            assert silent["errors"]["NoReply"] > 1
            assert bus["errors"] == silent["errors"]

    run(story())
