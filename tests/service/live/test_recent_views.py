"""Lists of drives reuse the objects of the supervision cycle, but never ones older than 2 s or than a command."""

from __future__ import annotations

import asyncio
import json
from dataclasses import replace
from pathlib import Path

import pytest

from drivebus.service.alarms import SystemAlarm
from drivebus.service.api import queries
from drivebus.service.config.load import load
from drivebus.service.live import recent_views
from drivebus.service.runtime import supervision
from drivebus.service.runtime.fairness import EncodedOnce, encode_json_cooperatively
from drivebus.testing.virtual_time import run
from fixtures.service import ServiceKit, running_service


async def owners(kit: ServiceKit) -> list[object]:
    return [drive["lease"] and drive["lease"]["owner"] for drive in (await kit.call("drives.list"))["drives"]]


def record_builds(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return the list to which each drive is added when its view is built for a list."""
    built: list[str] = []
    build = recent_views.drive_view
    monkeypatch.setattr(recent_views, "drive_view", lambda plant, drive: built.append(drive.id) or build(plant, drive))
    return built


def test_lists_of_recent_views_build_none_again(monkeypatch: pytest.MonkeyPatch) -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(2)
            built = record_builds(monkeypatch)
            first, second = [(await kit.call("drives.list"))["drives"] for _ in range(2)]
            assert first and all(view is later for view, later in zip(first, second, strict=True)) and built == []
            assert (await kit.call("drives.get", drive=first[0]["id"])).keys() == first[0].keys()
            monkeypatch.setattr(recent_views, "MAX_VIEW_AGE_S", -1.0)
            await kit.call("drives.list")
            assert len(built) == len(first), "an old view must not be listed"

    run(scenario())


def test_a_list_after_a_command_shows_the_command() -> None:
    """The view of the supervision cycle before it must not be listed."""

    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(2)
            assert not any(await owners(kit))
            drive = next(iter(kit.service.plant.drives))
            await kit.call("lease.take", drive=drive)
            assert any(await owners(kit))

    run(scenario())


def test_a_command_to_one_drive_builds_no_view_of_the_others_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Twelve stops a second once built all 300 views for every list, and used a whole core."""

    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(2)
            built = record_builds(monkeypatch)
            await kit.call("drive.stop", drive="fan-1")
            await asyncio.sleep(0.01)
            for _ in range(2):
                await kit.call("drives.list")
            assert sorted(built) == ["fan-1", "fan-2"], "once for both lists: the drive and the others of its group"

    run(scenario())


@pytest.mark.parametrize(
    "name, params, drives",
    [
        ("drive.stop", {"drive": "pump-1"}, {"pump-1"}),
        ("drive.stop", {"drive": "fan-1"}, {"fan-1", "fan-2"}),
        ("group.stop", {"group": "fans"}, {"fan-1", "fan-2"}),
        ("plant.stop", {}, {"fan-1", "fan-2", "pump-1", "pump-2"}),
    ],
)
def test_a_view_older_than_a_command_that_may_have_changed_it_is_not_listed(
    name: str, params: dict[str, str], drives: set[str]
) -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            plant, before = kit.service.plant, kit.service.plant.now()
            await kit.call(name, **params)
            assert {drive for drive in plant.drives if plant.last_command_at(drive) >= before} == drives

    run(scenario())


def test_the_time_of_a_command_goes_with_its_drive(tmp_path: Path) -> None:
    """A plant whose drives are renamed again and again kept an entry for each name, also by a stop under way."""
    file = tmp_path / "plant.toml"
    pump = '[drive.pump]\nbus = "a"\naddress = 1\nmodel = "c320"\n'
    fan = '[drive.fan]\nbus = "a"\naddress = 2\nmodel = "c320"\n'
    head = 'format = 1\n[plant]\nid = "hall"\ntitle = "Hall"\n[bus.a]\nport = "sim://c320@1-2"\n'
    file.write_text(head + pump + fan)

    async def scenario() -> None:
        async with running_service(load(file)) as kit:
            plant = kit.service.plant
            for drive in ("pump", "fan"):
                await kit.call("drive.stop", drive=drive)
            assert plant._last_commands_at.keys() == {"pump", "fan"}
            file.write_text(head + pump)
            await kit.call("configuration.reload")
            assert plant._last_commands_at.keys() == {"pump"}
            plant.record_command({"fan"})
            assert plant._last_commands_at.keys() == {"pump"}, "a command that ended after the reload"

    run(scenario())


def test_acknowledging_alarms_voids_the_view_of_a_drive_whose_alarm_is_then_gone() -> None:
    """Afterwards only the other alarm is found, and the list would go on counting the one that has gone."""

    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(2)
            plant = kit.service.plant
            for drive in ("fan-1", "pump-1"):
                plant.raise_alarm(SystemAlarm.RUNNING_AT_START, drive)
            plant.clear_alarm(SystemAlarm.RUNNING_AT_START, "fan-1")
            ids = [alarm.id for alarm in plant.alarms.active() if alarm.kind == SystemAlarm.RUNNING_AT_START]
            before = plant.now()
            await kit.call("alarms.acknowledge", alarms=ids)
            assert [alarm.drive for alarm in plant.alarms.active() if alarm.id in ids] == ["pump-1"]
            assert plant.last_command_at("fan-1") >= before

    run(scenario())


def test_a_view_in_which_nothing_changed_is_listed_with_its_new_time_and_not_encoded_again() -> None:
    """300 drives are encoded four times a second otherwise, though each is polled every two seconds."""

    async def scenario() -> None:
        async with running_service() as kit:
            plant = kit.service.plant
            drive = plant.drive_runtime("fan-1")
            views = recent_views.RecentDriveViews(plant)
            first = recent_views.drive_view(plant, drive)
            views.on_view(first)
            assert views.find("fan-1") is None, "not encoded yet"
            views.make(drive)
            views.on_view(replace(first, time_ms=first.time_ms + 250))
            listed = views.find("fan-1")
            assert listed is not None and listed.encode()[1] == 0, "it was encoded again"
            assert json.loads(listed.encode()[0]) == listed == first.as_json() | {"time_ms": first.time_ms + 250}
            views.on_view(replace(first, state="fault"))
            assert views.find("fan-1") is None, "a changed view must not be listed as the last one"

    run(scenario())


def test_an_object_that_is_encoded_once_gives_the_same_bytes_as_a_plain_one() -> None:
    content = {"title": {"zh": "风机"}, "values": [1, None, 2.5]}

    async def scenario() -> None:
        shared = EncodedOnce(content)
        for _ in range(2):
            found = await encode_json_cooperatively({"result": {"drives": [shared, shared]}})
            assert found == await encode_json_cooperatively({"result": {"drives": [content, content]}})
        assert shared.encode()[1] == 0, "it was encoded again"

    run(scenario())


def test_the_first_list_of_new_views_is_made_in_turns_and_later_ones_share_it(monkeypatch: pytest.MonkeyPatch) -> None:
    turns = 0

    async def count_turn() -> None:
        nonlocal turns
        turns += 1

    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(2)
            monkeypatch.setattr(queries, "ITEMS_PER_TURN", 1)
            monkeypatch.setattr(queries, "yield_to_loop", count_turn)
            for _ in range(2):
                await kit.call("drives.list")
                assert turns == len(kit.service.plant.drives)

    run(scenario())


def test_a_supervision_cycle_pauses_after_some_drives_and_not_after_each(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each pause is an iteration of the loop with a part of a request: 300 of them made a cycle ten times as long."""
    sleep, pauses = asyncio.sleep, 0

    async def counted(seconds: float) -> None:
        nonlocal pauses
        pauses += seconds == 0
        await sleep(seconds)

    async def scenario() -> None:
        async with running_service():
            await sleep(2)
            monkeypatch.setattr(supervision.asyncio, "sleep", counted)
            await sleep(1)
            monkeypatch.undo()
            assert 4 <= pauses <= 20, "four cycles of about ten steps"

    run(scenario())
