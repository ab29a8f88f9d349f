"""Waivers: each applies to one drive of one model, on one link, at one address."""

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

OTHER_DRIVES: dict[str, PlantConfig] = {
    "model": plant_config(drives=(replace(DRIVES[0], model="c300"), *DRIVES[1:])),
    "address": plant_config(drives=(replace(DRIVES[0], address=2), replace(DRIVES[1], address=1), *DRIVES[2:])),
    "port": plant_config(buses=(replace(BUSES[0], port=BUSES[0].port + "&name=other"), BUSES[1])),
}


async def run_service(config: PlantConfig, store: MemoryStore, scenario: Any) -> None:
    """Run a scenario in one service after another that share a store."""
    async with running_service(config, store=store) as kit:
        await asyncio.sleep(1)
        await scenario(kit)


async def start(kit: ServiceKit) -> None:
    await kit.call("drive.run", drive="fan-1", frequency_hz=20.0)


async def grant(kit: ServiceKit) -> None:
    await kit.grant_waivers("fan-1")


def waiver_events(kit: ServiceKit) -> list[dict[str, str]]:
    return [event["text"] for _, event in kit.service.plant.hub.items("events") if event["kind"] == "waiver"]


@pytest.mark.parametrize("changed", OTHER_DRIVES)
def test_a_waiver_of_another_drive_with_this_id_is_ignored_and_reported(changed: str) -> None:
    async def rejected(kit: ServiceKit) -> None:
        view = await kit.call("drives.get", drive="fan-1")
        assert view["comm_loss"]["waiver"] is None
        assert "plant.waiver_of_another" in [blocker["key"] for blocker in view["start_blockers"]]
        with pytest.raises(WaiverRequired) as error:
            await start(kit)
        assert error.value.params["model"] == "c320" and error.value.params["address"] == "1"
        (text,) = waiver_events(kit)
        assert "does not apply" in text["en"] and BUSES[0].port in text["en"] and "不适用" in text["zh"]
        recorded = {"model": "c320", "port": BUSES[0].port, "address": "1"}
        assert kit.drives_of_events("plant.waiver_ignored", **recorded) == ["fan-1"]
        assert kit.station("fan-1").motor.starts == 0

    async def granted_again(kit: ServiceKit) -> None:
        await kit.grant_waivers("fan-1")
        blocked = (await kit.call("drives.get", drive="fan-1"))["start_blockers"]
        assert not [blocker for blocker in blocked if blocker["key"].startswith("plant.waiver")]

    async def scenario() -> None:
        store = MemoryStore()
        await run_service(plant_config(), store, grant)
        await run_service(OTHER_DRIVES[changed], store, rejected)
        await run_service(plant_config(), store, start)
        await run_service(OTHER_DRIVES[changed], store, granted_again)

    run(scenario())


def test_a_waiver_survives_a_restart_and_other_settings_of_its_drive() -> None:
    async def start_without_notice(kit: ServiceKit) -> None:
        assert waiver_events(kit) == []
        await start(kit)

    async def scenario() -> None:
        store = MemoryStore()
        await run_service(plant_config(), store, grant)
        await run_service(
            plant_config(drives=(replace(DRIVES[0], signals={"output_frequency": 0.5}), *DRIVES[1:])),
            store,
            start_without_notice,
        )

    run(scenario())


def test_a_stored_waiver_without_its_drive_is_ignored() -> None:
    async def rejected(kit: ServiceKit) -> None:
        with pytest.raises(WaiverRequired) as error:
            await start(kit)
        assert error.value.key == "plant.waiver_of_another" and error.value.params["address"] == "?"

    async def scenario() -> None:
        store = MemoryStore()
        store.put("waiver/fan-1", json.dumps("tested (eve)"))
        await run_service(plant_config(), store, rejected)

    run(scenario())


def test_a_revoked_waiver_is_not_reported_as_that_of_another_drive() -> None:
    async def granted(kit: ServiceKit) -> None:
        await grant(kit)
        assert kit.drives_of_events("plant.waived", reason="test bench") == ["fan-1"]
        assert kit.drives_of_events("plant.unwaived") == []

    async def revoke(kit: ServiceKit) -> None:
        await kit.call("waiver.revoke", drive="fan-1")
        assert kit.drives_of_events("plant.unwaived") == ["fan-1"]
        await rejected(kit)

    async def rejected(kit: ServiceKit) -> None:
        with pytest.raises(WaiverRequired) as error:
            await start(kit)
        assert error.value.key == "plant.waiver_needed"

    async def scenario() -> None:
        store = MemoryStore()
        await run_service(plant_config(), store, granted)
        await run_service(OTHER_DRIVES["address"], store, revoke)
        await run_service(plant_config(), store, rejected)

    run(scenario())


def test_a_waiver_keeps_its_content_through_json() -> None:
    drive: DriveConfig = DRIVES[0]
    waiver = CommLossWaiver.for_drive("why (ann)", drive, BUSES[0])
    assert CommLossWaiver.from_json(waiver.to_json()) == waiver and waiver.applies_to(drive, BUSES[0])
    assert CommLossWaiver.from_json("") is None and CommLossWaiver.from_json(None) is None
    older = CommLossWaiver.from_json(json.dumps("tested (eve)"))
    assert older is not None and older.recorded_for == {"model": "?", "port": "?", "address": "?"}
