"""A waiver is for one drive: of one model, on one link, at one address."""

from __future__ import annotations

import asyncio
import json
from dataclasses import replace
from typing import Any

import pytest

from drivebus.drives import MemoryStore
from drivebus.errors import WaiverRequired
from drivebus.service.config.model import DriveConfig, PlantConfig
from drivebus.service.control.waivers import CommLossWaiver
from drivebus.testing.virtual_time import run
from fixtures.service import BUSES, DRIVES, ServiceKit, plant_config, running_service

OTHERS: dict[str, PlantConfig] = {
    "model": plant_config(drives=(replace(DRIVES[0], model="c300"), *DRIVES[1:])),
    "address": plant_config(drives=(replace(DRIVES[0], address=2), replace(DRIVES[1], address=1), *DRIVES[2:])),
    "link": plant_config(buses=(replace(BUSES[0], link=BUSES[0].link + "&name=other"), BUSES[1])),
}


async def lived(chosen: PlantConfig, store: MemoryStore, story: Any) -> None:
    """One life of a service with what the lives before it have kept."""
    async with running_service(chosen, store=store) as kit:
        await asyncio.sleep(1)
        await story(kit)


async def start(kit: ServiceKit) -> None:
    await kit.call("drive.run", drive="fan-1", frequency_hz=20.0)


async def waived(kit: ServiceKit) -> None:
    await kit.grant_waivers("fan-1")


def about(kit: ServiceKit) -> list[dict[str, str]]:
    """What was told of waivers."""
    return [event["text"] for _, event in kit.service.plant.hub.items("events") if event["kind"] == "waiver"]


@pytest.mark.parametrize("what", OTHERS)
def test_a_waiver_of_another_drive_of_this_name_is_ignored_and_said_in_both_languages(what: str) -> None:
    async def refused(kit: ServiceKit) -> None:
        view = await kit.call("drives.get", drive="fan-1")
        assert view["comm_loss"]["waiver"] is None
        assert "plant.waiver_of_another" in [one["key"] for one in view["start_blockers"]]
        with pytest.raises(WaiverRequired) as error:
            await start(kit)
        assert error.value.params["model"] == "c320" and error.value.params["address"] == "1"
        (message,) = about(kit)
        assert "does not apply" in message["en"] and BUSES[0].link in message["en"] and "不予采用" in message["zh"]
        assert kit.station("fan-1").motor.starts == 0

    async def mended(kit: ServiceKit) -> None:
        await kit.grant_waivers("fan-1")
        blocked = (await kit.call("drives.get", drive="fan-1"))["start_blockers"]
        assert not [one for one in blocked if one["key"].startswith("plant.waiver")]

    async def whole() -> None:
        store = MemoryStore()
        await lived(plant_config(), store, waived)
        await lived(OTHERS[what], store, refused)
        await lived(plant_config(), store, start)
        await lived(OTHERS[what], store, mended)

    run(whole())


def test_a_waiver_outlives_the_service_and_other_settings_of_its_drive() -> None:
    async def holds(kit: ServiceKit) -> None:
        assert about(kit) == []
        await start(kit)

    async def whole() -> None:
        store = MemoryStore()
        await lived(plant_config(), store, waived)
        await lived(
            plant_config(drives=(replace(DRIVES[0], signals={"output_frequency": 0.5}), *DRIVES[1:])), store, holds
        )

    run(whole())


def test_a_waiver_that_was_kept_without_its_drive_is_ignored() -> None:
    """Nobody knows of which drive it was."""

    async def refused(kit: ServiceKit) -> None:
        with pytest.raises(WaiverRequired) as error:
            await start(kit)
        assert error.value.key == "plant.waiver_of_another" and error.value.params["address"] == "?"

    async def whole() -> None:
        store = MemoryStore()
        store.put("waiver/fan-1", json.dumps("tested (eve)"))
        await lived(plant_config(), store, refused)

    run(whole())


def test_a_waiver_that_was_taken_back_is_none_of_another() -> None:
    async def taken_back(kit: ServiceKit) -> None:
        await kit.call("waiver.revoke", drive="fan-1")
        await refused(kit)

    async def refused(kit: ServiceKit) -> None:
        with pytest.raises(WaiverRequired) as error:
            await start(kit)
        assert error.value.key == "plant.waiver_needed"

    async def whole() -> None:
        store = MemoryStore()
        await lived(plant_config(), store, waived)
        await lived(OTHERS["address"], store, taken_back)
        await lived(plant_config(), store, refused)

    run(whole())


def test_what_is_kept_is_read_back() -> None:
    drive: DriveConfig = DRIVES[0]
    waiver = CommLossWaiver.for_drive("why (ann)", drive, BUSES[0])
    assert CommLossWaiver.from_json(waiver.to_json()) == waiver and waiver.applies_to(drive, BUSES[0])
    assert CommLossWaiver.from_json("") is None and CommLossWaiver.from_json(None) is None
    older = CommLossWaiver.from_json(json.dumps("tested (eve)"))
    assert older is not None and older.recorded_for == {"model": "?", "link": "?", "address": "?"}
