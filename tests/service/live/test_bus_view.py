"""View of a bus."""

from __future__ import annotations

import asyncio

from drivebus.service.config.model import BusConfig
from drivebus.testing.virtual_time import run
from fixtures.service import plant_config, running_service


def test_a_bus_that_opens_with_the_service_publishes_no_event() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(10)
            assert [(await kit.call("buses.get", bus=bus))["is_open"] for bus in ("a", "b")] == [True, True]
            texts = [event["text"]["en"] for _, event in kit.service.plant.hub.items("events")]
            assert not [text for text in texts if text.startswith("bus ")]

    run(scenario())


def test_a_failure_counts_once_in_the_figures_of_its_bus() -> None:
    async def scenario() -> None:
        buses = (BusConfig("a", "sim://c320@1"), BusConfig("b", "sim://vc660@1,2"))
        async with running_service(plant_config(buses=buses)) as kit:
            await asyncio.sleep(10)
            bus = await kit.call("buses.get", bus="a")
            silent = next(station for station in bus["stations"] if station["address"] == 2)
            assert silent["errors"]["NoReply"] > 1
            assert bus["errors"] == silent["errors"]
            assert [station["error_rate"] for station in bus["stations"]] == [0.0, 1.0] and 0 < bus["error_rate"] < 1

    run(scenario())
