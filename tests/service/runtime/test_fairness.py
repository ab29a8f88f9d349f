"""Fairness of the event loop: work without urgency runs in turns, and long replies are encoded in pieces."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Coroutine
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivebus.service.runtime import fairness
from drivebus.service.runtime.fairness import (
    MAX_CHUNK_CHARS,
    encode_json_cooperatively,
    iter_cooperatively,
    yield_to_loop,
)
from drivebus.testing import virtual_time

LEAVES = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text()
KEYS = st.text() | st.integers()
DOCUMENTS = st.recursive(
    LEAVES, lambda inner: st.lists(inner) | st.dictionaries(KEYS, inner) | st.tuples(inner, inner), max_leaves=30
)


def _encoded(work: Coroutine[Any, Any, bytes]) -> bytes:
    return virtual_time.run(work)


@given(DOCUMENTS)
def test_json_encoded_in_pieces_equals_json_encoded_at_once(document: Any) -> None:
    whole = json.dumps(document, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    assert _encoded(encode_json_cooperatively(document)) == whole.encode()


def test_a_result_with_nan_is_not_encoded_as_json() -> None:
    with pytest.raises(ValueError):
        _encoded(encode_json_cooperatively({"result": {"value": float("nan")}}))


async def _turns_during(work: Any) -> int:
    """Return how many loop iterations other tasks get while ``work`` runs."""
    counted, done = 0, asyncio.ensure_future(work)
    while not done.done():
        await asyncio.sleep(0)
        counted += 1
    await done
    return counted


@pytest.mark.parametrize("kind", ["list", "topics"])
def test_other_tasks_run_while_a_long_message_is_encoded(kind: str) -> None:
    drive = {"id": "x" * 1000}
    many: Any = [drive] * 300 if kind == "list" else {f"drives/{n}": drive for n in range(300)}
    message = {"id": 7, "result": {"drives": many}}
    pieces = len(json.dumps(message)) // MAX_CHUNK_CHARS
    assert pieces > 5
    assert virtual_time.run(_turns_during(encode_json_cooperatively(message))) > pieces
    assert virtual_time.run(_turns_during(encode_json_cooperatively({"id": 7, "result": drive}))) <= 2


def test_an_iteration_yields_after_the_given_number_of_items() -> None:
    async def all_of(many: list[int], at_once: int) -> list[int]:
        return [item async for item in iter_cooperatively(many, at_once)]

    many = list(range(40))
    assert virtual_time.run(all_of(many, 1)) == many
    assert virtual_time.run(_turns_during(all_of(many, 1))) > 40
    assert 5 <= virtual_time.run(_turns_during(all_of(many, fairness.ITEMS_PER_TURN))) < 15


def test_one_task_continues_per_iteration_in_the_order_of_waiting() -> None:
    async def scenario() -> list[list[int]]:
        rounds: list[list[int]] = [[]]

        async def wait(number: int) -> None:
            await yield_to_loop()
            rounds[-1].append(number)

        waiting = [asyncio.ensure_future(wait(number)) for number in range(4)]
        await asyncio.sleep(0)
        waiting[1].cancel()
        while not all(task.done() for task in waiting):
            rounds.append([])
            await asyncio.sleep(0)
        rounds.append([])
        await wait(4)  # after all others have continued
        return [numbers for numbers in rounds if numbers]

    assert virtual_time.run(scenario()) == [[0], [2], [3], [4]]


def test_live_values_alternate_with_waiting_queries() -> None:
    """A hundred queries wait, and more arrive; neither kind starves."""

    async def scenario() -> tuple[int, int]:
        queries, live_items = 0, 0

        async def query() -> None:
            nonlocal queries
            while queries < 1000:
                await yield_to_loop()
                queries += 1

        tasks = [asyncio.ensure_future(query()) for _ in range(100)]
        await asyncio.sleep(0)
        async for _ in iter_cooperatively(range(20), 1, internal=True):
            live_items += 1
        for task in tasks:
            task.cancel()
        return queries, live_items

    queries, live_items = virtual_time.run(scenario())
    assert live_items == 20 and 15 <= queries <= 25
