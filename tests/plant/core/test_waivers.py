"""A waiver is for one drive: of one model, on one link, at one address (F18)."""

from __future__ import annotations

import asyncio
import json
from dataclasses import replace
from typing import Any

import pytest

from drivebus.drives import MemoryStore
from drivebus.errors import WaiverNeeded
from drivebus.plant.model import DriveSetting, PlantSetting
from drivebus.plant.waivers import Waiver
from drivebus.testing.virtual import run
from plantkit import BUSES, DRIVES, Kit, plant, setting

OTHERS: dict[str, PlantSetting] = {
    "model": setting(drives=(replace(DRIVES[0], model="c300"), *DRIVES[1:])),
    "address": setting(drives=(replace(DRIVES[0], address=2), replace(DRIVES[1], address=1), *DRIVES[2:])),
    "link": setting(buses=(replace(BUSES[0], link=BUSES[0].link + "&name=other"), BUSES[1])),
}


async def lived(chosen: PlantSetting, store: MemoryStore, story: Any) -> None:
    """One life of a service with what the lives before it have kept."""
    async with plant(chosen, store=store) as kit:
        await asyncio.sleep(1)
        await story(kit)


async def start(kit: Kit) -> None:
    await kit.call("drive.run", drive="fan-1", frequency_hz=20.0)


async def waived(kit: Kit) -> None:
    await kit.waive("fan-1")


def about(kit: Kit) -> list[dict[str, str]]:
    """What was told of waivers."""
    return [event["text"] for _, event in kit.service.plant.hub.items("events") if event["kind"] == "waiver"]


@pytest.mark.parametrize("what", OTHERS)
def test_a_waiver_of_another_drive_of_this_name_is_ignored_and_said_in_both_languages(what: str) -> None:
    async def refused(kit: Kit) -> None:
        view = await kit.call("drives.get", drive="fan-1")
        assert view["host_dies"]["waiver"] is None
        assert "plant.waiver_of_another" in [one["key"] for one in view["blocked"]]
        with pytest.raises(WaiverNeeded) as error:
            await start(kit)
        assert error.value.params["model"] == "c320" and error.value.params["address"] == "1"
        (told,) = about(kit)
        assert "is ignored" in told["en"] and BUSES[0].link in told["en"] and "不予采用" in told["zh"]
        assert kit.station("fan-1").motor.starts == 0

    async def mended(kit: Kit) -> None:
        await kit.waive("fan-1")
        blocked = (await kit.call("drives.get", drive="fan-1"))["blocked"]
        assert not [one for one in blocked if one["key"].startswith("plant.waiver")]

    async def whole() -> None:
        store = MemoryStore()
        await lived(setting(), store, waived)
        await lived(OTHERS[what], store, refused)
        await lived(setting(), store, start)
        await lived(OTHERS[what], store, mended)

    run(whole())


def test_a_waiver_outlives_the_service_and_other_settings_of_its_drive() -> None:
    async def holds(kit: Kit) -> None:
        assert about(kit) == []
        await start(kit)

    async def whole() -> None:
        store = MemoryStore()
        await lived(setting(), store, waived)
        await lived(setting(drives=(replace(DRIVES[0], signals={"output_frequency": 0.5}), *DRIVES[1:])), store, holds)

    run(whole())


def test_a_waiver_that_was_kept_without_its_drive_is_ignored() -> None:
    """Nobody knows of which drive it was."""

    async def refused(kit: Kit) -> None:
        with pytest.raises(WaiverNeeded) as error:
            await start(kit)
        assert error.value.key == "plant.waiver_of_another" and error.value.params["address"] == "?"

    async def whole() -> None:
        store = MemoryStore()
        store.put("waiver/fan-1", json.dumps("tested (eve)"))
        await lived(setting(), store, refused)

    run(whole())


def test_a_waiver_that_was_taken_back_is_none_of_another() -> None:
    async def taken_back(kit: Kit) -> None:
        await kit.call("drive.unwaive", drive="fan-1")
        await refused(kit)

    async def refused(kit: Kit) -> None:
        with pytest.raises(WaiverNeeded) as error:
            await start(kit)
        assert error.value.key == "plant.waiver_needed"

    async def whole() -> None:
        store = MemoryStore()
        await lived(setting(), store, waived)
        await lived(OTHERS["address"], store, taken_back)
        await lived(setting(), store, refused)

    run(whole())


def test_what_is_kept_is_read_back() -> None:
    drive: DriveSetting = DRIVES[0]
    waiver = Waiver.of("why (ann)", drive, BUSES[0])
    assert Waiver.kept(waiver.to_keep()) == waiver and waiver.fits(drive, BUSES[0])
    assert Waiver.kept("") is None and Waiver.kept(None) is None
    older = Waiver.kept(json.dumps("tested (eve)"))
    assert older is not None and older.whose == {"model": "?", "link": "?", "address": "?"}
