"""What can wait is done in turns, long answers in pieces, so that nothing stands in front of a stop."""

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


def _done(work: Coroutine[Any, Any, bytes]) -> bytes:
    return virtual_time.run(work)


@given(DOCUMENTS)
def test_what_is_encoded_in_pieces_is_what_is_encoded_at_once(document: Any) -> None:
    whole = json.dumps(document, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    assert _done(encode_json_cooperatively(document)) == whole.encode()


def test_a_number_that_is_none_in_json_is_no_answer() -> None:
    with pytest.raises(ValueError):
        _done(encode_json_cooperatively({"result": {"value": float("nan")}}))


async def _turns_during(work: Any) -> int:
    """How often somebody else has a turn while it is done."""
    counted, done = 0, asyncio.ensure_future(work)
    while not done.done():
        await asyncio.sleep(0)
        counted += 1
    await done
    return counted


@pytest.mark.parametrize("kind", ["list", "topics"])
def test_others_have_their_turn_within_a_long_message(kind: str) -> None:
    drive = {"id": "x" * 1000}
    many: Any = [drive] * 300 if kind == "list" else {f"drives/{n}": drive for n in range(300)}
    message = {"id": 7, "result": {"drives": many}}
    pieces = len(json.dumps(message)) // MAX_CHUNK_CHARS
    assert pieces > 5
    assert virtual_time.run(_turns_during(encode_json_cooperatively(message))) > pieces
    assert virtual_time.run(_turns_during(encode_json_cooperatively({"id": 7, "result": drive}))) <= 2


def test_so_many_at_once_as_was_said() -> None:
    async def all_of(many: list[int], at_once: int) -> list[int]:
        return [one async for one in iter_cooperatively(many, at_once)]

    many = list(range(40))
    assert virtual_time.run(all_of(many, 1)) == many
    assert virtual_time.run(_turns_during(all_of(many, 1))) > 40
    assert 5 <= virtual_time.run(_turns_during(all_of(many, fairness.ITEMS_PER_TURN))) < 15


def test_one_goes_on_each_time_round_the_longest_waiting_first() -> None:
    async def scenario() -> list[list[int]]:
        rounds: list[list[int]] = [[]]

        async def wait(number: int) -> None:
            await yield_to_loop()
            rounds[-1].append(number)

        waiting = [asyncio.ensure_future(wait(number)) for number in range(4)]
        await asyncio.sleep(0)
        waiting[1].cancel()
        while not all(one.done() for one in waiting):
            rounds.append([])
            await asyncio.sleep(0)
        rounds.append([])
        await wait(4)  # after everybody has gone
        return [numbers for numbers in rounds if numbers]

    assert virtual_time.run(scenario()) == [[0], [2], [3], [4]]


def test_live_values_wait_for_one_question_and_not_for_all_of_them() -> None:
    """A hundred questions wait, and more come all the time; none of both kinds starves."""

    async def scenario() -> tuple[int, int]:
        asked, message = 0, 0

        async def ask() -> None:
            nonlocal asked
            while asked < 1000:
                await yield_to_loop()
                asked += 1

        questions = [asyncio.ensure_future(ask()) for _ in range(100)]
        await asyncio.sleep(0)
        async for _ in iter_cooperatively(range(20), 1, internal=True):
            message += 1
        for question in questions:
            question.cancel()
        return asked, message

    asked, message = virtual_time.run(scenario())
    assert message == 20 and 15 <= asked <= 25
