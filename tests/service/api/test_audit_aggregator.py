"""Audit aggregator: the first denial of a kind is recorded at once, the others as a count; no request waits long."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from drivebus.errors import ServiceUnavailable
from drivebus.service.api.audit_aggregator import (
    ANONYMOUS,
    MAX_KINDS_PER_PERIOD,
    SUMMARY_PERIOD_S,
    AuditAggregator,
    RecordKind,
    try_record,
)
from drivebus.service.auth.actor import Actor
from drivebus.testing.virtual_time import run
from fixtures.web_app import CountingService

EVE = Actor("eve", frozenset(), "s-eve", address="10.0.0.9")
ENTRY = {"what": "refused"}


class FailingService(CountingService):
    """A plant whose audit record fails or takes a given time."""

    def __init__(self, how: BaseException | float) -> None:
        super().__init__()
        self.how = how

    async def record(self, entry: dict[str, Any], actor: Actor) -> None:
        if isinstance(self.how, BaseException):
            raise self.how
        await asyncio.sleep(self.how)
        await super().record(entry, actor)


def recorded_denials(plant: CountingService) -> list[tuple[str, str, int, str]]:
    """Return target, actor, count and reason of each record."""
    return [
        (entry["target"], entry["params"]["who"], entry["params"]["times"], entry["outcome"])
        for entry, _ in plant.records
    ]


def audit_aggregator(plant: CountingService) -> AuditAggregator:
    return AuditAggregator(plant, asyncio.get_running_loop().time)


def test_the_limits_of_the_audit_aggregator_bound_it_to_25_megabytes_a_day() -> None:
    assert (SUMMARY_PERIOD_S, MAX_KINDS_PER_PERIOD) == (30, 16)


def test_the_anonymous_actor_is_remote_and_has_no_rights() -> None:
    assert Actor("", frozenset(), "", remote=True, address="") == ANONYMOUS


@pytest.mark.parametrize("error", [OSError(28, "full"), ServiceUnavailable("plant.gone"), TimeoutError()])
def test_an_unavailable_audit_trail_raises_no_error(error: BaseException) -> None:
    assert run(try_record(FailingService(error), ENTRY, EVE)) is False


def test_recording_a_denial_takes_at_most_two_seconds() -> None:
    async def scenario() -> tuple[bool, bool, float]:
        in_time = await try_record(FailingService(1.99), ENTRY, EVE)
        begun = asyncio.get_running_loop().time()
        too_late = await try_record(FailingService(60.0), ENTRY, EVE)
        return in_time, too_late, asyncio.get_running_loop().time() - begun

    assert run(scenario()) == (True, False, 2.0)


def test_the_first_denial_of_a_kind_is_recorded_at_once_and_the_others_as_a_count() -> None:
    plant = CountingService()

    async def scenario() -> None:
        aggregator = audit_aggregator(plant)
        for _ in range(3):
            await aggregator.record_denial("POST", "/stop", "auth.csrf", EVE)
        await aggregator.record_denial("GET", "/stop", "auth.csrf", EVE)
        await aggregator.record_denial("POST", "/run", "auth.csrf", EVE)
        await aggregator.record_denial("POST", "/stop", "auth.forbidden", EVE)
        await aggregator.record_denial("POST", "/stop", "auth.csrf", ANONYMOUS)
        once = [
            ("POST /stop", "eve@10.0.0.9", 1, "auth.csrf"),
            ("GET /stop", "eve@10.0.0.9", 1, "auth.csrf"),
            ("POST /run", "eve@10.0.0.9", 1, "auth.csrf"),
            ("POST /stop", "eve@10.0.0.9", 1, "auth.forbidden"),
            ("POST /stop", "@", 1, "auth.csrf"),
        ]
        assert recorded_denials(plant) == once
        await asyncio.sleep(SUMMARY_PERIOD_S - 0.1)
        assert recorded_denials(plant) == once
        await asyncio.sleep(0.2)
        assert recorded_denials(plant) == [*once, ("POST /stop", "eve@10.0.0.9", 2, "auth.csrf")]
        assert [who for _, who in plant.records] == [EVE] * 4 + [ANONYMOUS] * 2
        assert {entry["what"] for entry, _ in plant.records} == {"refused"}
        await asyncio.sleep(10 * SUMMARY_PERIOD_S)
        assert len(plant.records) == 6, "nothing is recorded twice"

    run(scenario())


def test_the_count_is_recorded_before_a_new_period() -> None:
    plant = CountingService()

    async def scenario() -> None:
        aggregator = audit_aggregator(plant)
        now = 100.0
        aggregator.clock = lambda: now
        for _ in range(2):
            await aggregator.record_denial("POST", "/stop", "k", EVE)
        now += SUMMARY_PERIOD_S - 0.1
        await aggregator.record_denial("POST", "/stop", "k", EVE)
        assert len(plant.records) == 1
        now += 0.1
        await aggregator.record_denial("POST", "/stop", "k", EVE)
        now += SUMMARY_PERIOD_S - 0.1
        await aggregator.record_denial("POST", "/stop", "k", EVE)
        assert [times for _, _, times, _ in recorded_denials(plant)] == [1, 2, 1]
        await aggregator.flush()
        assert [times for _, _, times, _ in recorded_denials(plant)] == [1, 2, 1, 1]

    run(scenario())


@pytest.mark.parametrize("waited_s", [1.0, SUMMARY_PERIOD_S + 0.5])
def test_the_end_of_the_process_records_the_count_and_leaves_no_task(waited_s: float) -> None:
    """That holds where the period has just ended, and its record is being written, too."""
    plant = FailingService(1.0)

    async def scenario() -> None:
        aggregator = audit_aggregator(plant)
        for _ in range(3):
            await aggregator.record_denial("POST", "/stop", "k", EVE)
        await asyncio.sleep(waited_s)
        await aggregator.close()
        assert [times for _, _, times, _ in recorded_denials(plant)] == [1, 2]
        assert not [task for task in asyncio.all_tasks() if task.get_name() == "audit aggregator"]

    run(scenario())


def test_a_denial_while_the_last_counts_are_written_is_recorded_at_once_and_leaves_no_task() -> None:
    """Regression: it made a new task, which waited 30 s for a process that ended."""
    plant = FailingService(1.0)

    async def scenario() -> None:
        aggregator = audit_aggregator(plant)
        for _ in range(3):
            await aggregator.record_denial("POST", "/stop", "k", EVE)
        closing = asyncio.create_task(aggregator.close())
        await asyncio.sleep(0.5)
        for _ in range(2):
            assert await aggregator.count(RecordKind.of("refused", "POST /stop", "k", EVE)), "the caller records it"
        await closing
        assert await aggregator.count(RecordKind.of("refused", "POST /stop", "k", EVE)), "nor is a later one counted"
        assert recorded_denials(plant) == [("POST /stop", "eve@10.0.0.9", times, "k") for times in (1, 2)]
        assert not [task for task in asyncio.all_tasks() if task.get_name() == "audit aggregator"]

    run(scenario())


@pytest.mark.parametrize("counted_s", [0.0, SUMMARY_PERIOD_S + 0.5], ids=["counted", "being written"])
def test_the_end_of_the_process_does_not_wait_for_denials_that_keep_coming(counted_s: float) -> None:
    """Regression: each count that was written while the next was made prolonged the end. None of them is lost."""
    plant = FailingService(1.0)

    async def scenario() -> None:
        aggregator, sent = audit_aggregator(plant), 0

        async def deny_again_and_again() -> None:
            nonlocal sent
            async with asyncio.TaskGroup() as group:
                for target in ("/run", "/jog") * 100:
                    sent += 1
                    group.create_task(aggregator.record_denial("POST", target, "k", EVE))
                    await asyncio.sleep(0.3)

        denying = asyncio.create_task(deny_again_and_again())
        await asyncio.sleep(1.0 + counted_s)
        async with asyncio.timeout(3.0):
            await aggregator.close()
        assert not denying.done()
        await denying
        assert sum(times for _, _, times, _ in recorded_denials(plant)) == sent == 200

    run(scenario())


def test_kinds_beyond_the_limit_of_a_period_are_counted_together() -> None:
    plant = CountingService()

    async def scenario() -> None:
        aggregator = audit_aggregator(plant)
        for n in range(MAX_KINDS_PER_PERIOD + 5):
            await aggregator.record_denial("POST", f"/{n}", "k", EVE)
        await aggregator.record_denial("POST", "/0", "k", EVE)
        assert [target for target, *_ in recorded_denials(plant)] == [f"POST /{n}" for n in range(MAX_KINDS_PER_PERIOD)]
        assert sum(task.get_name() == "audit aggregator" for task in asyncio.all_tasks()) == 1
        await aggregator.flush()
        assert recorded_denials(plant)[MAX_KINDS_PER_PERIOD:] == [
            ("POST /0", "eve@10.0.0.9", 1, "k"),
            ("*", "eve", 5, "*"),
        ]
        await aggregator.record_denial("POST", "/0", "k", EVE)
        assert recorded_denials(plant)[-1] == ("POST /0", "eve@10.0.0.9", 1, "k"), "a recorded kind begins a new period"

    run(scenario())


def test_a_second_flood_is_counted_like_the_first() -> None:
    plant = CountingService()

    async def scenario() -> None:
        aggregator = audit_aggregator(plant)
        for _ in range(2):
            for _ in range(3):
                await aggregator.record_denial("POST", "/stop", "k", EVE)
            await asyncio.sleep(SUMMARY_PERIOD_S + 1)
        assert [times for _, _, times, _ in recorded_denials(plant)] == [1, 2, 1, 2]

    run(scenario())
