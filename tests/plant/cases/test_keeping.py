"""A whole plant that trips: the alarm, its case, and what people do with them."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from drivebus.capture import read_capture
from drivebus.drives import MemoryStore
from drivebus.errors import NotFound
from drivebus.plant.alarms import AlarmBook
from drivebus.plant.alarms.log import AlarmLog
from drivebus.plant.cases import CaseStore
from drivebus.plant.interlocks import Interlocks
from drivebus.plant.keeping import Keeping
from drivebus.plant.parts import Parts
from drivebus.plant.service import Service
from drivebus.plant.view import Sample
from drivebus.sim.plate import Trip
from drivebus.sim.port import forget_benches
from drivebus.testing.virtual import run
from plantkit import Kit, PaperHistory, PaperTrail, remote, setting


class Tee(PaperHistory):
    """A history that the recorder listens to."""

    keeping: Keeping
    events: list[dict[str, Any]]

    def event(self, event: dict[str, Any]) -> None:
        self.events.append(event)
        self.keeping.event(event)

    def append(self, samples: list[Sample]) -> None:  # type: ignore[override]
        super().append(samples)
        self.keeping.samples(samples)


@asynccontextmanager
async def plant(folder: Path) -> AsyncIterator[Kit]:
    chosen = setting()
    log = AlarmLog(folder / "alarms.jsonl")
    keeping = Keeping(log, CaseStore(folder / "cases"), asyncio.get_running_loop().time)
    alarms = AlarmBook((), chosen.drives, keeping, log.load(), first=log.first)
    trail, history = PaperTrail(), Tee()
    history.keeping, history.events = keeping, []
    parts = Parts(
        trail, history, alarms, Interlocks(()), keeping.handlers(), on_event=history.event, on_view=keeping.view,
        on_plant=keeping.bind,
    )  # fmt: skip
    service = Service(chosen, parts, store=MemoryStore(), drive_store=MemoryStore())
    try:
        async with service:
            yield Kit(service, trail, history, MemoryStore())
        await keeping.close()
        await log.close()
    finally:
        forget_benches()


async def trip(kit: Kit) -> dict[str, Any]:
    await asyncio.sleep(5)
    await kit.waive("fan-1")
    await kit.call("drive.run", drive="fan-1", frequency_hz=20.0)
    await asyncio.sleep(20)
    kit.station("fan-1").trip(Trip.UNDERVOLTAGE)
    await asyncio.sleep(4)
    (alarm,) = await faults(kit)
    return alarm


async def faults(kit: Kit) -> list[dict[str, Any]]:
    return [one for one in (await kit.call("alarms.list"))["active"] if one["kind"] == "fault"]


def test_a_trip_raises_an_alarm_with_a_case_that_shows_the_minute_before(tmp_path: Path) -> None:
    async def story() -> None:
        async with plant(tmp_path) as kit:
            alarm = await trip(kit)
            assert (alarm["drive"], alarm["priority"], alarm["value"]) == ("fan-1", "urgent", 5)
            told = [
                one["outcome"] for one in kit.history.events if one["kind"] == "alarm" and "fault" in one["text"]["en"]
            ]
            assert told == ["raised"], "once, though it got its case afterwards"
            (listed,) = (await kit.call("cases.list"))["items"]
            assert listed["id"] == alarm["case"] == "000001-fan-1"
            case = await kit.call("cases.get", case=alarm["case"])
            assert case["view"]["fault"]["code"] == 5 and case["view"]["state"] == "fault"
            states = [one["state"] for one in case["states"]]
            assert states[-1] == "fault" and "running" in states
            frequencies = case["signals"]["output_frequency"]
            assert max(value or 0.0 for value in frequencies["v"]) == 20.0
            assert len(frequencies["t"]) > 20 and frequencies["t"][-1] <= 0.0
            assert 20 < len(case["frames"]) <= 200
            assert [one["text"]["en"] for one in case["events"] if one["kind"] == "command"]
            assert {"F0.1", "F9.3", "F9.4"} <= case["parameters"].keys()
            (tmp_path / "x.dbcap").write_text(case["capture"]["text"])
            assert len(read_capture(tmp_path / "x.dbcap").records) > 20

    run(story())


def test_people_acknowledge_and_shelve_and_the_history_keeps_it_over_a_restart(tmp_path: Path) -> None:
    async def story() -> None:
        async with plant(tmp_path) as kit:
            alarm = await trip(kit)
            found = await kit.call("alarm.shelve", remote(), alarm=alarm["id"], minutes=5, reason="known trouble")
            assert found["shelved_until_ms"] > alarm["raised_ms"]
            await kit.call("alarm.unshelve", remote(), alarm=alarm["id"])
            await kit.call("alarm.acknowledge", remote(), alarm=alarm["id"])
            with pytest.raises(NotFound):
                await kit.call("alarm.acknowledge", remote(), alarm="a99")
            assert kit.trail.outcomes("alarm.acknowledge") == ["asked", "done", "asked", "alarms.unknown"]
        async with plant(tmp_path) as kit:
            (again,) = await faults(kit)
            assert (again["id"], again["by"], again["case"]) == (alarm["id"], "ann", alarm["case"])
            await asyncio.sleep(5)
            assert await faults(kit) == []
            kept = [one for one in (await kit.call("alarms.history", drive="fan-1"))["items"] if one["kind"] == "fault"]
            assert [(one["id"], one["cleared_ms"] is None) for one in kept] == [(alarm["id"], False)]
            assert (await kit.call("alarms.history", drive="fan-2"))["items"] == []
            with pytest.raises(NotFound):
                await kit.call("cases.get", case="000009-fan-1")

    run(story())


def test_a_store_that_fails_in_the_background_is_an_alarm_until_it_works_again(tmp_path: Path) -> None:
    async def story() -> None:
        async with plant(tmp_path) as kit:
            (tmp_path / "cases").write_text("a file where the folder should be")
            alarm = await trip(kit)
            await asyncio.sleep(6)
            (store,) = [one for one in (await kit.call("alarms.list"))["active"] if one["kind"] == "store"]
            assert (store["about"], store["cleared_ms"], alarm["case"]) == ("cases", None, None)
            (tmp_path / "cases").unlink()
            await kit.call("alarm.shelve", alarm=alarm["id"], minutes=1, reason="to be looked at")
            await asyncio.sleep(1)
            assert (await kit.call("cases.list"))["items"] == [], "a shelf is no trip"
            kit.station("fan-2").trip(Trip.OVERLOAD)
            await asyncio.sleep(12)
            assert [one["drive"] for one in (await kit.call("cases.list"))["items"]] == ["fan-2"]
            (store,) = [one for one in (await kit.call("alarms.list"))["active"] if one["kind"] == "store"]
            assert store["cleared_ms"] is not None

    run(story())
