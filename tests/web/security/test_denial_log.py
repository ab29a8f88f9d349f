"""Denial log: the first of a kind is recorded at once, the others as a number, and no request waits long."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from drivebus.errors import ServiceUnavailable
from drivebus.service.auth.actor import Actor
from drivebus.testing.virtual_time import run
from drivebus.web.middleware.denial_log import ANONYMOUS, MAX_KINDS_PER_PERIOD, SUMMARY_PERIOD_S, DenialLog, try_record
from fixtures.web_app import CountingService

EVE = Actor("eve", frozenset(), "s-eve", address="10.0.0.9")
ENTRY = {"what": "refused"}


class Fails(CountingService):
    """A plant whose record fails, or takes so long."""

    def __init__(self, how: BaseException | float) -> None:
        super().__init__()
        self.how = how

    async def record(self, entry: dict[str, Any], actor: Actor) -> None:
        if isinstance(self.how, BaseException):
            raise self.how
        await asyncio.sleep(self.how)
        await super().record(entry, actor)


def told(plant: CountingService) -> list[tuple[str, str, int, str]]:
    """Target, who, how often, why."""
    return [(one["target"], one["params"]["who"], one["params"]["times"], one["outcome"]) for one, _ in plant.records]


def refusals(plant: CountingService) -> DenialLog:
    return DenialLog(plant, asyncio.get_running_loop().time)


def test_the_anonymous_actor_is_remote_and_has_no_rights() -> None:
    assert Actor("", frozenset(), "", remote=True, address="") == ANONYMOUS


@pytest.mark.parametrize("error", [OSError(28, "full"), ServiceUnavailable("plant.gone"), TimeoutError()])
def test_a_trail_that_can_not_be_reached_is_no_error(error: BaseException) -> None:
    assert run(try_record(Fails(error), ENTRY, EVE)) is False


def test_recording_a_denial_takes_at_most_two_seconds() -> None:
    async def story() -> tuple[bool, bool, float]:
        in_time = await try_record(Fails(1.99), ENTRY, EVE)
        begun = asyncio.get_running_loop().time()
        too_late = await try_record(Fails(60.0), ENTRY, EVE)
        return in_time, too_late, asyncio.get_running_loop().time() - begun

    assert run(story()) == (True, False, 2.0)


def test_the_first_denial_of_a_kind_is_recorded_at_once_and_the_others_as_a_number() -> None:
    plant = CountingService()

    async def story() -> None:
        door = refusals(plant)
        for _ in range(3):
            await door.record_denial("POST", "/stop", "auth.csrf", EVE)
        await door.record_denial("GET", "/stop", "auth.csrf", EVE)
        await door.record_denial("POST", "/run", "auth.csrf", EVE)
        await door.record_denial("POST", "/stop", "auth.forbidden", EVE)
        await door.record_denial("POST", "/stop", "auth.csrf", ANONYMOUS)
        once = [
            ("POST /stop", "eve@10.0.0.9", 1, "auth.csrf"),
            ("GET /stop", "eve@10.0.0.9", 1, "auth.csrf"),
            ("POST /run", "eve@10.0.0.9", 1, "auth.csrf"),
            ("POST /stop", "eve@10.0.0.9", 1, "auth.forbidden"),
            ("POST /stop", "@", 1, "auth.csrf"),
        ]
        assert told(plant) == once
        await asyncio.sleep(SUMMARY_PERIOD_S - 0.1)
        assert told(plant) == once
        await asyncio.sleep(0.2)
        assert told(plant) == [*once, ("POST /stop", "eve@10.0.0.9", 2, "auth.csrf")]
        assert [who for _, who in plant.records] == [EVE] * 4 + [ANONYMOUS] * 2
        assert {one["what"] for one, _ in plant.records} == {"refused"}
        await asyncio.sleep(10 * SUMMARY_PERIOD_S)
        assert len(plant.records) == 6, "nothing is told twice"

    run(story())


def test_the_number_is_recorded_before_a_new_period() -> None:
    plant = CountingService()

    async def story() -> None:
        door = refusals(plant)
        now = 100.0
        door.clock = lambda: now
        for _ in range(2):
            await door.record_denial("POST", "/stop", "k", EVE)
        now += SUMMARY_PERIOD_S - 0.1
        await door.record_denial("POST", "/stop", "k", EVE)
        assert len(plant.records) == 1
        now += 0.1
        await door.record_denial("POST", "/stop", "k", EVE)
        now += SUMMARY_PERIOD_S - 0.1
        await door.record_denial("POST", "/stop", "k", EVE)
        assert [times for _, _, times, _ in told(plant)] == [1, 2, 1]
        await door.flush()
        assert [times for _, _, times, _ in told(plant)] == [1, 2, 1, 1]

    run(story())


def test_kinds_beyond_the_limit_of_a_period_are_counted_together() -> None:
    plant = CountingService()

    async def story() -> None:
        door = refusals(plant)
        for n in range(MAX_KINDS_PER_PERIOD + 5):
            await door.record_denial("POST", f"/{n}", "k", EVE)
        await door.record_denial("POST", "/0", "k", EVE)
        assert [target for target, *_ in told(plant)] == [f"POST /{n}" for n in range(MAX_KINDS_PER_PERIOD)]
        assert sum(task.get_name() == "denial log" for task in asyncio.all_tasks()) == 1
        await door.flush()
        assert told(plant)[MAX_KINDS_PER_PERIOD:] == [("POST /0", "eve@10.0.0.9", 1, "k"), ("* *", "*", 5, "*")]
        await door.record_denial("POST", "/0", "k", EVE)
        assert told(plant)[-1] == ("POST /0", "eve@10.0.0.9", 1, "k"), "what was told begins anew"

    run(story())


def test_a_second_flood_is_counted_as_the_first() -> None:
    plant = CountingService()

    async def story() -> None:
        door = refusals(plant)
        for _ in range(2):
            for _ in range(3):
                await door.record_denial("POST", "/stop", "k", EVE)
            await asyncio.sleep(SUMMARY_PERIOD_S + 1)
        assert [times for _, _, times, _ in told(plant)] == [1, 2, 1, 2]

    run(story())
