"""Several alarms acknowledged, shelved and unshelved at once: a result for each, one audit record for all."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from drivebus.errors import InvalidParameters, PermissionDenied
from drivebus.service.alarms import SystemAlarm
from drivebus.service.auth.rights import Role
from drivebus.testing.virtual_time import run
from fixtures.service import ServiceKit, remote_actor, running_service

ANN = remote_actor("ann")
REASON = "cable is being repaired"


def active(kit: ServiceKit) -> list[Any]:
    return kit.service.plant.alarms.active()


def scenario_with_alarms(scenario: Callable[[ServiceKit, list[str]], Awaitable[None]]) -> None:
    """Run a scenario with the alarms of two drives and of a bus."""

    async def play() -> None:
        async with running_service() as kit:
            await asyncio.sleep(2)
            plant = kit.service.plant
            for drive in ("fan-1", "fan-2"):
                plant.raise_alarm(SystemAlarm.STOP_UNCONFIRMED, drive, subject="kept")
            plant.raise_alarm(SystemAlarm.STOP_UNCONFIRMED, subject="bus a")
            await scenario(kit, [alarm.id for alarm in active(kit)])

    run(play())


def test_a_group_is_shelved_with_one_author_reason_and_end_and_unshelved_as_a_group() -> None:
    async def scenario(kit: ServiceKit, ids: list[str]) -> None:
        found = await kit.call("alarms.shelve", ANN, alarms=ids, minutes=60, reason=REASON)
        assert found == {"outcomes": {id: {"status": "done"} for id in ids}}
        (shelving,) = {(alarm.shelved_by, alarm.shelved_reason, alarm.shelved_until_ms) for alarm in active(kit)}
        assert shelving[:2] == ("ann", REASON) and shelving[2] is not None
        shelved = [event for event in kit.history.events if event["outcome"] == "shelved"]
        assert [event["actor"] for event in shelved] == ["ann"] * 3, "the event names who shelved"
        again = await kit.call("alarms.unshelve", ANN, alarms=ids)
        assert again == found and {alarm.shelved_until_ms for alarm in active(kit)} == {None}
        assert (await kit.call("alarms.unshelve", ANN, alarms=ids[:1]))["outcomes"] == {ids[0]: {"status": "unchanged"}}

    scenario_with_alarms(scenario)


def test_one_audit_record_names_every_alarm_and_drive_of_the_selection() -> None:
    async def scenario(kit: ServiceKit, ids: list[str]) -> None:
        await kit.call("alarms.acknowledge", ANN, alarms=ids)
        requested, done = (entry for entry in kit.trail.entries if entry.what == "alarms.acknowledge")
        assert (requested.outcome, done.outcome) == ("requested", "done")
        assert done.params["alarms"] == ids and sorted(done.params["drives"]) == ["fan-1", "fan-2"]
        assert done.params["alarm_title"]["en"] == active(kit)[0].title.en

    scenario_with_alarms(scenario)


def test_the_audit_record_holds_no_names_that_a_client_invents() -> None:
    """A thousand of a hundred characters made 100 kB of each request in the trail."""

    async def scenario(kit: ServiceKit, ids: list[str]) -> None:
        await kit.call("alarms.acknowledge", ANN, alarms=[*(f"{number:0100}" for number in range(900)), *ids, *ids])
        for entry in kit.trail.entries[-2:]:
            assert (entry.what, entry.params["alarms"]) == ("alarms.acknowledge", ids)

    scenario_with_alarms(scenario)


def test_alarms_of_different_kinds_have_no_common_title_in_the_record() -> None:
    async def scenario(kit: ServiceKit, ids: list[str]) -> None:
        kit.service.plant.raise_alarm(SystemAlarm.PORT_LOST, subject="b")
        await kit.call("alarms.acknowledge", ANN, alarms=[alarm.id for alarm in active(kit)])
        assert "alarm_title" not in kit.trail.entries[-1].params

    scenario_with_alarms(scenario)


def test_an_alarm_that_another_user_has_finished_is_an_error_of_its_own() -> None:
    async def scenario(kit: ServiceKit, ids: list[str]) -> None:
        await kit.call("alarm.acknowledge", alarm=ids[0])
        found = (await kit.call("alarms.acknowledge", ANN, alarms=[*ids, "a999", ids[1]]))["outcomes"]
        assert found.pop("a999")["code"] == "alarms.unknown"
        assert found == {id: {"status": "done" if id != ids[0] else "unchanged"} for id in ids}
        assert {alarm.id: alarm.acknowledged_by for alarm in active(kit)}[ids[0]] == "tester", (
            "the first user stays named"
        )

    scenario_with_alarms(scenario)


def test_a_viewer_and_an_empty_selection_are_refused() -> None:
    async def scenario(kit: ServiceKit, ids: list[str]) -> None:
        with pytest.raises(PermissionDenied):
            await kit.call("alarms.shelve", remote_actor("vera", Role.VIEWER), alarms=ids, minutes=5, reason=REASON)
        with pytest.raises(InvalidParameters):
            await kit.call("alarms.acknowledge", ANN, alarms=[])

    scenario_with_alarms(scenario)


def test_hundreds_of_alarms_are_changed_in_turns_with_the_buses() -> None:
    async def scenario(kit: ServiceKit, ids: list[str]) -> None:
        for n in range(100):
            kit.service.plant.raise_alarm(SystemAlarm.STOP_UNCONFIRMED, subject=f"x{n}")
        turns = 0

        async def count_turns() -> None:
            nonlocal turns
            while True:
                turns += 1
                await asyncio.sleep(0)

        counting = asyncio.create_task(count_turns())
        await kit.call("alarms.shelve", ANN, alarms=[alarm.id for alarm in active(kit)], minutes=5, reason=REASON)
        counting.cancel()
        assert turns >= 103 // 8, "a stop would wait until all alarms are changed"

    scenario_with_alarms(scenario)
